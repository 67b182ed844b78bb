//! State shared by the camera's two threads: the driver's requests and the scene.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::controls::Controls;
use super::descriptors::Kind;
use super::picture::{Noise, Scene};

/// Damage of one picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It is flagged as faulty.
    Error,
    /// Half of it is missing.
    Short,
}

/// State shared by the camera's two threads.
pub(super) struct State {
    /// Pending transfers of the driver: number and length in bytes.
    pub requests: VecDeque<(u32, usize)>,
    pub kind: Kind,
    pub size: [usize; 2],
    /// Frame interval, 100 ns.
    pub interval: u32,
    pub controls: Controls,
    pub scene: Arc<Scene>,
    pub noise: Noise,
    pub numbered: bool,
    /// Pictures sent.
    pub pictures: u32,
    pub silence: Option<Duration>,
    pub fault: Option<Fault>,
    /// Number of stops by the driver: it wants no more pictures, or a new format.
    pub stops: u32,
    pub is_gone: bool,
}

pub(super) struct Shared {
    pub state: Mutex<State>,
    pub changed: Condvar,
}

impl Shared {
    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state());
        self.changed.notify_all();
    }
}
