//! `NamedThread`: a thread joined with a deadline, since a fit, a file or a driver may block it.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use tokio::sync::oneshot;

/// A running thread.
pub struct NamedThread {
    name: String,
    thread: Mutex<Option<(JoinHandle<()>, Receiver<()>)>>,
}

impl NamedThread {
    /// Spawns the thread.
    pub fn start(name: String, work: impl FnOnce() + Send + 'static) -> std::io::Result<NamedThread> {
        let (runs, running) = sync_channel::<()>(0);
        let said = tracing::Span::current(); // the caller's span, for the log
        let work = move || {
            let _runs = runs;
            said.in_scope(work);
        };
        let thread = Builder::new().name(name.clone()).spawn(work)?;
        Ok(NamedThread { name, thread: Mutex::new(Some((thread, running))) })
    }

    /// Joins the thread, or returns false at `until` and detaches it.
    pub fn wait(&self, until: Instant) -> bool {
        let taken = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some((thread, running)) = taken else { return true };
        let left = until.saturating_duration_since(Instant::now());
        if running.recv_timeout(left) == Err(RecvTimeoutError::Timeout) {
            return false;
        }
        if thread.join().is_err() {
            tracing::error!(thread = self.name, "a thread panicked");
        }
        true
    }
}

/// Runs `work` on a new thread, or on the caller's if none can be spawned. The receiver resolves when it is done.
pub fn beside(what: &str, work: impl FnOnce() + Send + 'static) -> oneshot::Receiver<()> {
    let (done, heard) = oneshot::channel();
    let work = Arc::new(Mutex::new(Some(work)));
    let take = |work: &Mutex<Option<_>>| work.lock().unwrap_or_else(PoisonError::into_inner).take();
    let (theirs, said) = (work.clone(), tracing::Span::current());
    let finish = move || {
        said.in_scope(|| take(&theirs).into_iter().for_each(|work| work()));
        done.send(()).ok(); // the caller may have gone
    };
    if let Err(error) = Builder::new().name(format!("end {what}")).spawn(finish) {
        tracing::error!(%error, "no thread to wait for the end of {what}");
        take(&work).into_iter().for_each(|work| work());
    }
    heard
}

/// Raises the nice value of the calling thread, and of threads that it starts later, by `nicer`. Logs a refusal once.
pub fn step_aside(nicer: i32) {
    static SAID: Once = Once::new();
    if let Err(error) = rustix::process::setpriority_process(None, nicer) {
        SAID.call_once(|| tracing::warn!(%error, "compiling has the priority of fits: setpriority was refused"));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_blocked_thread_is_detached_at_the_deadline() {
        let (end, ended) = sync_channel::<()>(0);
        let stuck = NamedThread::start("stuck".into(), move || _ = ended.recv().is_ok()).unwrap();
        let begin = Instant::now();
        assert!(!stuck.wait(begin + Duration::from_millis(30)));
        assert!(begin.elapsed() >= Duration::from_millis(30) && begin.elapsed() < Duration::from_secs(20));
        drop(end);
        let (said, heard) = sync_channel(1);
        let short = NamedThread::start("short".into(), move || said.send(1).unwrap()).unwrap();
        assert!(short.wait(Instant::now() + Duration::from_secs(60)));
        assert_eq!(heard.try_recv(), Ok(1), "it was over");
    }
}
