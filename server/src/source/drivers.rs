//! `Drivers`: runs camera driver calls that may never return.
//!
//! A thread in such a call cannot be ended: after the limit it is abandoned, and counted until it returns. The process abandons
//! at most `LIMITS.given_up_threads`; then no further camera is opened.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Builder;
use std::time::Duration;

use crate::limits::LIMITS;
use crate::problem::Problem;

/// The counter of one process, shared by clones.
#[derive(Clone, Default)]
pub struct Drivers {
    given_up: Arc<AtomicUsize>,
}

/// An abandoned thread; counted until dropped.
pub struct GivenUp(Arc<AtomicUsize>);

impl Drop for GivenUp {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// State of a driver call.
enum Call {
    Open,
    GivenUp { _counted: GivenUp },
    Over,
}

impl Drivers {
    /// Number of abandoned threads.
    pub fn given_up(&self) -> usize {
        self.given_up.load(Ordering::Relaxed)
    }

    /// Counts one more.
    pub fn give_up(&self) -> GivenUp {
        self.given_up.fetch_add(1, Ordering::Relaxed);
        GivenUp(self.given_up.clone())
    }

    /// Whether one more thread may be abandoned.
    pub fn has_room(&self) -> bool {
        self.given_up() < LIMITS.given_up_threads
    }

    /// Runs a call to the driver of `device` on a thread of its own.
    ///
    /// # Errors
    /// 503 if it does not return within `limit`, or too many others have not returned.
    pub fn ask<T: Send + 'static>(
        &self,
        device: &str,
        limit: Duration,
        question: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        if !self.has_room() {
            let most = LIMITS.given_up_threads;
            return Err(Problem::not_ready(format!(
                "{most} calls of cameras' drivers have not returned; no camera is asked anything until one of them does: \
                 unplug the cameras that hang"
            )));
        }
        let (said, heard) = sync_channel(1);
        let call = Arc::new(Mutex::new(Call::Open));
        let (theirs, span) = (call.clone(), tracing::Span::current());
        let work = move || {
            let answer = span.in_scope(question);
            let mut call = theirs.lock().unwrap_or_else(PoisonError::into_inner);
            *call = Call::Over;
            said.try_send(answer).ok(); // the caller may have stopped waiting
        };
        let thread = Builder::new().name("camera driver".into()).spawn(work);
        thread.map_err(|error| Problem::no_thread("to ask a camera", &error))?;
        let late = match heard.recv_timeout(limit) {
            Ok(answer) => return Ok(answer),
            Err(RecvTimeoutError::Disconnected) => return Err(Problem::bug("asking a camera panicked")),
            Err(RecvTimeoutError::Timeout) => Problem::late(format!(
                "the driver of {device} has not answered within {} s; unplug the camera and plug it in again",
                limit.as_secs_f64()
            )),
        };
        let mut call = call.lock().unwrap_or_else(PoisonError::into_inner);
        if let Call::Over = *call {
            return heard.try_recv().map_err(|_| late); // it came at the last moment
        }
        *call = Call::GivenUp { _counted: self.give_up() };
        tracing::warn!(device, given_up = self.given_up(), "a camera's driver does not answer");
        Err(late)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn hanging_driver_calls_are_counted_and_limited() {
        let (drivers, soon, long) = (Drivers::default(), Duration::from_millis(20), Duration::from_secs(60));
        assert_eq!(drivers.ask("/dev/video0", long, || 7).unwrap(), 7);
        let mut hanging = Vec::new();
        for number in 1..=LIMITS.given_up_threads {
            let (release, held) = sync_channel::<()>(0);
            let problem = drivers.ask("/dev/video0", soon, move || held.recv().is_err()).unwrap_err();
            assert_eq!((problem.status.as_u16(), problem.code), (503, "late"));
            assert!(problem.detail.contains("/dev/video0") && problem.detail.contains("unplug"), "{}", problem.detail);
            assert_eq!(drivers.given_up(), number);
            hanging.push(release);
        }
        let refused = drivers.ask("/dev/video1", long, || 7).unwrap_err();
        assert_eq!((refused.status.as_u16(), refused.code), (503, "not-ready"));
        hanging.pop();
        while !drivers.has_room() {
            std::thread::yield_now();
        }
        assert_eq!(drivers.ask("/dev/video1", long, || 7).unwrap(), 7);
        drop(hanging);
        while drivers.given_up() > 0 {
            std::thread::yield_now();
        }
    }

    #[test]
    fn panic_in_a_driver_call_is_reported_as_a_bug() {
        let asked = Drivers::default().ask("/dev/video0", Duration::from_secs(60), || panic!("planted"));
        assert_eq!(asked.map(|()| 0).unwrap_err().code, "bug");
    }
}
