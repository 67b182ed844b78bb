//! A lost device is closed on a thread of its own: a driver may take seconds over what is gone, or never come back, and the
//! camera may be plugged in again meanwhile.

use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// A device that is being closed is waited for so long before it is opened again.
const CLOSE_MAX: Duration = Duration::from_secs(2);

/// One device that is being closed, at most.
#[derive(Default)]
pub(super) struct Closing(Option<(JoinHandle<()>, Instant)>);

impl Closing {
    /// Drops `device` beside the caller; in place where the driver still holds the last one, or there is no thread.
    pub fn close(&mut self, device: impl Send + 'static) {
        if self.0.as_ref().is_none_or(|(thread, _)| thread.is_finished()) {
            let thread = Builder::new().name("close camera".into()).spawn(move || drop(device)).ok();
            self.0 = thread.map(|thread| (thread, Instant::now() + CLOSE_MAX));
        }
    }

    /// Whether the device may still be in use by ourselves, and is worth waiting for.
    pub fn is_under_way(&self, now: Instant) -> bool {
        self.0.as_ref().is_some_and(|(thread, until)| !thread.is_finished() && now < *until)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, sync_channel};

    use super::*;

    /// Ends when it is told to.
    struct Slow(Receiver<()>);

    impl Drop for Slow {
        fn drop(&mut self) {
            self.0.recv().ok();
        }
    }

    #[test]
    fn a_driver_that_hangs_holds_nobody_for_long() {
        let mut closing = Closing::default();
        let now = Instant::now();
        assert!(!closing.is_under_way(now));
        let (end, ended) = sync_channel(1);
        closing.close(Slow(ended)); // would never return in place
        assert!(closing.is_under_way(now));
        assert!(!closing.is_under_way(now + 2 * CLOSE_MAX), "it is looked for again all the same");
        end.send(()).ok();
        while closing.is_under_way(now) {
            std::thread::yield_now();
        }
    }
}
