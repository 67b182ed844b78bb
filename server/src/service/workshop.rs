//! `Workshop`: prepares changes on threads of their own; the compile thread only commits them.
//!
//! Changes of one target (a model or a session) are prepared and committed in order of arrival; those of different targets do
//! not wait for each other. Uploads share the processors piece by piece, and sessions have turns of their own: a client that
//! uploads slow documents delays nobody's swap.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::Builder;

use tokio::sync::{OwnedMutexGuard, Semaphore, oneshot};

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::service::turns::{FairWorkers, Turns};
use crate::thread::step_aside;

/// The queue that work belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Uploaded documents.
    Uploads,
    /// Sessions that run or start.
    Sessions,
}

/// Turns to compile, shared by all tenants.
#[derive(Clone)]
pub struct CompileTurns {
    uploads: Arc<Turns>,
    sessions: Arc<Turns>,
}

/// Prepares the changes of one tenant.
pub struct Workshop {
    turns: CompileTurns,
    jobs: Arc<Semaphore>,
    targets: Mutex<BTreeMap<String, Weak<Order>>>,
}

type Order = tokio::sync::Mutex<()>;

impl CompileTurns {
    /// Uploads run as many pieces at a time as there are processors; so do sessions, but at least two.
    pub fn of_machine() -> CompileTurns {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        CompileTurns { uploads: Arc::new(Turns::new(processors)), sessions: Arc::new(Turns::new(processors.max(2))) }
    }
}

impl Workshop {
    /// A workshop that takes those turns.
    pub fn new(turns: CompileTurns) -> Workshop {
        Workshop { turns, jobs: Arc::new(Semaphore::new(LIMITS.compile_jobs)), targets: Mutex::default() }
    }

    /// Waits for all earlier changes of the target; hold the guard until this change is done.
    pub async fn in_order(&self, what: &str, name: &str) -> OwnedMutexGuard<()> {
        let order = {
            let mut targets = self.targets.lock().unwrap_or_else(PoisonError::into_inner);
            targets.retain(|_, order| order.strong_count() > 0);
            let key = format!("{what} {name}");
            let known = targets.get(&key).and_then(Weak::upgrade);
            known.unwrap_or_else(|| {
                let order = Arc::new(Order::default());
                targets.insert(key, Arc::downgrade(&order));
                order
            })
        };
        order.lock_owned().await
    }

    /// Workers for a caller that waits anyway: during startup.
    pub fn at_once(&self) -> FairWorkers {
        self.turns.uploads.begin()
    }

    /// Runs `work` on a thread of its own, at a lower priority than fits. A panic of `work` is a 500.
    pub async fn prepare<T: Send + 'static>(
        &self,
        lane: Lane,
        work: impl FnOnce(&FairWorkers) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        let place = self.jobs.clone().try_acquire_owned();
        let place = place.map_err(|_| Problem::over_limit("compile jobs in the queue", LIMITS.compile_jobs))?;
        let (turns, nicer) = match lane {
            Lane::Sessions => (&self.turns.sessions, 3),
            Lane::Uploads => (&self.turns.uploads, 10),
        };
        let workers = turns.begin();
        let (reply, answer) = oneshot::channel();
        let work = move || {
            step_aside(nicer);
            let result = catch_unwind(AssertUnwindSafe(|| work(&workers)));
            drop((workers, place));
            let result = result.unwrap_or_else(|_| Err(Problem::bug("the compile job panicked")));
            drop(reply.send(result)); // the client may have gone
        };
        let thread = Builder::new().name("prepare".into()).spawn(work);
        thread.map_err(|error| Problem::no_thread("to compile on", &error))?;
        answer.await.map_err(|_| Problem::stopping())?
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;
    use tokio::time::timeout;

    const SOON: Duration = Duration::from_millis(1);

    #[tokio::test]
    async fn changes_of_one_target_are_made_in_order() {
        let workshop = Workshop::new(CompileTurns::of_machine());
        let first = workshop.in_order("model", "a").await;
        let mut second = Box::pin(workshop.in_order("model", "a"));
        assert!(timeout(SOON, &mut second).await.is_err());
        drop(workshop.in_order("session", "a").await);
        drop(workshop.in_order("model", "b").await);
        let mut third = Box::pin(workshop.in_order("model", "a"));
        assert!(timeout(SOON, &mut third).await.is_err());
        drop(first);
        assert!(timeout(SOON, &mut third).await.is_err(), "the second is before it");
        drop(second.await);
        drop(third.await);
        drop(workshop.in_order("model", "c").await);
        assert_eq!(workshop.targets.lock().unwrap().len(), 1, "only what is under way is kept");
    }

    #[tokio::test]
    async fn panicking_work_is_a_bug_and_returns_its_permit() {
        let workshop = Workshop::new(CompileTurns::of_machine());
        for _ in 0..=LIMITS.compile_jobs {
            let work = |_: &FairWorkers| -> Result<(), Problem> { panic!("planted") };
            assert_eq!(workshop.prepare(Lane::Uploads, work).await.unwrap_err().code, "bug");
        }
        assert_eq!(workshop.prepare(Lane::Sessions, |workers| Ok(workers.piece(|| 7))).await.unwrap(), 7);
    }
}
