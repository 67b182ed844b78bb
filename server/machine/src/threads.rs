//! Threads that derive and compile a model's stages concurrently.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use isophote_tracker::Workers;

/// As many named threads as there are processors, four at most, for as long as a piece of work takes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Threads;

/// Limit of threads: more would wait for the largest stage.
const THREADS_MAX: usize = 4;

impl Workers for Threads {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let take = || {
            loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                if i >= count {
                    return;
                }
                work(i);
            }
        };
        let processors = thread::available_parallelism().map_or(1, usize::from);
        thread::scope(|scope| {
            for number in 1..processors.min(THREADS_MAX).min(count) {
                let thread = thread::Builder::new().name(format!("compile-{number}"));
                // If no thread can be spawned, this one does all.
                if thread.spawn_scoped(scope, take).is_err() {
                    break;
                }
            }
            take();
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[test]
    fn each_index_is_processed_once() {
        for count in [0, 1, 2, 3, 100] {
            let seen = Mutex::new(Vec::new());
            Threads.each(count, &|i| seen.lock().unwrap().push(i));
            let mut seen = seen.into_inner().unwrap();
            seen.sort_unstable();
            assert_eq!(seen, (0..count).collect::<Vec<_>>());
        }
    }
}
