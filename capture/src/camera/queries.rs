//! Queries to devices whose drivers may hang.
//!
//! A call into a hung driver cannot be interrupted, so each query runs on its own thread, which is abandoned at the time
//! limit. A device with an overdue query is not queried again until that thread returns.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Unanswered queries by device: their start times, earliest first.
type PendingQueries = BTreeMap<PathBuf, Vec<Instant>>;

/// All unanswered queries.
pub(super) struct DeviceQueries {
    pending: Mutex<Option<Arc<Mutex<PendingQueries>>>>,
    /// Time limit for an answer.
    limit: Duration,
}

/// Outcome of a query.
#[derive(Debug, PartialEq)]
pub(super) enum QueryAnswer<T> {
    Answered(T),
    /// No answer within the limit, to this query or an earlier one.
    Silent,
}

fn lock(pending: &Mutex<PendingQueries>) -> MutexGuard<'_, PendingQueries> {
    pending.lock().unwrap_or_else(PoisonError::into_inner)
}

impl DeviceQueries {
    /// Devices that take longer than `limit` count as silent.
    pub const fn new(limit: Duration) -> DeviceQueries {
        DeviceQueries { pending: Mutex::new(None), limit }
    }

    fn pending(&self) -> Arc<Mutex<PendingQueries>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().clone()
    }

    /// Queries all devices in parallel; the answers are in the order of `paths`.
    pub fn query<T: Send + 'static>(&self, paths: &[PathBuf], run_query: fn(&Path) -> T) -> Vec<QueryAnswer<T>> {
        let (started, pending) = (Instant::now(), self.pending());
        let (sender, receiver) = sync_channel(paths.len());
        let mut open = 0;
        for (number, path) in paths.iter().enumerate() {
            let is_silent = |since: &Instant| started.saturating_duration_since(*since) > self.limit;
            if lock(&pending).get(path).and_then(|queried| queried.first()).is_some_and(is_silent) {
                continue;
            }
            lock(&pending).entry(path.clone()).or_default().push(started);
            let (sender, their_pending, queried) = (sender.clone(), pending.clone(), path.clone());
            let query = move || {
                let guard = PendingGuard { pending: their_pending, path: queried, started };
                let answer = run_query(&guard.path);
                drop(guard);
                drop(sender.send((number, answer))); // the caller may have timed out
            };
            match thread::Builder::new().name("ask camera".into()).spawn(query) {
                Ok(_) => open += 1,
                Err(_) => drop(PendingGuard { pending: pending.clone(), path: path.clone(), started }),
            }
        }
        drop(sender);
        let mut answers: Vec<QueryAnswer<T>> = paths.iter().map(|_| QueryAnswer::Silent).collect();
        while open > 0 {
            let left = (started + self.limit).saturating_duration_since(Instant::now());
            let Ok((number, answer)) = receiver.recv_timeout(left) else { break };
            answers[number] = QueryAnswer::Answered(answer);
            open -= 1;
        }
        answers
    }
}

/// Removes a query from the list when it is answered, its thread cannot be spawned, or it panics.
struct PendingGuard {
    pending: Arc<Mutex<PendingQueries>>,
    path: PathBuf,
    started: Instant,
}

impl Drop for PendingGuard {
    fn drop(&mut self) {
        let mut pending = lock(&self.pending);
        let Some(queried) = pending.get_mut(&self.path) else { return };
        if let Some(this) = queried.iter().position(|started| *started == self.started) {
            queried.remove(this);
        }
        if queried.is_empty() {
            pending.remove(&self.path);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Simulates a driver that hangs while this is locked; `CALLS` counts its calls.
    static HANGS: Mutex<()> = Mutex::new(());
    static CALLS: AtomicUsize = AtomicUsize::new(0);

    fn run_query(path: &Path) -> String {
        if path.ends_with("video1") {
            CALLS.fetch_add(1, Ordering::SeqCst);
            drop(HANGS.lock().unwrap());
        }
        path.display().to_string()
    }

    #[test]
    fn a_hung_device_delays_no_other_and_is_queried_once() {
        let queries = DeviceQueries::new(Duration::from_millis(200));
        let paths = ["/dev/video0", "/dev/video1", "/dev/video2"].map(PathBuf::from);
        let answered = |path: &str| QueryAnswer::Answered(path.to_string());
        let hangs = HANGS.lock().unwrap();
        for _ in 0..20 {
            let answers = queries.query(&paths, run_query);
            assert_eq!(answers, [answered("/dev/video0"), QueryAnswer::Silent, answered("/dev/video2")]);
        }
        assert!(CALLS.load(Ordering::SeqCst) <= 2, "threads that hang do not pile up");
        drop(hangs);
        while queries.query(&paths, run_query)[1] == QueryAnswer::Silent {
            thread::yield_now();
        }
        assert!(lock(&queries.pending()).is_empty());
    }
}
