//! `Exposure`: sets the exposure of a source from another thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::wake::Wake;

/// Light that a source takes, relative to its start. Clones share their state.
#[derive(Clone, Debug, Default)]
pub struct Exposure {
    state: Arc<Mutex<State>>,
    wake: Option<Wake>,
}

#[derive(Debug, Default)]
struct State {
    /// `None` until first set.
    wanted: Option<f64>,
    taken: Option<f64>,
    range: Option<[f64; 2]>,
}

impl Exposure {
    /// An exposure with a limited range, which wakes its source when set.
    pub(crate) fn waking(wake: Wake, range: [f64; 2]) -> Exposure {
        let state = State { range: Some(range), ..State::default() };
        Exposure { state: Arc::new(Mutex::new(state)), wake: Some(wake) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Requests `factor` × the light at the start; ignores values that are not positive and finite.
    pub fn set(&self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            self.lock().wanted = Some(factor);
            self.wake.iter().for_each(Wake::ring);
        }
    }

    /// Last requested factor; 1 at the start.
    pub fn get(&self) -> f64 {
        self.wanted().unwrap_or(1.0)
    }

    /// Last requested factor, if any.
    pub(crate) fn wanted(&self) -> Option<f64> {
        self.lock().wanted
    }

    /// Factor that the source applied (a camera has steps and limits); until then the requested one.
    pub fn taken(&self) -> f64 {
        let state = self.lock();
        state.taken.or(state.wanted).unwrap_or(1.0)
    }

    /// Least and greatest factor, if the source has limits.
    pub fn range(&self) -> Option<[f64; 2]> {
        self.lock().range
    }

    /// Records the factor that the source applied.
    pub(crate) fn record_applied(&self, factor: f64) {
        self.lock().taken = Some(factor);
    }
}
