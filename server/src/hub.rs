//! From one fit thread to many subscribers. Publishing never waits: a slow subscriber loses messages and is told how many.
//! Each target is a stream of its own: what is newest, and what was dropped, is told for each.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use isophote_wire::EstimateView;
use tokio::sync::Notify;

use crate::limits::LIMITS;
use crate::problem::Problem;

/// What a subscriber gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The newest estimate of each target, whenever it has credit.
    #[default]
    Latest,
    /// Every estimate, up to the queue's bound; then the oldest go.
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
}

/// The estimates of one session.
#[derive(Default)]
pub struct Hub {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    subscribers: Vec<Arc<Subscriber>>,
    /// By target.
    last: BTreeMap<String, Arc<EstimateView>>,
    end: Option<End>,
}

struct Subscriber {
    mode: Mode,
    queue: Mutex<Queue>,
    wake: Notify,
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<Arc<EstimateView>>,
    end: Option<End>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Hands an estimate to every subscriber.
    pub fn publish(&self, estimate: Arc<EstimateView>) {
        let mut state = lock(&self.state);
        state.last.insert(estimate.target.clone(), estimate.clone());
        for subscriber in &state.subscribers {
            subscriber.push(estimate.clone());
        }
    }

    /// Tells every subscriber, also those to come, that nothing more will come.
    pub fn end(&self, end: End) {
        let mut state = lock(&self.state);
        for subscriber in &state.subscribers {
            lock(&subscriber.queue).end = Some(end.clone());
            subscriber.wake.notify_one();
        }
        state.end = Some(end);
    }

    /// The last estimate, of the first target where there are several.
    pub fn last(&self) -> Option<Arc<EstimateView>> {
        lock(&self.state).last.first_key_value().map(|(_, estimate)| estimate.clone())
    }

    /// Forgets targets that the session does not follow any more.
    pub fn keep(&self, targets: &[String]) {
        lock(&self.state).last.retain(|target, _| targets.contains(target));
    }

    /// A new subscriber. In mode `latest` it begins with the last estimate, in mode `all` with the next one.
    pub fn subscribe(self: &Arc<Hub>, mode: Mode) -> Result<Subscription, Problem> {
        let mut state = lock(&self.state);
        if state.subscribers.len() >= LIMITS.subscribers {
            return Err(Problem::over_limit("subscribers of one session", LIMITS.subscribers));
        }
        let mut queue = Queue { waiting: VecDeque::new(), end: state.end.clone() };
        if mode == Mode::Latest {
            queue.waiting.extend(state.last.values().cloned());
        }
        let subscriber = Arc::new(Subscriber { mode, queue: Mutex::new(queue), wake: Notify::new() });
        state.subscribers.push(subscriber.clone());
        Ok(Subscription { hub: self.clone(), subscriber, last_frames: BTreeMap::new() })
    }
}

impl Subscriber {
    fn push(&self, estimate: Arc<EstimateView>) {
        if self.mode == Mode::End {
            return;
        }
        let mut queue = lock(&self.queue);
        if self.mode == Mode::Latest {
            queue.waiting.retain(|waiting| waiting.target != estimate.target);
        } else if queue.waiting.len() == LIMITS.queue {
            queue.waiting.pop_front();
        }
        queue.waiting.push_back(estimate);
        drop(queue);
        self.wake.notify_one();
    }
}

/// What a subscriber is handed.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// An estimate, `dropped` filled in.
    Estimate(Box<EstimateView>),
    /// There are no more.
    End(End),
}

/// One subscriber; dropping it unsubscribes.
pub struct Subscription {
    hub: Arc<Hub>,
    subscriber: Arc<Subscriber>,
    /// By target.
    last_frames: BTreeMap<String, u64>,
}

impl Subscription {
    /// What was asked for.
    pub fn mode(&self) -> Mode {
        self.subscriber.mode
    }

    /// The next estimate, as soon as there is one. Nothing is lost when the future is dropped.
    pub async fn next(&mut self) -> Next {
        loop {
            if let Some(next) = self.take() {
                return next;
            }
            self.subscriber.wake.notified().await;
        }
    }

    /// The end, for a subscriber without credit or in mode `End`: at once when the service stops, else when nothing waits any more.
    pub async fn end(&mut self) -> Next {
        loop {
            {
                let queue = lock(&self.subscriber.queue);
                match &queue.end {
                    Some(end) if queue.waiting.is_empty() || *end == End::ServiceStops => {
                        return Next::End(end.clone());
                    }
                    _ => {}
                }
            }
            self.subscriber.wake.notified().await;
        }
    }

    fn take(&mut self) -> Option<Next> {
        let mut queue = lock(&self.subscriber.queue);
        let Some(estimate) = queue.waiting.pop_front() else {
            return queue.end.clone().map(Next::End);
        };
        drop(queue);
        let mut estimate = Box::new(EstimateView::clone(&estimate));
        let last = self.last_frames.insert(estimate.target.clone(), estimate.frame);
        estimate.dropped = last.map_or(0, |last| estimate.frame.saturating_sub(last).saturating_sub(1));
        Some(Next::Estimate(estimate))
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        lock(&self.hub.state).subscribers.retain(|one| !Arc::ptr_eq(one, &self.subscriber));
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
        while let Some(Next::Estimate(estimate)) = subscription.take() {
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
    fn the_queue_is_bounded_and_says_what_it_lost() {
        let hub = Arc::new(Hub::default());
        let mut all = hub.subscribe(Mode::All).unwrap();
        hub.publish(estimate(0));
        assert_eq!(drain(&mut all), [(0, 0)]);
        let last = LIMITS.queue as u64 + 3;
        (1..=last).for_each(|frame| hub.publish(estimate(frame)));
        let taken = drain(&mut all);
        assert_eq!(taken.len(), LIMITS.queue);
        assert_eq!((taken[0], taken[1]), ((4, 3), (5, 0)));
        assert_eq!(taken.last(), Some(&(last, 0)));
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
