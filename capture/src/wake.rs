//! `Wake`: an eventfd that interrupts a thread waiting in `poll`.

use std::io;
use std::sync::Arc;

use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};

/// Wakes one thread from another. Clones share the eventfd.
#[derive(Clone, Debug)]
pub struct Wake(Arc<OwnedFd>);

impl Wake {
    /// Creates an eventfd.
    ///
    /// # Errors
    /// The process has no file descriptor left.
    pub fn new() -> io::Result<Wake> {
        Ok(Wake(Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?)))
    }

    /// Wakes the waiting thread.
    pub fn ring(&self) {
        // It fails only after 2^64 unread rings.
        let rung = rustix::io::write(&self.0, &1u64.to_ne_bytes());
        debug_assert!(rung.is_ok(), "{rung:?}");
    }

    /// Resets it; true if it was rung.
    pub(crate) fn reset(&self) -> bool {
        rustix::io::read(&self.0, &mut [0; 8]).is_ok()
    }
}

impl AsFd for Wake {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
