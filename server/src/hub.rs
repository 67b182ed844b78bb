//! From one fit thread to many subscribers. Publishing waits for none of them: estimates are written once into a ring of bounded
//! bytes, in which each subscriber has a place of its own; who falls out of it goes on with the oldest and is told how many were
//! lost. Each target is a stream of its own: what is newest, and what was dropped, is told for each.

mod subscription;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Instant;

use isophote_wire::{EstimateView, TraceView};
use tokio::sync::Notify;

use crate::counters::Tally;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::prompt;
use crate::ring::EstimateRing;
use crate::written::WrittenEstimate;
use subscription::Cursor;
pub use subscription::{Next, Subscription};

/// What a subscriber gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The newest estimate of each target, whenever it has credit.
    #[default]
    Latest,
    /// Every estimate, as long as the ring has it.
    All,
    /// No estimate, only the end. No client can ask for it.
    #[serde(skip)]
    End,
}

/// Why there will be no more estimates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// The service stops.
    ServiceStops,
    /// The session was stopped or replaced.
    SessionStopped,
    /// The source has ended, or cannot deliver; the session stands.
    SourceEnded(String),
    /// The session cannot go on.
    SessionFailed(String),
    /// Who subscribed may do so no more.
    Revoked,
    /// The client's system has taken nothing for too long.
    Unreachable,
}

/// The estimates of one session.
#[derive(Default)]
pub struct Hub {
    state: Mutex<State>,
    changed: Notify,
    /// Frames that subscribers were told to have missed.
    dropped: Tally,
    /// Subscribers who want the steps of the fits.
    tracers: AtomicUsize,
}

/// What a session's subscribers are, and cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HubLoad {
    /// How many there are.
    pub subscribers: usize,
    /// Bytes of estimates that are kept for them.
    pub ring_bytes: usize,
    /// Frames that all of them were told to have missed.
    pub dropped: u64,
}

#[derive(Default)]
struct State {
    ring: EstimateRing,
    subscribers: usize,
    /// By target.
    last: BTreeMap<String, Last>,
    end: Option<End>,
}

struct Last {
    number: u64,
    estimate: Arc<EstimateView>,
    trace: Arc<[TraceView]>,
    /// Written by the first who needs it.
    written: Arc<OnceLock<Arc<WrittenEstimate>>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Hands an estimate to every subscriber.
    pub fn publish(&self, estimate: Arc<EstimateView>) {
        self.publish_traced(estimate, &[]);
    }

    /// Whether anybody wants the steps of the fits.
    pub fn is_traced(&self) -> bool {
        self.tracers.load(Ordering::Relaxed) > 0
    }

    /// The same with the steps of its fit, for those who want them.
    pub fn publish_traced(&self, estimate: Arc<EstimateView>, trace: &[TraceView]) {
        let written = Arc::new(OnceLock::new());
        let (is_wanted, bytes) = {
            let state = lock(&self.state);
            let last = state.last.get(&estimate.target).and_then(|last| last.written.get());
            (state.ring.is_read(), last.map(|written| written.text_bytes()))
        };
        if is_wanted {
            written.get_or_init(|| WrittenEstimate::of(&estimate, trace, bytes));
        }
        let mut state = lock(&self.state);
        let number = state
            .ring
            .push(Instant::now(), || written.get_or_init(|| WrittenEstimate::of(&estimate, trace, bytes)).clone());
        state.last.insert(estimate.target.clone(), Last { number, estimate, trace: trace.into(), written });
        drop(state);
        prompt::tell(|| self.changed.notify_waiters());
    }

    /// Tells every subscriber, also those to come, that nothing more will come.
    pub fn end(&self, end: End) {
        lock(&self.state).end = Some(end);
        self.changed.notify_waiters();
    }

    /// What subscribers cost now.
    pub fn load(&self) -> HubLoad {
        let state = lock(&self.state);
        HubLoad { subscribers: state.subscribers, ring_bytes: state.ring.bytes(), dropped: self.dropped.count() }
    }

    /// The last estimate, of the first target where there are several.
    pub fn last(&self) -> Option<Arc<EstimateView>> {
        lock(&self.state).last.first_key_value().map(|(_, last)| last.estimate.clone())
    }

    /// Forgets targets that the session does not follow any more.
    pub fn keep(&self, targets: &[String]) {
        lock(&self.state).last.retain(|target, _| targets.contains(target));
    }

    /// A new subscriber. In mode `latest` it begins with the last estimate, in mode `all` with the next one.
    pub fn subscribe(self: &Arc<Hub>, mode: Mode) -> Result<Subscription, Problem> {
        let mut state = lock(&self.state);
        if state.subscribers >= LIMITS.subscribers {
            return Err(Problem::over_limit("subscribers of one session", LIMITS.subscribers));
        }
        state.subscribers += 1;
        let place = match mode {
            Mode::All => Cursor::All(state.ring.join()),
            Mode::Latest => Cursor::Latest(0),
            Mode::End => Cursor::End,
        };
        drop(state);
        Ok(Subscription::new(self.clone(), place))
    }
}
