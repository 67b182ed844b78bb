//! `Exposure`: the knob of a source whose exposure can be set, from another thread.

use std::sync::{Arc, Mutex, PoisonError};

/// How much light a source takes, relative to the beginning. Clones turn the same knob.
#[derive(Clone, Debug)]
pub struct Exposure(Arc<Mutex<f64>>);

impl Default for Exposure {
    fn default() -> Exposure {
        Exposure(Arc::new(Mutex::new(1.0)))
    }
}

impl Exposure {
    /// So many times as much light as in the beginning; what is not a positive number is left alone.
    pub fn set(&self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = factor;
        }
    }

    /// What was set last.
    pub fn get(&self) -> f64 {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
