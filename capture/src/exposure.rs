//! `Exposure`: the knob of a source whose exposure can be set, from another thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::wake::Wake;

/// How much light a source takes, relative to the beginning. Clones turn the same knob.
#[derive(Clone, Debug, Default)]
pub struct Exposure {
    state: Arc<Mutex<State>>,
    wake: Option<Wake>,
}

#[derive(Debug, Default)]
struct State {
    /// `None` until somebody turns it.
    wanted: Option<f64>,
    taken: Option<f64>,
    range: Option<[f64; 2]>,
}

impl Exposure {
    /// A knob with ends, which wakes its source.
    pub(crate) fn waking(wake: Wake, range: [f64; 2]) -> Exposure {
        let state = State { range: Some(range), ..State::default() };
        Exposure { state: Arc::new(Mutex::new(state)), wake: Some(wake) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// So many times as much light as in the beginning; what is not a positive number is left alone.
    pub fn set(&self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            self.lock().wanted = Some(factor);
            self.wake.iter().for_each(Wake::ring);
        }
    }

    /// What was set last; 1 in the beginning.
    pub fn get(&self) -> f64 {
        self.wanted().unwrap_or(1.0)
    }

    /// What was set last, if anything was.
    pub(crate) fn wanted(&self) -> Option<f64> {
        self.lock().wanted
    }

    /// What the source made of it: a camera has steps and ends. Until it has done anything, what was set.
    pub fn taken(&self) -> f64 {
        let state = self.lock();
        state.taken.or(state.wanted).unwrap_or(1.0)
    }

    /// The least and the most that can be set, where the source has ends.
    pub fn range(&self) -> Option<[f64; 2]> {
        self.lock().range
    }

    /// The source says what it made of it.
    pub(crate) fn took(&self, factor: f64) {
        self.lock().taken = Some(factor);
    }
}
