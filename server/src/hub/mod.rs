//! `Hub`: publishes the estimates of one fit thread to many subscribers. Publishing waits for none of them: an estimate is
//! written once into a ring of bounded bytes, in which each subscriber has a cursor. A subscriber that falls behind continues
//! with the oldest estimate and learns how many it lost. Newest estimate and `dropped` are per target.

pub mod event_id;
mod ring;
mod subscription;
#[cfg(test)]
mod tests;
pub mod written;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Instant;

use isophote_wire::{EstimateView, TraceView};
use tokio::sync::Notify;

use crate::counters::Tally;
use crate::hub::ring::EstimateRing;
use crate::hub::written::WrittenEstimate;
use crate::limits::LIMITS;
use crate::problem::Problem;
use subscription::Cursor;
pub use subscription::{Next, Subscription};

/// Selection of the estimates that a subscriber receives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The newest estimate of each target, while the subscriber has credit.
    #[default]
    Latest,
    /// Every estimate that the ring still holds.
    All,
    /// No estimates, only the end of the stream. Clients cannot request it.
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
    /// The source has ended, or cannot deliver; the session remains.
    SourceEnded(String),
    /// The session cannot go on.
    SessionFailed(String),
    /// The subscriber's token was revoked.
    Revoked,
    /// The client acknowledged nothing for too long.
    Unreachable,
}

/// The estimates of one session.
#[derive(Default)]
pub struct Hub {
    state: Mutex<State>,
    changed: Notify,
    /// Frames reported to subscribers as dropped.
    dropped: Tally,
    /// Subscribers that want traces of the fits.
    tracers: AtomicUsize,
}

/// Number and cost of a session's subscribers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HubLoad {
    /// Number of subscribers.
    pub subscribers: usize,
    /// Bytes of estimates kept for them.
    pub ring_bytes: usize,
    /// Frames reported to all of them as dropped.
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
    /// Written when it is first needed.
    written: Arc<OnceLock<Arc<WrittenEstimate>>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Publishes an estimate to every subscriber.
    pub fn publish(&self, estimate: Arc<EstimateView>) {
        self.publish_traced(estimate, &[]);
    }

    /// Whether a subscriber wants traces of the fits.
    pub fn is_traced(&self) -> bool {
        self.tracers.load(Ordering::Relaxed) > 0
    }

    /// The same with the trace of its fit, for subscribers that want it.
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
        self.changed.notify_waiters();
    }

    /// Ends the stream of every subscriber, also of later ones.
    pub fn end(&self, end: End) {
        lock(&self.state).end = Some(end);
        self.changed.notify_waiters();
    }

    /// The present cost of subscribers.
    pub fn load(&self) -> HubLoad {
        let state = lock(&self.state);
        HubLoad { subscribers: state.subscribers, ring_bytes: state.ring.bytes(), dropped: self.dropped.count() }
    }

    /// The last estimate of the first target.
    pub fn last(&self) -> Option<Arc<EstimateView>> {
        lock(&self.state).last.first_key_value().map(|(_, last)| last.estimate.clone())
    }

    /// Forgets targets that the session no longer tracks.
    pub fn keep(&self, targets: &[String]) {
        lock(&self.state).last.retain(|target, _| targets.contains(target));
    }

    /// Adds a subscriber. In mode `latest` it begins with the last estimate, in mode `all` with the next one.
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
