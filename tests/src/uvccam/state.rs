//! What the camera's two threads share: what the driver has asked for, and what the camera looks at.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::controls::Controls;
use super::descriptors::Kind;
use super::picture::{Noise, Scene};

/// What one picture is spoiled with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It is flagged as faulty.
    Error,
    /// Half of it is missing.
    Short,
}

/// What the camera's two threads share.
pub(super) struct State {
    /// Requests of the driver for bytes: its number and how many bytes.
    pub requests: VecDeque<(u32, usize)>,
    pub kind: Kind,
    pub size: [usize; 2],
    /// From a picture to the next, 100 ns.
    pub interval: u32,
    pub controls: Controls,
    pub scene: Arc<Scene>,
    pub noise: Noise,
    pub numbered: bool,
    /// Pictures sent.
    pub pictures: u32,
    pub silence: Option<Duration>,
    pub fault: Option<Fault>,
    /// Signs that the driver wants no more pictures, or none of the last agreement.
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
