//! The compile thread: all changes of the service go through its one queue, in order of arrival. So two swaps in flight are
//! ordered, and registry writes need no lock. It compiles one model at a time, its stages on several threads
//! ([`isophote_machine::Threads`]), in milliseconds.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::thread::NamedThread;

type Job = Box<dyn FnOnce(&mut Owner) + Send>;

/// Permission to change what runs. The compile thread has the only one, and lends it to one job after the other.
pub struct Owner(());

impl Owner {
    /// The owner of a new service.
    pub fn new() -> Owner {
        Owner(())
    }
}

/// Handle of the compile thread; `stop` ends it.
pub struct Compiler {
    jobs: Mutex<Option<SyncSender<Job>>>,
    /// A permit for each job in the queue.
    places: Arc<Semaphore>,
    thread: NamedThread,
    is_stopping: Arc<AtomicBool>,
}

impl Compiler {
    /// Starts the thread, which takes the owner.
    pub fn start(mut owner: Owner) -> std::io::Result<Compiler> {
        let (sender, receiver): (_, Receiver<Job>) = sync_channel(LIMITS.compile_jobs);
        let is_stopping = Arc::new(AtomicBool::new(false));
        let is_over = is_stopping.clone();
        // A dropped job closes its reply: its caller gets 503.
        let work = move || {
            let jobs = receiver.into_iter().take_while(|_| !is_over.load(Ordering::SeqCst));
            jobs.for_each(|job| job(&mut owner));
        };
        let thread = NamedThread::start("compile".into(), work)?;
        let places = Arc::new(Semaphore::new(LIMITS.compile_jobs));
        Ok(Compiler { jobs: Mutex::new(Some(sender)), places, thread, is_stopping })
    }

    /// Runs `work` on the compile thread after all jobs queued before it; 429 if the queue is full. A panic of `work` is a 500
    /// and does not end the thread.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Owner) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        self.hand_in(self.place()?, work)?.await.map_err(|_| Problem::stopping())?
    }

    /// The same for work that nobody would retry: waits while the queue is full.
    pub async fn run_in_turn<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Owner) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        let place = self.places.clone().acquire_owned().await.map_err(|_| Problem::stopping())?;
        self.hand_in(place, work)?.await.map_err(|_| Problem::stopping())?
    }

    /// [`Compiler::run`] for callers that may block. Not for asynchronous callers.
    pub fn run_blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Owner) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        self.hand_in(self.place()?, work)?.blocking_recv().map_err(|_| Problem::stopping())?
    }

    fn place(&self) -> Result<OwnedSemaphorePermit, Problem> {
        let place = self.places.clone().try_acquire_owned();
        place.map_err(|_| Problem::over_limit("compile jobs in the queue", LIMITS.compile_jobs))
    }

    /// Queues a job and returns the receiver of its answer.
    fn hand_in<T: Send + 'static>(
        &self,
        place: OwnedSemaphorePermit,
        work: impl FnOnce(&mut Owner) -> Result<T, Problem> + Send + 'static,
    ) -> Result<oneshot::Receiver<Result<T, Problem>>, Problem> {
        let (reply, answer) = oneshot::channel();
        let job: Job = Box::new(move |owner| {
            drop(place); // the job has left the queue
            let result = catch_unwind(AssertUnwindSafe(|| work(owner)));
            let result = result.unwrap_or_else(|_| Err(Problem::bug("the compile job panicked")));
            drop(reply.send(result)); // the client may have gone
        });
        let jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        let sender = jobs.as_ref().ok_or_else(Problem::stopping)?;
        // The permit guarantees a free slot.
        sender.try_send(job).map_err(|_| Problem::stopping())?;
        Ok(answer)
    }

    /// Ends the thread after its present job, and waits for that at most until then.
    pub fn stop(&self, until: Instant) {
        self.is_stopping.store(true, Ordering::SeqCst);
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).take();
        self.thread.wait(until);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A panicking change is answered, and later ones are made.
    #[tokio::test]
    async fn a_panicking_change_does_not_end_the_compile_thread() {
        let compiler = Compiler::start(Owner::new()).unwrap();
        for number in 0..3 {
            let panics = |_: &mut Owner| if std::hint::black_box(true) { panic!("planted") } else { Ok(()) };
            assert_eq!(compiler.run(panics).await.unwrap_err().code, "bug");
            assert_eq!(compiler.run(move |_| Ok(number)).await.unwrap(), number);
        }
    }
}
