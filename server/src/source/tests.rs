//! What a source promises to its sessions, with frames of one pixel.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_capture::{Captured, FrameSource, SourceError};
use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};
use isophote_wire::{Pace, PlaybackDocument, RecordingDocument, SourceDocument, SourceState};

use super::{FrameShape, Opened, Producer, Source};
use crate::session::inbox::{Event, Inbox, Reply, SourceEnd};

/// So many frames, then `None` or a panic.
struct Counted {
    left: u64,
    panics: bool,
}

impl FrameSource for Counted {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        if self.left == 0 {
            assert!(!self.panics, "planted");
            return Ok(None);
        }
        self.left -= 1;
        let frame = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap();
        Ok(Some(Captured { frame, file: None, truth: None }))
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
fn pace_fit_loses_nothing() {
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
fn a_session_that_comes_late_is_told_of_the_end() {
    let (source, inbox) = start(0, false, Pace::Fit);
    assert!(matches!(number(inbox.next()), Err(SourceEnd::Finished(_))));
    let late = Arc::new(Inbox::default());
    source.subscribe(&late);
    assert!(matches!(number(late.next()), Err(SourceEnd::Finished(_))));
    source.stop();
}

#[test]
fn a_panic_is_a_failure_that_sessions_hear_of() {
    let (source, inbox) = start(1, true, Pace::Fit);
    assert_eq!(number(inbox.next()), Ok(0));
    let Err(SourceEnd::Failed(reason)) = number(inbox.next()) else { panic!("no failure") };
    assert!(reason.starts_with("bug:"), "{reason}");
    assert_eq!(source.view("test").state, SourceState::Failed);
    source.stop();
}

#[test]
fn a_source_stops_while_a_closed_session_was_busy() {
    let (source, inbox) = start(u64::MAX, false, Pace::Fit);
    number(inbox.next()).unwrap(); // and never done with it
    inbox.close();
    source.stop();
    assert!(matches!(inbox.next(), Event::Closed));
}

/// The source of a session that is replaced stops before the session's sockets have noticed: 409, not "the service is
/// stopping".
#[test]
fn a_frame_for_a_source_that_has_stopped_is_told_that_its_session_ended() {
    let (source, inbox) = start(0, false, Pace::Fit);
    inbox.close();
    source.stop();
    let frame = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap();
    let (sender, _answer) = tokio::sync::oneshot::channel();
    let reply = Reply { session: inbox, sender };
    let refused = source.push(Captured { frame, file: None, truth: None }, reply).unwrap_err();
    assert_eq!(refused.document().status, 409, "{refused:?}");
}

/// A source that somebody has paused owes no frames; one that goes on owes them from then on.
#[test]
fn a_paused_source_has_not_stalled() {
    let (source, inbox) = start(u64::MAX, false, Pace::Fit);
    let play = |paused: bool| {
        let document = PlaybackDocument { paused: Some(paused), ..PlaybackDocument::default() };
        source.set_playback(&document).unwrap()
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
