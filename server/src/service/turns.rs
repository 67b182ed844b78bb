//! `Turns`: a fair scheduler for jobs that work in pieces, a few pieces at a time.
//!
//! A job asks for a turn before each piece. Turns go first to the job with the fewest pieces at work, then to the one served
//! the longest ago. So a job of many pieces delays a short one by a piece, not by all of them.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use isophote_machine::Threads;
use isophote_tracker::Workers;

/// The scheduler.
pub struct Turns {
    places: usize,
    jobs: AtomicU64,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    taken: usize,
    turns: u64,
    jobs: BTreeMap<u64, Job>,
}

/// A running job.
#[derive(Clone, Copy, Default)]
struct Job {
    /// Pieces that wait for a turn, and pieces at work.
    waiting: usize,
    working: usize,
    /// The number of its last turn; 0 before the first.
    served: u64,
}

impl Turns {
    /// A scheduler of `places` concurrent pieces.
    pub fn new(places: usize) -> Turns {
        Turns { places, jobs: AtomicU64::new(0), state: Mutex::default(), changed: Condvar::new() }
    }

    /// Begins a job.
    pub fn begin(self: &Arc<Turns>) -> FairWorkers {
        let job = self.jobs.fetch_add(1, Ordering::Relaxed);
        self.lock().jobs.insert(job, Job::default());
        FairWorkers { turns: self.clone(), job }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the job's turn.
    fn take(&self, job: u64) -> Turn<'_> {
        let mut state = self.lock();
        state.of(job, |job| job.waiting += 1);
        let waits = |state: &mut State| state.taken >= self.places || state.next() != Some(job);
        let mut state = self.changed.wait_while(state, waits).unwrap_or_else(PoisonError::into_inner);
        state.taken += 1;
        state.turns += 1;
        let served = state.turns;
        state.of(job, |job| *job = Job { waiting: job.waiting - 1, working: job.working + 1, served });
        drop(state);
        self.changed.notify_all(); // another turn may be free
        Turn { turns: self, job }
    }
}

impl State {
    /// The job whose turn is next.
    fn next(&self) -> Option<u64> {
        let waiting = self.jobs.iter().filter(|(_, job)| job.waiting > 0);
        waiting.min_by_key(|(number, job)| (job.working, job.served, **number)).map(|(number, _)| *number)
    }

    fn of(&mut self, job: u64, change: impl FnOnce(&mut Job)) {
        if let Some(job) = self.jobs.get_mut(&job) {
            change(job);
        }
    }
}

/// A turn that is held.
struct Turn<'a> {
    turns: &'a Turns,
    job: u64,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        let mut state = self.turns.lock();
        state.taken -= 1;
        state.of(self.job, |job| job.working -= 1);
        drop(state);
        self.turns.changed.notify_all();
    }
}

/// Runs the pieces of one job, each in its turn.
pub struct FairWorkers {
    turns: Arc<Turns>,
    job: u64,
}

impl FairWorkers {
    /// Runs a piece on the calling thread. `work` must not ask for another turn.
    pub fn piece<T>(&self, work: impl FnOnce() -> T) -> T {
        let _turn = self.turns.take(self.job);
        work()
    }
}

impl Workers for FairWorkers {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        Threads.each(count, &|piece| self.piece(|| work(piece)));
    }
}

impl Drop for FairWorkers {
    fn drop(&mut self) {
        self.turns.lock().jobs.remove(&self.job);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::mpsc::sync_channel;
    use std::thread;

    /// While a job of many pieces is at work, the first piece of a later job follows the present piece.
    #[test]
    fn a_short_job_waits_for_one_piece_of_a_long_one() {
        let turns = Arc::new(Turns::new(1));
        let done = Mutex::new(Vec::new());
        let (begun, has_begun) = sync_channel(0);
        let (go_on, goes_on) = sync_channel::<()>(0);
        let goes_on = Mutex::new(goes_on);
        let say = |name: &'static str| done.lock().unwrap().push(name);
        thread::scope(|scope| {
            let long = turns.begin();
            let say = &say;
            scope.spawn(move || {
                long.piece(|| {
                    begun.send(()).unwrap();
                    goes_on.lock().unwrap().recv().unwrap();
                    say("long");
                });
                long.each(3, &|_| say("long"));
            });
            has_begun.recv().unwrap();
            let short = turns.begin();
            let other = scope.spawn(move || short.piece(|| say("short")));
            while turns.lock().jobs.values().map(|job| job.waiting).sum::<usize>() == 0 {
                thread::yield_now();
            }
            go_on.send(()).unwrap();
            other.join().unwrap();
        });
        assert_eq!(*done.lock().unwrap(), ["long", "short", "long", "long", "long"]);
        assert!(turns.lock().jobs.is_empty() && turns.lock().taken == 0);
    }

    #[test]
    fn the_job_with_the_fewest_pieces_at_work_served_longest_ago_is_next() {
        let job = |waiting, working, served| Job { waiting, working, served };
        let next = |jobs: &[Job]| {
            let jobs = jobs.iter().copied().enumerate().map(|(number, job)| (number as u64, job)).collect();
            State { jobs, ..State::default() }.next()
        };
        assert_eq!(next(&[job(0, 0, 0), job(0, 1, 5)]), None);
        assert_eq!(next(&[job(2, 1, 1), job(1, 0, 9)]), Some(1));
        assert_eq!(next(&[job(1, 0, 7), job(1, 0, 3), job(4, 0, 8)]), Some(1));
        assert_eq!(next(&[job(1, 0, 7), job(1, 0, 0)]), Some(1), "new");
        assert_eq!(next(&[job(1, 0, 0), job(1, 0, 0)]), Some(0), "the first of equals");
    }

    /// A panicking piece releases its turn.
    #[test]
    fn a_panic_releases_its_turn() {
        let turns = Arc::new(Turns::new(2));
        let panics = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            turns.begin().piece(|| panic!("planted"));
        }));
        assert!(panics.is_err());
        let counted = Mutex::new(0);
        turns.begin().each(100, &|_| *counted.lock().unwrap() += 1);
        assert_eq!((*counted.lock().unwrap(), turns.lock().taken), (100, 0));
    }
}
