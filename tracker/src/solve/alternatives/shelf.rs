//! `Shelf`: where a model's alternatives are kept once they are derived.
//!
//! What comes in: the model's kernels. What goes out: its alternatives, or that there are none yet. It never knows who prepares
//! them.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::Alternatives;
use crate::sight::view::PlaneLayout;
use crate::solve::stage_kernels::{CompileFailure, StageKernels};

/// A model's alternatives, as soon as there are any.
#[derive(Default)]
pub(crate) struct Shelf {
    alternatives: OnceLock<Result<Arc<Alternatives>, CompileFailure>>,
    /// Those that all kernels are there for.
    layouts: Mutex<Vec<PlaneLayout>>,
}

impl Shelf {
    /// The alternatives, derived now if need be.
    ///
    /// # Errors
    /// When they cannot be derived.
    pub fn get(&self, kernels: &StageKernels) -> Result<Arc<Alternatives>, CompileFailure> {
        Ok(self.get_while(kernels, &|| true)?.unwrap_or_default())
    }

    /// The same; `None` when `keeps_going` says no before they are derived.
    ///
    /// # Errors
    /// When they cannot be derived, now or before.
    pub fn get_while(
        &self,
        kernels: &StageKernels,
        keeps_going: &dyn Fn() -> bool,
    ) -> Result<Option<Arc<Alternatives>>, CompileFailure> {
        if let Some(known) = self.alternatives.get() {
            return known.clone().map(Some);
        }
        let derived = match Alternatives::new(kernels, kernels.cache(), keeps_going) {
            Ok(None) => return Ok(None),
            Ok(Some(alternatives)) => Ok(Arc::new(alternatives)),
            Err(failure) => Err(failure),
        };
        // Two who derive the same at a time derive it twice: nobody waits for another. The first one's are kept.
        self.alternatives.get_or_init(|| derived).clone().map(Some)
    }

    /// Those that a fit of such pixels need not wait for; empty ones where they could not be derived.
    pub fn ready(&self, layout: &PlaneLayout) -> Option<Arc<Alternatives>> {
        match self.alternatives.get()? {
            Ok(alternatives) => self.is_warm(layout).then(|| alternatives.clone()),
            Err(_) => Some(Arc::default()),
        }
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
