//! Simulated cameras whose drivers hang: reported states and recovery.

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

/// Stands for the closing calls in the set of plugging numbers.
const CLOSING: usize = usize::MAX;

/// The driver shared by all readers of one camera.
#[derive(Default)]
pub struct TestDriver {
    /// Number of times the camera was plugged in again.
    plugged: AtomicUsize,
    /// Plugging numbers whose calls hang.
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
    /// The plugging number that it has open.
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

/// An opened camera of that driver.
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

    /// Waits until a driver call hangs; returns a time after all limits on it.
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
fn hanging_driver_is_reported_until_it_returns() {
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

/// The call hangs, but the camera is plugged in again: another thread finds it and continues the numbers. The old call's result
/// is discarded.
#[test]
fn replugged_camera_resumes_despite_a_hanging_call() {
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
fn abandoned_threads_per_source_are_limited() {
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

/// Deletion does not wait for the driver: the thread is counted for as long as the call lasts.
#[test]
fn source_with_a_hanging_driver_can_be_stopped() {
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

/// Closing does not wait either: without sessions the camera is to be closed.
#[test]
fn hanging_close_is_reported() {
    let rig = Rig::start();
    rig.frame();
    rig.driver.hang(CLOSING);
    rig.source.unsubscribe(&rig.inbox);
    rig.stuck();
    let (state, reason) = rig.source.shared.lock().state(Instant::now() + Duration::from_secs(7));
    assert_eq!(state, SourceState::Stalled, "{reason:?}");
    rig.end();
}
