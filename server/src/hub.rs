//! From one fit thread to many subscribers. Publishing waits for none of them: estimates are written once into a ring of bounded
//! bytes, in which each subscriber has a place of its own; who falls out of it goes on with the oldest and is told how many were
//! lost. Each target is a stream of its own: what is newest, and what was dropped, is told for each.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use isophote_wire::{EstimateView, TraceView};
use tokio::sync::Notify;

use crate::access::Visitor;
use crate::counters::Tally;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::prompt;
use crate::ring::{EstimateRing, RingReader};
use crate::written::{SentEstimate, TraceWish, WrittenEstimate};

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
        let number = state.ring.push(|| written.get_or_init(|| WrittenEstimate::of(&estimate, trace, bytes)).clone());
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
            Mode::All => Place::All(state.ring.join()),
            Mode::Latest => Place::Latest(0),
            Mode::End => Place::End,
        };
        drop(state);
        let (hub, last_frames, visitor, wish) = (self.clone(), BTreeMap::new(), Visitor::Anyone, TraceWish::Without);
        Ok(Subscription { hub, place, last_frames, visitor, wish })
    }
}

impl State {
    /// The oldest of the newest of each target, of those from that number on.
    fn newest(&self, from: u64) -> Option<&Last> {
        self.last.values().filter(|last| last.number >= from).min_by_key(|last| last.number)
    }
}

/// Where a subscriber is.
enum Place {
    All(RingReader),
    /// It had all that it gets of those before this number.
    Latest(u64),
    End,
}

/// What is written, or will be outside of the lock.
enum Found {
    Written(Arc<WrittenEstimate>),
    Last(Arc<EstimateView>, Arc<[TraceView]>, Arc<OnceLock<Arc<WrittenEstimate>>>),
}

/// What a subscriber is handed.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// An estimate.
    Estimate(SentEstimate),
    /// There are no more.
    End(End),
}

/// One subscriber; dropping it unsubscribes.
pub struct Subscription {
    hub: Arc<Hub>,
    place: Place,
    /// By target.
    last_frames: BTreeMap<String, u64>,
    visitor: Visitor,
    wish: TraceWish,
}

impl Subscription {
    /// It ends when this visitor's token is revoked.
    pub fn of(mut self, visitor: Visitor) -> Subscription {
        self.visitor = visitor;
        self
    }

    /// It has the steps of the fits as well, if it wants them.
    pub fn with_trace(mut self, wish: TraceWish) -> Subscription {
        if wish == TraceWish::With && self.wish == TraceWish::Without {
            self.hub.tracers.fetch_add(1, Ordering::Relaxed);
            self.wish = wish;
        }
        self
    }

    /// The next estimate, as soon as there is one. Nothing is lost when the future is dropped.
    pub async fn next(&mut self) -> Next {
        let visitor = self.visitor.clone();
        tokio::select! {
            biased;
            () = visitor.revoked() => Next::End(End::Revoked),
            next = self.published() => next,
        }
    }

    async fn published(&mut self) -> Next {
        let hub = self.hub.clone();
        loop {
            let changed = hub.changed.notified(); // before looking: what comes after that is not missed
            if let Some(next) = self.take() {
                return next;
            }
            changed.await;
        }
    }

    /// The end, for a subscriber without credit or in mode `End`: at once when the service stops, else when nothing waits any more.
    pub async fn end(&mut self) -> Next {
        let visitor = self.visitor.clone();
        tokio::select! {
            biased;
            () = visitor.revoked() => Next::End(End::Revoked),
            next = self.ended() => next,
        }
    }

    async fn ended(&mut self) -> Next {
        loop {
            let changed = self.hub.changed.notified();
            {
                let state = lock(&self.hub.state);
                let is_done = || match &self.place {
                    Place::All(reader) => !state.ring.has(*reader),
                    Place::Latest(next) => state.newest(*next).is_none(),
                    Place::End => true,
                };
                match &state.end {
                    Some(end) if *end == End::ServiceStops || is_done() => return Next::End(end.clone()),
                    _ => {}
                }
            }
            changed.await;
        }
    }

    fn take(&mut self) -> Option<Next> {
        let mut state = lock(&self.hub.state);
        let found = match &mut self.place {
            Place::All(reader) => state.ring.take(*reader).map(Found::Written),
            Place::Latest(next) => state.newest(*next).map(|last| {
                *next = last.number + 1;
                Found::Last(last.estimate.clone(), last.trace.clone(), last.written.clone())
            }),
            Place::End => None,
        };
        let Some(found) = found else { return state.end.clone().map(Next::End) };
        drop(state);
        let written = match found {
            Found::Written(written) => written,
            Found::Last(estimate, trace, written) => {
                written.get_or_init(|| WrittenEstimate::of(&estimate, &trace, None)).clone()
            }
        };
        let last = self.last_frames.insert(written.target.clone(), written.frame);
        let dropped = last.map_or(0, |last| written.frame.saturating_sub(last).saturating_sub(1));
        self.hub.dropped.add(dropped);
        Some(Next::Estimate(SentEstimate::new(written, dropped, self.wish)))
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        if self.wish == TraceWish::With {
            self.hub.tracers.fetch_sub(1, Ordering::Relaxed);
        }
        let mut state = lock(&self.hub.state);
        state.subscribers -= 1;
        if let Place::All(reader) = self.place {
            state.ring.leave(reader);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn estimate(frame: u64) -> Arc<EstimateView> {
        estimate_of("0", frame)
    }

    fn estimate_of(target: &str, frame: u64) -> Arc<EstimateView> {
        let document = serde_json::json!({
            "target": target, "frame": frame, "model": "m@sha256:0", "state": "tracking", "parameters": {}, "order": [],
            "pixels": 0, "saturated": 0.0, "iterations": [], "converged": true, "ending": "small-step",
        });
        Arc::new(serde_json::from_value(document).unwrap())
    }

    /// Frame and `dropped` of everything that waits.
    fn drain(subscription: &mut Subscription) -> Vec<(u64, u64)> {
        let mut taken = Vec::new();
        while let Some(Next::Estimate(told)) = subscription.take() {
            let estimate: EstimateView = serde_json::from_str(&told.json()).unwrap();
            taken.push((estimate.frame, estimate.dropped));
        }
        taken
    }

    #[test]
    fn dropped_is_exact_whoever_dropped() {
        let hub = Arc::new(Hub::default());
        let mut latest = hub.subscribe(Mode::Latest).unwrap();
        let mut all = hub.subscribe(Mode::All).unwrap();
        for frame in [5, 6, 9] {
            hub.publish(estimate(frame)); // 7 and 8 the session did not fit
        }
        assert_eq!(drain(&mut latest), [(9, 0)]);
        assert_eq!(drain(&mut all), [(5, 0), (6, 0), (9, 2)]);
        for frame in [10, 11, 12] {
            hub.publish(estimate(frame));
        }
        assert_eq!(drain(&mut latest), [(12, 2)]);
        assert_eq!(drain(&mut all), [(10, 0), (11, 0), (12, 0)]);
        assert_eq!(drain(&mut hub.subscribe(Mode::Latest).unwrap()), [(12, 0)], "begins with the last one");
        assert_eq!(drain(&mut hub.subscribe(Mode::All).unwrap()), []);
    }

    #[test]
    fn each_target_is_a_stream_of_its_own() {
        let hub = Arc::new(Hub::default());
        let mut latest = hub.subscribe(Mode::Latest).unwrap();
        let mut all = hub.subscribe(Mode::All).unwrap();
        for frame in [1, 2, 5] {
            hub.publish(estimate_of("0", frame));
            hub.publish(estimate_of("1", frame));
        }
        assert_eq!(drain(&mut latest), [(5, 0), (5, 0)], "the newest of each");
        assert_eq!(drain(&mut all), [(1, 0), (1, 0), (2, 0), (2, 0), (5, 2), (5, 2)]);
        for frame in [6, 7] {
            hub.publish(estimate_of("0", frame));
            hub.publish(estimate_of("1", frame));
        }
        assert_eq!(drain(&mut latest), [(7, 1), (7, 1)]);
        assert_eq!(drain(&mut hub.subscribe(Mode::Latest).unwrap()).len(), 2);
        assert_eq!(hub.last().unwrap().target, "0");
        hub.keep(&["1".to_string()]);
        assert_eq!(drain(&mut hub.subscribe(Mode::Latest).unwrap()), [(7, 0)]);
    }

    #[test]
    fn the_ring_is_bounded_and_says_what_was_lost() {
        let hub = Arc::new(Hub::default());
        let (mut first, mut second) = (hub.subscribe(Mode::All).unwrap(), hub.subscribe(Mode::All).unwrap());
        hub.publish(estimate(0));
        assert_eq!(drain(&mut first), [(0, 0)]);
        let bytes = |hub: &Hub| lock(&hub.state).ring.bytes();
        let each = bytes(&hub);
        // Its numbers have more digits later: then fewer fit.
        let last = (LIMITS.ring_bytes / each) as u64 + 1000;
        (1..=last).for_each(|frame| hub.publish(estimate(frame)));
        assert!((LIMITS.ring_bytes - 2 * each..=LIMITS.ring_bytes).contains(&bytes(&hub)));
        let taken = drain(&mut first);
        assert!(taken[0].0 > 1000 && taken[0].1 == taken[0].0 - 1, "{:?}", taken[0]);
        assert!(taken[1..].iter().all(|(_, dropped)| *dropped == 0));
        assert_eq!((taken.len() as u64, taken.last()), (last + 1 - taken[0].0, Some(&(last, 0))));
        // Who never had one has lost none that it was told of.
        assert_eq!(drain(&mut second)[0], (taken[0].0, 0));
        assert!(bytes(&hub) < 2 * each, "but for the last, what all have had is not kept");
        // Where nobody wants all, nothing is kept.
        drop((first, second));
        hub.publish(estimate(last + 1));
        assert_eq!(bytes(&hub), 0);
        assert_eq!(drain(&mut hub.subscribe(Mode::Latest).unwrap()), [(last + 1, 0)]);
    }

    /// Names and strings of the user's are not taken for the number.
    #[test]
    fn dropped_stands_where_it_belongs() {
        let mut estimate = EstimateView::clone(&estimate(7));
        estimate.session = Some("\"dropped\":1".into());
        estimate.file = Some("dropped".into());
        estimate.parameters = [("dropped", 5.0)].into_iter().collect();
        let told = SentEstimate::new(WrittenEstimate::of(&estimate, &[], None), 12, TraceWish::With);
        estimate.dropped = 12;
        assert_eq!(serde_json::from_str::<EstimateView>(&told.json()).unwrap(), estimate);
    }

    /// Only those who asked are told the steps, in either mode, and only as long as one asks are there any.
    #[test]
    fn steps_are_told_to_those_who_ask() {
        let hub = Arc::new(Hub::default());
        let trace = [TraceView { stage: 0, pass: 1, objective: Some(2.5), radius: None, ratio: Some(0.9) }];
        let mut told = Vec::new();
        for mode in [Mode::All, Mode::Latest] {
            let (mut plain, asking) = (hub.subscribe(mode).unwrap(), hub.subscribe(mode).unwrap());
            assert!(!hub.is_traced());
            let mut asking = asking.with_trace(TraceWish::With);
            assert!(hub.is_traced());
            hub.publish_traced(estimate(3), &trace);
            for subscriber in [&mut plain, &mut asking] {
                let Some(Next::Estimate(sent)) = subscriber.take() else { panic!("{mode:?}: nothing") };
                told.push(serde_json::from_str::<EstimateView>(&sent.json()).unwrap().trace);
            }
        }
        assert!(!hub.is_traced());
        assert_eq!(told, [vec![], trace.to_vec(), vec![], trace.to_vec()]);
    }

    /// An estimate that comes between looking and waiting wakes who waits.
    #[tokio::test]
    async fn who_waits_is_woken() {
        let hub = Arc::new(Hub::default());
        let mut all = hub.subscribe(Mode::All).unwrap();
        let publishing = hub.clone();
        let publisher = std::thread::Builder::new().name("publish".into());
        let publisher =
            publisher.spawn(move || (0..2000).for_each(|frame| publishing.publish(estimate(frame)))).unwrap();
        for frame in 0..2000 {
            assert!(matches!(all.next().await, Next::Estimate(told) if told.frame() == frame));
        }
        publisher.join().unwrap();
    }

    #[test]
    fn what_waits_comes_before_the_end() {
        let hub = Arc::new(Hub::default());
        let mut all = hub.subscribe(Mode::All).unwrap();
        hub.publish(estimate(0));
        hub.end(End::SessionStopped);
        assert_eq!(drain(&mut all), [(0, 0)]);
        assert_eq!(all.take(), Some(Next::End(End::SessionStopped)));
        let mut late = hub.subscribe(Mode::All).unwrap();
        assert_eq!(late.take(), Some(Next::End(End::SessionStopped)));
    }

    #[test]
    fn who_waits_for_the_end_gets_nothing_else() {
        let hub = Arc::new(Hub::default());
        hub.publish(estimate(0));
        let mut end = hub.subscribe(Mode::End).unwrap();
        hub.publish(estimate(1));
        assert_eq!(end.take(), None);
        hub.end(End::SessionStopped);
        assert_eq!(end.take(), Some(Next::End(End::SessionStopped)));
        assert!(serde_json::from_str::<Mode>("\"end\"").is_err());
    }

    #[test]
    fn leaving_makes_room() {
        let hub = Arc::new(Hub::default());
        let mut held: Vec<Subscription> = (0..LIMITS.subscribers).map(|_| hub.subscribe(Mode::All).unwrap()).collect();
        assert!(hub.subscribe(Mode::All).is_err());
        held.pop();
        assert!(hub.subscribe(Mode::All).is_ok());
    }
}
