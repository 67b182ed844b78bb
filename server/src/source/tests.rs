//! Delivery of a source's frames to its sessions, with frames of one pixel.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_capture::{Captured, FrameSource, Reel, SourceError};
use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};
use isophote_wire::{Pace, PlaybackDocument, RecordingDocument, SessionState, SourceDocument, SourceState};

use super::{FrameShape, Opened, Producer, Source};
use crate::http::preconditions::Preconditions;
use crate::session::inbox::{Event, Inbox, Reply, SourceEnd};

/// That many frames, then `None` or a panic.
struct Counted {
    left: u64,
    panics: bool,
}

fn one_pixel() -> Captured {
    let frame = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap();
    Captured { frame, file: None, truth: None }
}

impl FrameSource for Counted {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        if self.left == 0 {
            assert!(!self.panics, "planted");
            return Ok(None);
        }
        self.left -= 1;
        Ok(Some(one_pixel()))
    }
    fn description(&self) -> String {
        "frames of a test".into()
    }
    fn size(&self) -> Option<Vec<usize>> {
        None
    }
}

fn start(left: u64, panics: bool, pace: Pace) -> (Source, Arc<Inbox>) {
    let document = RecordingDocument { path: "test".into(), rate_hz: 0.0, pace, repeat: false };
    let document = SourceDocument::Recording(document);
    let producer = Producer::Frames(Box::new(Counted { left, panics }));
    let rate_hz = if pace == Pace::Fit { 0.0 } else { 10_000.0 };
    let source =
        Source::start("test", document, Opened { producer, shape: FrameShape::default(), pace, rate_hz, held: None })
            .unwrap();
    let inbox = Arc::new(Inbox::default());
    assert_eq!(source.view("test").state, SourceState::Idle);
    source.subscribe(&inbox);
    (source, inbox)
}

fn number(event: Event) -> Result<u64, SourceEnd> {
    match event {
        Event::Frame(delivery) => Ok(delivery.captured.frame.sequence),
        Event::SourceEnded(end) => Err(end),
        Event::Swap(_) | Event::Look | Event::Closed => panic!("none of them was asked for"),
    }
}

#[test]
fn pace_fit_drops_no_frames() {
    let (source, inbox) = start(1000, false, Pace::Fit);
    for frame in 0..1000 {
        assert_eq!(number(inbox.next()), Ok(frame));
    }
    assert!(matches!(number(inbox.next()), Err(SourceEnd::Finished(_))));
    assert_eq!(source.view("test").state, SourceState::Ended);
    source.stop();
}

#[test]
fn pace_realtime_keeps_the_newest() {
    let (source, inbox) = start(u64::MAX, false, Pace::Realtime);
    let first = number(inbox.next()).unwrap();
    while source.view("test").frames < first + 20 {
        std::thread::yield_now();
    }
    assert!(number(inbox.next()).unwrap() > first + 10);
    inbox.close();
    source.stop();
}

#[test]
fn late_subscriber_receives_the_end() {
    let (source, inbox) = start(0, false, Pace::Fit);
    assert!(matches!(number(inbox.next()), Err(SourceEnd::Finished(_))));
    let late = Arc::new(Inbox::default());
    source.subscribe(&late);
    assert!(matches!(number(late.next()), Err(SourceEnd::Finished(_))));
    source.stop();
}

#[test]
fn source_panic_is_reported_to_the_sessions() {
    let (source, inbox) = start(1, true, Pace::Fit);
    assert_eq!(number(inbox.next()), Ok(0));
    let Err(SourceEnd::Failed(reason)) = number(inbox.next()) else { panic!("no failure") };
    assert!(reason.starts_with("bug:"), "{reason}");
    assert_eq!(source.view("test").state, SourceState::Failed);
    source.stop();
}

#[test]
fn source_stops_despite_an_unfinished_fit() {
    let (source, inbox) = start(u64::MAX, false, Pace::Fit);
    number(inbox.next()).unwrap(); // and never finished
    inbox.close();
    source.stop();
    assert!(matches!(inbox.next(), Event::Closed));
}

/// The source of a replaced session stops before the session's sockets have noticed: 409, not "the service is stopping".
#[test]
fn push_to_a_stopped_source_is_409() {
    let (source, inbox) = start(0, false, Pace::Fit);
    inbox.close();
    source.stop();
    let frame = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap();
    let (sender, _answer) = tokio::sync::oneshot::channel();
    let reply = Reply { session: inbox, sender };
    let refused = source.push(Captured { frame, file: None, truth: None }, reply).unwrap_err();
    assert_eq!(refused.document().status, 409, "{refused:?}");
}

/// A paused source owes no frames; a resumed one owes them from then on.
#[test]
fn paused_source_is_not_stalled() {
    let (source, inbox) = start(u64::MAX, false, Pace::Fit);
    let play = |paused: bool| {
        let document = PlaybackDocument { paused: Some(paused), ..PlaybackDocument::default() };
        source.set_playback(&document, &Preconditions::default()).unwrap().1
    };
    assert_eq!(source.steady_since_ns(), Some(0));
    assert_eq!(number(inbox.next()), Ok(0));
    assert_eq!(play(true).next_frame, source.view("test").frames);
    assert_eq!(source.steady_since_ns(), None);
    assert!(source.is_still());
    let begin_ns = isophote_machine::monotonic_ns();
    play(false);
    assert!(source.steady_since_ns() >= Some(begin_ns));
    for frame in 1..10 {
        assert_eq!(number(inbox.next()), Ok(frame), "none was lost");
    }
    inbox.close();
    source.stop();
}

/// A recording with a range of reads that fail.
struct Torn {
    count: usize,
    place: usize,
    /// Reads that fail, counted from the first.
    fail: std::ops::Range<usize>,
    reads: usize,
}

impl FrameSource for Torn {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        if self.place == self.count {
            return Ok(None);
        }
        (self.place, self.reads) = (self.place + 1, self.reads + 1);
        if self.fail.contains(&(self.reads - 1)) {
            return Err(SourceError::Empty { path: "torn".into() });
        }
        Ok(Some(one_pixel()))
    }
    fn description(&self) -> String {
        "frames of a test".into()
    }
    fn size(&self) -> Option<Vec<usize>> {
        None
    }
    fn reel(&mut self) -> Option<&mut dyn Reel> {
        Some(self)
    }
}

impl Reel for Torn {
    fn count(&self) -> usize {
        self.count
    }
    fn place(&self) -> usize {
        self.place
    }
    fn seek(&mut self, place: usize) {
        self.place = place;
    }
}

fn torn(count: usize, fail: std::ops::Range<usize>, repeat: bool) -> (Source, Arc<Inbox>) {
    let document = RecordingDocument { path: "test".into(), rate_hz: 0.0, pace: Pace::Fit, repeat };
    let producer = Producer::Frames(Box::new(Torn { count, place: 0, fail, reads: 0 }));
    let opened = Opened { producer, shape: FrameShape::default(), pace: Pace::Fit, rate_hz: 0.0, held: None };
    let source = Source::start("test", SourceDocument::Recording(document), opened).unwrap();
    let inbox = Arc::new(Inbox::default());
    source.subscribe(&inbox);
    (source, inbox)
}

/// Two rounds of one frame fail; the third succeeds.
#[test]
fn loop_retries_until_its_frames_are_readable() {
    let (source, inbox) = torn(1, 2..4, true);
    assert_eq!((number(inbox.next()), number(inbox.next())), (Ok(0), Ok(1)));
    assert_eq!(number(inbox.next()), Ok(4), "those that were missing are counted");
    let view = source.view("test");
    assert_eq!((view.state, view.reason, view.unread), (SourceState::Running, None, 2));
    inbox.close();
    source.stop();
}

#[test]
fn stalled_loop_reports_why_and_stops_at_once() {
    let (source, inbox) = torn(3, 0..usize::MAX, true);
    while source.view("test").state != SourceState::Stalled {
        std::thread::yield_now();
    }
    let view = source.view("test");
    assert!(view.unread >= 3 && view.reason.unwrap().contains("torn"));
    assert!(matches!(source.trouble(), Some((SessionState::Stalled, Some(_)))));
    // Without a loop the source ends.
    let once = PlaybackDocument { repeat: Some(false), ..PlaybackDocument::default() };
    source.set_playback(&once, &Preconditions::default()).unwrap();
    assert!(number(inbox.next()).is_err());
    source.stop();
}

#[test]
fn unreadable_frame_fails_a_recording_that_does_not_loop() {
    let (source, inbox) = torn(3, 1..2, false);
    assert_eq!(number(inbox.next()), Ok(0));
    assert!(matches!(number(inbox.next()), Err(SourceEnd::Failed(_))));
    source.stop();
}

/// One frame of a round is skipped, which is reported for a round.
#[test]
fn skipped_frame_is_reported_for_one_round() {
    let (source, inbox) = torn(3, 1..2, true);
    assert_eq!((number(inbox.next()), number(inbox.next())), (Ok(0), Ok(2)));
    let view = source.view("test");
    assert_eq!((view.state, view.unread), (SourceState::Running, 1));
    assert!(view.reason.unwrap().contains("left out"));
    assert_eq!((number(inbox.next()), number(inbox.next()), number(inbox.next())), (Ok(3), Ok(4), Ok(5)));
    assert_eq!(source.view("test").reason, None);
    inbox.close();
    source.stop();
}
