//! Cameras whose drivers do not come back, made of software: what is said of them, and how a source goes on.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use isophote_capture::camera::CameraStatus;
use isophote_capture::{CameraState, Captured, Exposure, Wake};
use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};
use isophote_wire::{CameraDocument, Pace, SourceDocument, SourceState};

use super::{CameraReader, Drivers, FrameShape, Opened, Producer, Source};
use crate::limits::LIMITS;
use crate::session::inbox::{Event, Inbox};

/// In place of a plugging: calls that close it.
const CLOSING: usize = usize::MAX;

/// What all who read one camera talk to.
#[derive(Default)]
pub struct TestDriver {
    /// How often it was plugged in again.
    plugged: AtomicUsize,
    /// Calls to it do not return, of which pluggings.
    hangs: Mutex<BTreeSet<usize>>,
    changed: Condvar,
}

impl TestDriver {
    pub fn hang(&self, plugging: usize) {
        self.hangs.lock().unwrap().insert(plugging);
    }

    pub fn release(&self) {
        self.hangs.lock().unwrap().clear();
        self.changed.notify_all();
    }

    fn call(&self, plugging: usize) {
        let hangs = self.hangs.lock().unwrap();
        drop(self.changed.wait_while(hangs, |hangs| hangs.contains(&plugging)).unwrap());
    }
}

struct TestCamera {
    driver: Arc<TestDriver>,
    /// Which plugging it has open.
    open: Option<usize>,
    state: CameraState,
    status: CameraStatus,
    number: u64,
    wake: Wake,
}

impl CameraReader for TestCamera {
    fn next(&mut self, _limit: Duration) -> Option<Captured> {
        self.state = CameraState::Running;
        self.driver.call(*self.open.get_or_insert_with(|| self.driver.plugged.load(Ordering::SeqCst)));
        std::thread::yield_now();
        let frame = Frame::new(&[8, 8], vec![Plane::owned(PixelFormat::U8, vec![7; 64], 8)]).unwrap();
        self.number += 1;
        Some(Captured { frame: frame.with_sequence(self.number - 1), file: None, truth: None })
    }
    fn rest(&mut self) {
        if self.open.take().is_some() {
            self.driver.call(CLOSING);
        }
        self.state = CameraState::Resting;
    }
    fn state(&self) -> &CameraState {
        &self.state
    }
    fn status(&self) -> &CameraStatus {
        &self.status
    }
    fn wake(&self) -> Wake {
        self.wake.clone()
    }
    fn exposure(&self) -> Option<Exposure> {
        None
    }
    fn spare(&self) -> Box<dyn CameraReader> {
        let (driver, status, wake) = (self.driver.clone(), self.status.clone(), self.wake.clone());
        Box::new(TestCamera { driver, open: None, state: CameraState::Resting, status, number: 0, wake })
    }
    fn go_on(&mut self, next_number: u64, status: CameraStatus) {
        (self.number, self.status) = (next_number, status);
    }
}

struct Rig {
    driver: Arc<TestDriver>,
    drivers: Drivers,
    source: Source,
    inbox: Arc<Inbox>,
}

/// A camera of that driver, opened.
pub fn opened(driver: &Arc<TestDriver>, drivers: &Drivers) -> Opened {
    let status = CameraStatus {
        device: "/dev/video0".into(),
        identity: "camera-0001".into(),
        format: "GREY".into(),
        width: 8,
        height: 8,
        rate_hz: None,
        controls_taken: Default::default(),
        gaps: 0,
        damaged: 0,
        overtaken: 0,
        reconnects: 0,
    };
    let (state, wake) = (CameraState::Resting, Wake::new().unwrap());
    let camera = Box::new(TestCamera { driver: driver.clone(), open: None, state, status, number: 0, wake });
    let producer = Producer::Camera { camera, drivers: drivers.clone() };
    Opened { producer, shape: FrameShape::default(), pace: Pace::Realtime, rate_hz: 0.0, held: None }
}

impl Rig {
    fn start() -> Rig {
        let document: CameraDocument = serde_json::from_str(r#"{"device": "/dev/video0"}"#).unwrap();
        let (driver, drivers) = (Arc::new(TestDriver::default()), Drivers::default());
        let opened = opened(&driver, &drivers);
        let source = Source::start("eye", SourceDocument::Camera(document), opened).unwrap();
        let inbox = Arc::new(Inbox::default());
        source.subscribe(&inbox);
        Rig { driver, drivers, source, inbox }
    }

    fn frame(&self) -> u64 {
        match self.inbox.next() {
            Event::Frame(delivery) => delivery.captured.frame.sequence,
            _ => panic!("no frame"),
        }
    }

    /// Until a thread is in a call that does not return; the time when everybody has lost patience with it.
    fn stuck(&self) -> Instant {
        let asked = || self.source.shared.lock().asked;
        let mut seen = asked();
        loop {
            std::thread::park_timeout(Duration::from_millis(50));
            let now = asked();
            if now.is_some() && now == seen {
                return Instant::now() + LIMITS.driver_patience * 100;
            }
            seen = now;
        }
    }

    fn until_given_up(&self, count: usize) {
        while self.drivers.given_up() != count {
            std::thread::yield_now();
        }
    }

    fn end(self) {
        self.driver.release();
        self.inbox.close();
        self.source.stop();
        self.until_given_up(0);
    }
}

#[test]
fn a_driver_that_does_not_come_back_is_said_until_it_does() {
    let rig = Rig::start();
    let before = rig.frame();
    rig.driver.hang(0);
    rig.stuck();
    let said = |after| rig.source.shared.lock().state(Instant::now() + after);
    assert_eq!(said(Duration::ZERO).0, SourceState::Running, "it may take its time");
    let (state, reason) = said(Duration::from_secs(7));
    assert_eq!(state, SourceState::Stalled);
    assert!(reason.unwrap().contains("has not answered for 7 s"));
    rig.source.look_after(Instant::now() + LIMITS.driver_time + Duration::from_secs(1));
    assert_eq!(rig.drivers.given_up(), 0, "nobody has lost patience yet");
    rig.driver.release();
    while rig.frame() <= before {}
    while said(Duration::ZERO) != (SourceState::Running, None) {
        std::thread::yield_now();
    }
    rig.end();
}

/// The call never returns, but the camera is plugged in again: another thread finds it, and numbers go on. What the old call
/// brings, when it returns, is of no use to anybody.
#[test]
fn a_camera_that_is_plugged_in_again_goes_on_beside_a_call_that_never_returned() {
    let rig = Rig::start();
    rig.frame();
    rig.driver.hang(0);
    let later = rig.stuck();
    rig.driver.plugged.store(1, Ordering::SeqCst);
    let before = rig.source.shared.lock().newest.unwrap();
    rig.source.look_after(later);
    assert_eq!(rig.drivers.given_up(), 1);
    let mut last = before;
    for frame in 0..50 {
        if frame == 25 {
            rig.driver.release();
            rig.until_given_up(0);
        }
        let number = rig.frame();
        assert!(number > last || frame == 0, "{number} after {last}");
        last = number;
    }
    assert!(last > before);
    assert_eq!(rig.source.view("eye").state, SourceState::Running);
    rig.end();
}

#[test]
fn a_source_gives_up_so_many_threads_and_no_more() {
    let rig = Rig::start();
    rig.frame();
    rig.driver.hang(0);
    for _ in 0..2 * LIMITS.given_up_each {
        let later = rig.stuck();
        rig.source.look_after(later);
    }
    assert_eq!(rig.drivers.given_up(), LIMITS.given_up_each);
    let later = rig.stuck();
    let (state, reason) = rig.source.shared.lock().state(later);
    assert_eq!(state, SourceState::Stalled, "{reason:?}");
    rig.end();
}

/// Deleting it does not wait for the driver: its thread is counted instead, for as long as the call lasts.
#[test]
fn a_source_whose_driver_hangs_can_be_stopped() {
    let rig = Rig::start();
    rig.frame();
    rig.driver.hang(0);
    rig.stuck();
    rig.inbox.close();
    rig.source.stop();
    rig.source.stop();
    assert_eq!(rig.drivers.given_up(), 1);
    rig.end();
}

/// Nor does closing it: who listens no more leaves a camera that is to rest.
#[test]
fn a_camera_that_does_not_close_is_noticed_as_well() {
    let rig = Rig::start();
    rig.frame();
    rig.driver.hang(CLOSING);
    rig.source.unsubscribe(&rig.inbox);
    rig.stuck();
    let (state, reason) = rig.source.shared.lock().state(Instant::now() + Duration::from_secs(7));
    assert_eq!(state, SourceState::Stalled, "{reason:?}");
    rig.end();
}
