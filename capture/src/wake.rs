//! `Wake`: a bell for a thread that waits in `poll` for something else.

use std::io;
use std::sync::Arc;

use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};

/// Rings in one thread, is heard in another. Clones are one bell.
#[derive(Clone, Debug)]
pub struct Wake(Arc<OwnedFd>);

impl Wake {
    /// A bell.
    ///
    /// # Errors
    /// When the process has no file descriptor left.
    pub fn new() -> io::Result<Wake> {
        Ok(Wake(Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?)))
    }

    /// The thread that waits goes on.
    pub fn ring(&self) {
        // It fails only when it has rung 2^64 times unheard.
        let rung = rustix::io::write(&self.0, &1u64.to_ne_bytes());
        debug_assert!(rung.is_ok(), "{rung:?}");
    }

    /// Silences it; whether it has rung.
    pub(crate) fn hear(&self) -> bool {
        rustix::io::read(&self.0, &mut [0; 8]).is_ok()
    }
}

impl AsFd for Wake {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
