//! `PreparationThread`: prepares data that a session's fits lack on a separate thread, while the fits go on without it.
//!
//! The tracker finds the result itself; a fit never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle};

use isophote_tracker::Preparation;

use crate::thread::step_aside;

/// Runs one preparation at a time.
#[derive(Default)]
pub struct PreparationThread {
    running: Option<Running>,
}

struct Running {
    is_unwanted: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl PreparationThread {
    /// Starts a preparation, unless one is running; whoever still needs it asks again.
    pub fn prepare(&mut self, session: &str, preparation: Preparation) {
        if self.running.as_ref().is_some_and(|running| !running.thread.is_finished()) {
            return;
        }
        let is_unwanted = Arc::new(AtomicBool::new(false));
        let (told, name) = (is_unwanted.clone(), session.to_string());
        let run = move || {
            step_aside(10);
            if let Err(failure) = preparation.run(&|| !told.load(Ordering::Relaxed)) {
                let session = name.as_str();
                tracing::warn!(session, %failure, "goes on without what was to be prepared for its fits");
            }
        };
        match Builder::new().name(format!("prepare {session}")).spawn(run) {
            Ok(thread) => self.running = Some(Running { is_unwanted, thread }),
            // The next frame asks again.
            Err(error) => tracing::warn!(session, %error, "no thread to prepare what its fits lack"),
        }
    }

    /// Cancels the preparation after its current step, without waiting.
    pub fn give_up(&mut self) {
        if let Some(running) = self.running.take() {
            running.is_unwanted.store(true, Ordering::Relaxed);
        }
    }
}

impl Drop for PreparationThread {
    fn drop(&mut self) {
        self.give_up();
    }
}
