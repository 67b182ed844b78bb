//! `OwnerWatch`: checks that the thread that owns all changes still answers.
//!
//! It asks one question at a time, again and again, and blocks nobody else.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use isophote_machine::monotonic_ns;

use crate::limits::LIMITS;
use crate::service::Service;

/// State of the last question.
#[derive(Debug, Default)]
pub struct OwnerWatch {
    /// When it was asked; 0 once it is answered.
    asked_ns: AtomicU64,
    /// How long the last answer took.
    took_ns: AtomicU64,
}

impl OwnerWatch {
    fn ask(&self, now_ns: u64) {
        self.asked_ns.store(now_ns.max(1), Ordering::Relaxed);
    }

    fn answered(&self, now_ns: u64) {
        let asked_ns = self.asked_ns.swap(0, Ordering::Relaxed);
        self.took_ns.store(now_ns.saturating_sub(asked_ns), Ordering::Relaxed);
    }

    /// How long an answer takes: the pending one, or the last one if that took longer.
    pub fn answer_time(&self) -> Duration {
        let asked_ns = self.asked_ns.load(Ordering::Relaxed);
        let waited_ns = if asked_ns == 0 { 0 } else { monotonic_ns().saturating_sub(asked_ns) };
        Duration::from_nanos(waited_ns.max(self.took_ns.load(Ordering::Relaxed)))
    }

    /// How long an overdue answer has been pending.
    pub fn overdue(&self) -> Option<Duration> {
        let asked_ns = self.asked_ns.load(Ordering::Relaxed);
        let waited = Duration::from_nanos(monotonic_ns().saturating_sub(asked_ns));
        (asked_ns != 0 && waited > LIMITS.answer_time).then_some(waited)
    }
}

/// Polls the owner until the service stops, and checks cameras whose drivers do not return.
pub async fn watch(service: Arc<Service>) {
    let mut pause = tokio::time::interval(LIMITS.watch_time);
    pause.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    while !service.is_draining() {
        pause.tick().await;
        service.look_after_cameras();
        service.watch.ask(monotonic_ns());
        // A full queue is no answer: ask again.
        while service.compiler.run(|_| Ok(())).await.is_err() {
            service.look_after_cameras();
            if service.is_draining() {
                return;
            }
            pause.tick().await;
        }
        service.watch.answered(monotonic_ns());
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::service::machine::Machine;
    use isophote_jit::VectorWidth;
    use std::sync::mpsc::sync_channel;
    use tokio::time::timeout;

    const LONG: Duration = Duration::from_secs(60);

    async fn until(is_so: impl Fn() -> bool) {
        let wait = async {
            while !is_so() {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        timeout(LONG, wait).await.unwrap();
    }

    /// Plants a job that blocks the owner: the service is not ready, says why, and is ready again when the job has ended.
    #[tokio::test]
    async fn a_blocked_owner_makes_the_service_not_ready() {
        let service = Service::open(None, &Arc::new(Machine::of_machine(VectorWidth::default()))).unwrap();
        let watching = tokio::spawn(watch(service.clone()));
        until(|| service.watch.answer_time() > Duration::ZERO).await;
        assert!(service.readiness().is_ok());
        let (release, held) = sync_channel::<()>(0);
        let stuck = service.clone();
        let job = tokio::spawn(async move { stuck.compiler.run(move |_| Ok(held.recv().is_err())).await });
        until(|| service.readiness().is_err()).await;
        let problem = service.readiness().unwrap_err();
        assert_eq!((problem.status.as_u16(), problem.code), (503, "not-ready"));
        assert!(problem.detail.contains("has not answered for"), "{}", problem.detail);
        assert!(service.watch.answer_time() > LIMITS.answer_time);
        drop(release);
        assert!(job.await.unwrap().unwrap());
        until(|| service.readiness().is_ok()).await;
        service.drain();
        assert_eq!(service.readiness().unwrap_err().code, "stopping");
        timeout(LONG, watching).await.unwrap().unwrap();
    }
}
