//! `Asking`: questions to devices whose drivers may never answer.
//!
//! What comes in: paths, and a question to each. What goes out: answers, or that there was none in time. A call into a driver that
//! hangs cannot be ended, so each question has a thread of its own, which is left to itself then; until it comes back its
//! device is asked nothing more, and nobody waits for it again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// What a device was asked and has not answered: when, the earliest first.
type Owed = BTreeMap<PathBuf, Vec<Instant>>;

/// All questions that nobody has answered yet.
pub(super) struct Asking {
    owed: Mutex<Option<Arc<Mutex<Owed>>>>,
    /// Devices answer by then, or are silent.
    limit: Duration,
}

/// What became of a question.
#[derive(Debug, PartialEq)]
pub(super) enum Heard<T> {
    Said(T),
    /// Not in time, now or before.
    Silent,
}

fn lock(owed: &Mutex<Owed>) -> MutexGuard<'_, Owed> {
    owed.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Asking {
    /// Devices that take longer are silent.
    pub const fn new(limit: Duration) -> Asking {
        Asking { owed: Mutex::new(None), limit }
    }

    fn owed(&self) -> Arc<Mutex<Owed>> {
        self.owed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().clone()
    }

    /// Asks all of them at once; the answers are in the order of the paths.
    pub fn ask<T: Send + 'static>(&self, paths: &[PathBuf], question: fn(&Path) -> T) -> Vec<Heard<T>> {
        let (begin, owed) = (Instant::now(), self.owed());
        let (said, heard) = sync_channel(paths.len());
        let mut open = 0;
        for (number, path) in paths.iter().enumerate() {
            let is_silent = |since: &Instant| begin.saturating_duration_since(*since) > self.limit;
            if lock(&owed).get(path).and_then(|asked| asked.first()).is_some_and(is_silent) {
                continue;
            }
            lock(&owed).entry(path.clone()).or_default().push(begin);
            let (said, theirs, asked) = (said.clone(), owed.clone(), path.clone());
            let ask = move || {
                let settled = Settled { owed: theirs, path: asked, begin };
                let answer = question(&settled.path);
                drop(settled);
                drop(said.send((number, answer))); // whoever asked may have stopped waiting
            };
            match thread::Builder::new().name("ask camera".into()).spawn(ask) {
                Ok(_) => open += 1,
                Err(_) => drop(Settled { owed: owed.clone(), path: path.clone(), begin }),
            }
        }
        drop(said);
        let mut answers: Vec<Heard<T>> = paths.iter().map(|_| Heard::Silent).collect();
        while open > 0 {
            let left = (begin + self.limit).saturating_duration_since(Instant::now());
            let Ok((number, answer)) = heard.recv_timeout(left) else { break };
            answers[number] = Heard::Said(answer);
            open -= 1;
        }
        answers
    }
}

/// Takes a question from the list when it is answered, or nobody could ask it, or asking panicked.
struct Settled {
    owed: Arc<Mutex<Owed>>,
    path: PathBuf,
    begin: Instant,
}

impl Drop for Settled {
    fn drop(&mut self) {
        let mut owed = lock(&self.owed);
        let Some(asked) = owed.get_mut(&self.path) else { return };
        if let Some(this) = asked.iter().position(|begin| *begin == self.begin) {
            asked.remove(this);
        }
        if asked.is_empty() {
            owed.remove(&self.path);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// A driver that hangs while this is locked, and how often it was called.
    static HANGS: Mutex<()> = Mutex::new(());
    static CALLS: AtomicUsize = AtomicUsize::new(0);

    fn question(path: &Path) -> String {
        if path.ends_with("video1") {
            CALLS.fetch_add(1, Ordering::SeqCst);
            drop(HANGS.lock().unwrap());
        }
        path.display().to_string()
    }

    #[test]
    fn a_device_that_never_answers_holds_up_no_other_and_is_asked_once() {
        let asking = Asking::new(Duration::from_millis(200));
        let paths = ["/dev/video0", "/dev/video1", "/dev/video2"].map(PathBuf::from);
        let said = |path: &str| Heard::Said(path.to_string());
        let hangs = HANGS.lock().unwrap();
        for _ in 0..20 {
            let answers = asking.ask(&paths, question);
            assert_eq!(answers, [said("/dev/video0"), Heard::Silent, said("/dev/video2")]);
        }
        assert!(CALLS.load(Ordering::SeqCst) <= 2, "threads that hang do not pile up");
        drop(hangs);
        while asking.ask(&paths, question)[1] == Heard::Silent {
            thread::yield_now();
        }
        assert!(lock(&asking.owed()).is_empty());
    }
}
