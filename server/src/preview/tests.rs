//! Tests of waiting viewers, with frames of a few pixels.

#![allow(clippy::unwrap_used)]

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Plane, Tracker, TrackerOptions};

use super::*;

#[test]
fn a_viewer_waits_until_its_message_fits_the_quota() {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/gaussian.toml")).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let viewer = Arc::new(Tracker::new(compiled, TrackerOptions::default()).unwrap().viewer());
    let scene = |number| {
        let frame = Frame::new(&[8, 6], vec![Plane::owned(PixelFormat::U8, vec![0; 48], 8)]).unwrap();
        let (estimates, views, session) = (Arc::default(), Arc::default(), "one".to_string());
        let frame = frame.with_sequence(number);
        FittedScene { frame, estimates, views, viewer: viewer.clone(), session, epoch: 1 }
    };
    let (preview, quota) = (Arc::new(Preview::new(|| ())), SharedQuota::new(10_000));
    let others = quota.try_take(9_900).unwrap();
    let wait_for = |is_there: &dyn Fn() -> bool| {
        while !is_there() {
            std::thread::yield_now();
        }
    };
    let seat = preview.look("one", quota.clone()).unwrap();
    let (format, part, now) = (PreviewFormat::Raw8, PreviewPart::Frame, Instant::now());
    let mut shown = seat.ask(PreviewForm { format, part, step: 1, quality: 0 }, now, now, 0);
    wait_for(&|| preview.is_wanted());
    preview.show(scene(0));
    wait_for(&|| preview.messages.count() == 1 && preview.is_wanted());
    assert!(shown.try_recv().is_err(), "its message has more than 100 bytes");
    drop(others);
    preview.show(scene(1));
    let ShownFrame { number, message, quota: taken } = shown.blocking_recv().unwrap();
    assert_eq!((number, quota.taken()), (1, message.len()));
    drop(taken);
    assert_eq!(quota.taken(), 0);
}
