//! `Prepared`: holds a value derived from a model besides its own kernels, shared by all users; absent until one of
//! them has derived it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::sight::view::PlaneLayout;

/// A derived value that may not exist yet; its default is empty.
#[derive(Default)]
pub(crate) struct Prepared<T> {
    content: OnceLock<Arc<T>>,
    /// Layouts with all kernels compiled.
    layouts: Mutex<Vec<PlaneLayout>>,
    /// A kernel failed to compile: fits go on without.
    has_failed: AtomicBool,
}

impl<T: Default> Prepared<T> {
    /// The content, else the result of `derive`; `None` where `derive` stops early. Empty where a kernel failed to
    /// compile.
    pub fn get_or_derive(&self, derive: impl FnOnce() -> Option<T>) -> Option<Arc<T>> {
        if self.has_failed() {
            return Some(Arc::default());
        }
        if let Some(known) = self.content.get() {
            return Some(known.clone());
        }
        let derived = Arc::new(derive()?);
        // Concurrent callers derive twice instead of waiting; the first result is kept.
        Some(self.content.get_or_init(|| derived).clone())
    }

    /// The content, if all kernels for this layout are compiled; the empty default where a kernel failed to compile.
    pub fn ready(&self, layout: &PlaneLayout) -> Option<Arc<T>> {
        if self.has_failed() {
            return Some(Arc::default());
        }
        self.content.get().filter(|_| self.is_compiled(layout)).cloned()
    }

    /// True once a kernel has failed to compile.
    pub fn has_failed(&self) -> bool {
        self.has_failed.load(Ordering::Relaxed)
    }

    /// Makes it empty for good.
    pub fn mark_failed(&self) {
        self.has_failed.store(true, Ordering::Relaxed);
    }

    fn is_compiled(&self, layout: &PlaneLayout) -> bool {
        self.layouts.lock().unwrap_or_else(PoisonError::into_inner).contains(layout)
    }

    /// Marks all kernels for a layout as compiled.
    pub fn mark_compiled(&self, layout: &PlaneLayout) {
        let mut layouts = self.layouts.lock().unwrap_or_else(PoisonError::into_inner);
        if !layouts.contains(layout) {
            if layouts.len() == LAYOUTS_MAX {
                layouts.remove(0);
            }
            layouts.push(layout.clone());
        }
    }
}

/// Most layouts kept; older ones are prepared again.
const LAYOUTS_MAX: usize = 16;
