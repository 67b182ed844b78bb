//! `Shelf`: where what is derived of a model beside its own kernels is kept, once somebody has derived it.
//!
//! What comes in: how to derive it. What goes out: the same for everybody, or that there is none yet. It never knows who derives
//! it, nor when.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::sight::view::PlaneLayout;

/// Something to fit with, as soon as it is there; its default is nothing.
#[derive(Default)]
pub(crate) struct Shelf<T> {
    content: OnceLock<Arc<T>>,
    /// Those that all kernels are there for.
    layouts: Mutex<Vec<PlaneLayout>>,
    /// A kernel could not be made: fits go on without.
    is_given_up: AtomicBool,
}

impl<T: Default> Shelf<T> {
    /// What is there, else what `derive` gives; `None` where it does not come to an end.
    pub fn get_or_derive(&self, derive: impl FnOnce() -> Option<T>) -> Option<Arc<T>> {
        if self.is_given_up() {
            return Some(Arc::default());
        }
        if let Some(known) = self.content.get() {
            return Some(known.clone());
        }
        let derived = Arc::new(derive()?);
        // Two who derive the same at a time derive it twice: nobody waits for another. The first one's are kept.
        Some(self.content.get_or_init(|| derived).clone())
    }

    /// What a fit of such pixels need not wait for; nothing to fit with where it was given up.
    pub fn ready(&self, layout: &PlaneLayout) -> Option<Arc<T>> {
        if self.is_given_up() {
            return Some(Arc::default());
        }
        self.content.get().filter(|_| self.is_warm(layout)).cloned()
    }

    /// True once a kernel could not be made.
    pub fn is_given_up(&self) -> bool {
        self.is_given_up.load(Ordering::Relaxed)
    }

    /// There is nothing from now on.
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
