//! The compile thread: everything that takes milliseconds and changes the service goes through this one queue, in order
//! of arrival. So two swaps in flight are ordered and registry writes need no lock. One model at a time is compiled, its
//! stages on several threads ([`isophote_machine::Threads`]), for the milliseconds that it takes.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread::JoinHandle;

use tokio::sync::oneshot;

use crate::limits::LIMITS;
use crate::problem::Problem;

type Job = Box<dyn FnOnce() + Send>;

/// The handle; `stop` ends the thread.
pub struct Compiler {
    jobs: Mutex<Option<SyncSender<Job>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Compiler {
    /// Starts the thread.
    pub fn start() -> std::io::Result<Compiler> {
        let (sender, receiver): (_, Receiver<Job>) = sync_channel(LIMITS.compile_jobs);
        let work = move || receiver.into_iter().for_each(|job| job());
        let thread = std::thread::Builder::new().name("compile".into()).spawn(work)?;
        Ok(Compiler { jobs: Mutex::new(Some(sender)), thread: Mutex::new(Some(thread)) })
    }

    /// Runs `work` on the compile thread after everything that was handed in before. A panic of `work` is a 500, not
    /// the end of the thread.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        let (reply, answer) = oneshot::channel();
        let job: Job = Box::new(move || {
            let result = catch_unwind(AssertUnwindSafe(work));
            let result = result.unwrap_or_else(|_| Err(Problem::bug("the compile job panicked")));
            drop(reply.send(result)); // the client may have gone
        });
        {
            let jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
            let sender = jobs.as_ref().ok_or_else(Problem::stopping)?;
            sender.try_send(job).map_err(|error| match error {
                TrySendError::Full(_) => Problem::over_limit("compile jobs in the queue", LIMITS.compile_jobs),
                TrySendError::Disconnected(_) => Problem::stopping(),
            })?;
        }
        answer.await.map_err(|_| Problem::stopping())?
    }

    /// Ends the thread after the jobs in the queue.
    pub fn stop(&self) {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).take();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread {
            drop(thread.join()); // jobs' panics are caught
        }
    }
}
