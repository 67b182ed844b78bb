//! `Shelf`: where a model's alternatives are kept once they are derived.
//!
//! What comes in: the model's kernels. What goes out: its alternatives, or that there are none yet. It never knows who prepares
//! them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::Alternatives;
use crate::sight::view::PlaneLayout;
use crate::solve::stage_kernels::StageKernels;

/// A model's alternatives, as soon as there are any.
#[derive(Default)]
pub(crate) struct Shelf {
    alternatives: OnceLock<Arc<Alternatives>>,
    /// Those that all kernels are there for.
    layouts: Mutex<Vec<PlaneLayout>>,
    /// A kernel could not be made: fits go on without alternatives.
    is_given_up: AtomicBool,
}

impl Shelf {
    /// The alternatives, derived now if need be.
    pub fn get(&self, kernels: &StageKernels) -> Arc<Alternatives> {
        self.get_while(kernels, &|| true).unwrap_or_default()
    }

    /// The same; `None` when `keeps_going` says no before they are derived.
    pub fn get_while(&self, kernels: &StageKernels, keeps_going: &dyn Fn() -> bool) -> Option<Arc<Alternatives>> {
        if self.is_given_up.load(Ordering::Relaxed) {
            return Some(Arc::default());
        }
        if let Some(known) = self.alternatives.get() {
            return Some(known.clone());
        }
        let derived = Arc::new(Alternatives::new(kernels, kernels.cache(), keeps_going)?);
        // Two who derive the same at a time derive it twice: nobody waits for another. The first one's are kept.
        Some(self.alternatives.get_or_init(|| derived).clone())
    }

    /// Those that a fit of such pixels need not wait for; empty ones where they were given up.
    pub fn ready(&self, layout: &PlaneLayout) -> Option<Arc<Alternatives>> {
        if self.is_given_up.load(Ordering::Relaxed) {
            return Some(Arc::default());
        }
        self.alternatives.get().filter(|_| self.is_warm(layout)).cloned()
    }

    /// There are none from now on.
    pub fn give_up(&self) {
        self.is_given_up.store(true, Ordering::Relaxed);
    }

    fn is_warm(&self, layout: &PlaneLayout) -> bool {
        self.layouts.lock().unwrap_or_else(PoisonError::into_inner).contains(layout)
    }

    /// All kernels for that layout are there.
    pub fn warmed(&self, layout: &PlaneLayout) {
        let mut layouts = self.layouts.lock().unwrap_or_else(PoisonError::into_inner);
        if !layouts.contains(layout) {
            if layouts.len() == LAYOUTS_MAX {
                layouts.remove(0);
            }
            layouts.push(layout.clone());
        }
    }
}

/// Layouts that are remembered; more are prepared again.
const LAYOUTS_MAX: usize = 16;
