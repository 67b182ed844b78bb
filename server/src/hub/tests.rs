//! Tests of estimates that subscribers get, and of the frames reported as dropped.

#![allow(clippy::unwrap_used)]

use isophote_wire::TraceView;

use super::*;
use crate::hub::written::{SentEstimate, TraceWish};

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

/// Frame and `dropped` of all waiting estimates.
fn drain(subscription: &mut Subscription) -> Vec<(u64, u64)> {
    let mut taken = Vec::new();
    while let Some(Next::Estimate(told)) = subscription.take() {
        let estimate: EstimateView = serde_json::from_str(&told.json()).unwrap();
        taken.push((estimate.frame, estimate.dropped));
    }
    taken
}

#[test]
fn dropped_counts_frames_skipped_by_the_session_and_by_the_hub() {
    let hub = Arc::new(Hub::default());
    let mut latest = hub.subscribe(Mode::Latest).unwrap();
    let mut all = hub.subscribe(Mode::All).unwrap();
    for frame in [5, 6, 9] {
        hub.publish(estimate(frame)); // the session did not fit 7 and 8
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
fn the_ring_is_bounded_and_lost_frames_are_reported() {
    let hub = Arc::new(Hub::default());
    let (mut first, mut second) = (hub.subscribe(Mode::All).unwrap(), hub.subscribe(Mode::All).unwrap());
    hub.publish(estimate(0));
    assert_eq!(drain(&mut first), [(0, 0)]);
    let bytes = |hub: &Hub| lock(&hub.state).ring.bytes();
    let each = bytes(&hub);
    // Later numbers have more digits, so fewer estimates fit.
    let last = (LIMITS.ring_bytes / each) as u64 + 1000;
    (1..=last).for_each(|frame| hub.publish(estimate(frame)));
    assert!((LIMITS.ring_bytes - 2 * each..=LIMITS.ring_bytes).contains(&bytes(&hub)));
    let taken = drain(&mut first);
    assert!(taken[0].0 > 1000 && taken[0].1 == taken[0].0 - 1, "{:?}", taken[0]);
    assert!(taken[1..].iter().all(|(_, dropped)| *dropped == 0));
    assert_eq!((taken.len() as u64, taken.last()), (last + 1 - taken[0].0, Some(&(last, 0))));
    // A subscriber without an estimate so far has lost none.
    assert_eq!(drain(&mut second)[0], (taken[0].0, 0));
    assert!(bytes(&hub) < 2 * each, "but for the last, what all have had is not kept");
    // Without a subscriber in mode `all` nothing is kept.
    drop((first, second));
    hub.publish(estimate(last + 1));
    assert_eq!(bytes(&hub), 0);
    assert_eq!(drain(&mut hub.subscribe(Mode::Latest).unwrap()), [(last + 1, 0)]);
}

/// Users' names and strings are not mistaken for the key.
#[test]
fn dropped_is_written_to_its_key() {
    let mut estimate = EstimateView::clone(&estimate(7));
    estimate.session = Some("\"dropped\":1".into());
    estimate.file = Some("dropped".into());
    estimate.parameters = [("dropped", 5.0)].into_iter().collect();
    let told = SentEstimate::new(WrittenEstimate::of(&estimate, &[], None), 12, TraceWish::With, None);
    estimate.dropped = 12;
    assert_eq!(serde_json::from_str::<EstimateView>(&told.json()).unwrap(), estimate);
}

/// Only subscribers that asked get traces, in either mode; without one none are made.
#[test]
fn traces_are_sent_on_request() {
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

/// An estimate published between the check and the wait wakes the subscriber.
#[tokio::test]
async fn a_publication_wakes_waiting_subscribers() {
    let hub = Arc::new(Hub::default());
    let mut all = hub.subscribe(Mode::All).unwrap();
    let publishing = hub.clone();
    let publisher = std::thread::Builder::new().name("publish".into());
    let publisher = publisher.spawn(move || (0..2000).for_each(|frame| publishing.publish(estimate(frame)))).unwrap();
    for frame in 0..2000 {
        assert!(matches!(all.next().await, Next::Estimate(told) if told.event_id().frame == frame));
    }
    publisher.join().unwrap();
}

#[test]
fn waiting_estimates_are_sent_before_the_end() {
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
fn end_subscribers_get_no_estimates() {
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
fn unsubscribing_frees_a_slot() {
    let hub = Arc::new(Hub::default());
    let mut held: Vec<Subscription> = (0..LIMITS.subscribers).map(|_| hub.subscribe(Mode::All).unwrap()).collect();
    assert!(hub.subscribe(Mode::All).is_err());
    held.pop();
    assert!(hub.subscribe(Mode::All).is_ok());
}

/// Event id, frame, target and `dropped` of all waiting estimates.
fn events(subscription: &mut Subscription) -> Vec<(String, u64, String, u64)> {
    let mut taken = Vec::new();
    while let Some(Next::Estimate(told)) = subscription.take() {
        let estimate: EstimateView = serde_json::from_str(&told.json()).unwrap();
        taken.push((told.event_id().to_string(), estimate.frame, estimate.target, estimate.dropped));
    }
    taken
}

fn returned(hub: &Arc<Hub>, mode: Mode, id: &str) -> Subscription {
    hub.subscribe(mode).unwrap().returning(Some(id.parse().unwrap()))
}

/// With two targets: wherever the connection breaks, nothing is lost and nothing is sent twice.
#[test]
fn a_reconnecting_reader_continues_after_its_last_event() {
    let hub = Arc::new(Hub::default());
    let publish = |frame| ["0", "1"].iter().for_each(|target| hub.publish(estimate_of(target, frame)));
    let mut first = hub.subscribe(Mode::All).unwrap().returning(None);
    [5, 6, 9].into_iter().for_each(publish); // the session did not fit 7 and 8
    let had = events(&mut first);
    assert_eq!(had.len(), 6);
    drop(first);
    [10, 11].into_iter().for_each(publish);
    for (n, (id, ..)) in had.iter().enumerate() {
        let told = events(&mut returned(&hub, Mode::All, id));
        let told: Vec<_> = told.iter().map(|(_, frame, target, dropped)| (*frame, target.as_str(), *dropped)).collect();
        let all = [(5, "0", 0), (5, "1", 0), (6, "0", 0), (6, "1", 0), (9, "0", 2), (9, "1", 2), (10, "0", 0)];
        let all = [&all[..], &[(10, "1", 0), (11, "0", 0), (11, "1", 0)]].concat();
        assert_eq!(told, all[n + 1..], "after {id}");
        let newest = events(&mut returned(&hub, Mode::Latest, id));
        let newest: Vec<_> = newest.iter().map(|(_, frame, _, dropped)| (*frame, *dropped)).collect();
        // Within a frame it has the frame before of the second target.
        let second = [4, 5, 5, 6, 6, 9][n];
        assert_eq!(newest, [(11, 11 - had[n].1 - 1), (11, 11 - second - 1)], "after {id}");
    }
    assert_eq!(events(&mut returned(&hub, Mode::Latest, "11")), [], "it has the newest");
}

/// Dropped estimates are counted; frame numbers of another life of the session are ignored.
#[test]
fn a_late_reader_gets_dropped_counts_and_another_life_starts_anew() {
    let hub = Arc::new(Hub::default());
    (0..=80).for_each(|frame| hub.publish(estimate(frame)));
    let mut late = returned(&hub, Mode::All, "20@.0");
    hub.publish(estimate(81));
    assert_eq!(drain(&mut late), [(81, 60)]);
    assert_eq!(drain(&mut returned(&hub, Mode::Latest, "20@.0")), [(81, 60)]);
    for other in ["20@.1", "20@other.0", "900@.0"] {
        let mut new = returned(&hub, Mode::Latest, other);
        assert_eq!(drain(&mut new), [(81, 0)], "{other}");
        let mut all = returned(&hub, Mode::All, other);
        hub.publish(estimate(81));
        assert_eq!(drain(&mut all), [(81, 0)], "{other}");
    }
}

#[test]
fn estimates_are_kept_for_a_reconnect_until_the_timeout() {
    let mut ring = EstimateRing::default();
    let written = |frame| WrittenEstimate::of(&estimate(frame), &[], None);
    let now = Instant::now();
    let reader = ring.join();
    ring.keep_had();
    (0..10).for_each(|frame| _ = ring.push(now, || written(frame)));
    while ring.take(reader, |_| true).is_some() {}
    ring.leave(reader, Some(now + LIMITS.return_time));
    ring.push(now, || written(10));
    let again = ring.join();
    ring.go_back(again, |kept| kept.frame > 3);
    assert_eq!(ring.take(again, |_| true).map(|kept| kept.frame), Some(4));
    ring.leave(again, None);
    assert!(ring.bytes() > 0);
    ring.push(now + LIMITS.return_time, || written(11));
    assert_eq!((ring.bytes(), ring.is_read()), (0, false));
}

#[test]
fn every_sends_one_of_n_frames_and_counts_the_rest() {
    let hub = Arc::new(Hub::default());
    let mut all = hub.subscribe(Mode::All).unwrap().every(3);
    let mut latest = hub.subscribe(Mode::Latest).unwrap().every(3);
    let mut newest = Vec::new();
    for frame in [0, 1, 2, 3, 4, 8, 9, 10, 11] {
        hub.publish(estimate(frame));
        newest.extend(drain(&mut latest));
    }
    let told = [(0, 0), (3, 2), (8, 4), (11, 2)];
    assert_eq!((drain(&mut all), newest), (told.to_vec(), told.to_vec()));
    // Frames that `every` skips are not lost.
    assert_eq!(hub.load().dropped, 2 * 2);
    hub.publish(estimate(12));
    hub.end(End::SessionStopped);
    assert_eq!(
        (all.take(), latest.take()),
        (Some(Next::End(End::SessionStopped)), Some(Next::End(End::SessionStopped)))
    );
}
