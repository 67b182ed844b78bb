//! `Tap`: queue of frames and notes from a session's threads to the thread that writes its recording.
//!
//! Bounded in bytes, and never blocks a sender: what does not fit is dropped and counted.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use isophote_symbolic::Model;
use isophote_tracker::{Frame, Snapshot};
use isophote_wire::{EstimateView, LoggedFit, LoggedSwap};

use crate::limits::LIMITS;

/// Bytes that a note counts for, beside pixels.
const NOTE_BYTES: usize = 1024;

/// The active model.
pub struct ModelNote {
    /// Its swap message as written.
    pub swap: LoggedSwap,
    /// The checked document.
    pub model: Arc<Model>,
    /// It has just been swapped in.
    pub is_swap: bool,
}

/// A fitted frame.
pub struct FitNote {
    /// How it was fitted; the writer fills in the rest.
    pub fit: LoggedFit,
    /// Capture or arrival time, CLOCK_MONOTONIC.
    pub at_ns: u64,
    /// Its published estimates.
    pub estimates: Vec<Arc<EstimateView>>,
}

/// An entry of the queue.
pub enum Note {
    /// A frame of the source, with its capture or arrival time.
    Frame(Frame, u64),
    /// A snapshot of the tracker, with its model.
    Begin(Box<(ModelNote, Snapshot)>),
    /// A fitted frame.
    Fit(Box<FitNote>),
}

/// The writer's next task.
pub enum Due {
    /// Write the note, which counted for that many bytes.
    Note(Note, usize),
    /// Nothing arrived in time.
    Nothing,
    /// The queue is empty and ended, for that reason.
    End(String),
}

#[derive(Default)]
struct State {
    notes: VecDeque<(Note, usize)>,
    bytes: usize,
    /// The number of the first frame.
    first: Option<u64>,
    dropped: u64,
    end: Option<String>,
    /// The writer takes nothing more.
    is_closed: bool,
}

/// The queue of one recording.
#[derive(Default)]
pub struct Tap {
    state: Mutex<State>,
    changed: Condvar,
    wants_snapshot: AtomicBool,
}

impl Tap {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a frame of the source. Copies its pixels if they are in a driver's buffer.
    pub fn frame(&self, frame: &Frame, at_ns: u64) {
        self.lock().first.get_or_insert(frame.sequence);
        let frame = frame.owned();
        let first = frame.planes().first().map_or(0, |plane| plane.buffer.bytes().len());
        let rest: usize = frame.planes().iter().skip(1).map(|plane| plane.buffer.bytes().len()).sum();
        let is_shared =
            frame.planes().windows(2).all(|two| two[0].buffer.bytes().as_ptr() == two[1].buffer.bytes().as_ptr());
        let bytes = if is_shared { first } else { first + rest };
        self.push(Note::Frame(frame, at_ns), bytes, LIMITS.recording_bytes);
    }

    /// Queues a frame that is about to be fitted, if it came before the recording's first one.
    pub fn fitting(&self, frame: &Frame, at_ns: u64) {
        let is_earlier = self.lock().first.is_none_or(|first| frame.sequence < first);
        if is_earlier {
            self.frame(frame, at_ns);
        }
    }

    /// Queues a note, for which extra bytes are reserved. If even these are used up, the next fit begins with a snapshot.
    pub fn note(&self, note: Note) {
        let size = match &note {
            Note::Fit(fit) => fit.estimates.len() * NOTE_BYTES,
            _ => 0,
        };
        if !self.push(note, NOTE_BYTES + size, LIMITS.recording_bytes + LIMITS.recording_note_bytes) {
            self.want_snapshot();
        }
    }

    fn push(&self, note: Note, bytes: usize, most: usize) -> bool {
        let dropped = {
            let mut state = self.lock();
            if state.is_closed || state.end.is_some() {
                return true;
            }
            match state.bytes + bytes <= most {
                true => {
                    state.bytes += bytes;
                    state.notes.push_back((note, bytes));
                    None
                }
                false => {
                    state.dropped += 1;
                    Some(note)
                }
            }
        };
        self.changed.notify_all();
        dropped.is_none()
    }

    /// Requests a snapshot before the next fit.
    pub fn want_snapshot(&self) {
        self.wants_snapshot.store(true, Ordering::Relaxed);
    }

    /// For the fit thread: takes that request.
    pub fn take_wish(&self) -> bool {
        self.wants_snapshot.swap(false, Ordering::Relaxed)
    }

    /// Ends the queue; waiting entries are still written.
    pub fn end(&self, reason: &str) {
        self.lock().end.get_or_insert_with(|| reason.to_string());
        self.changed.notify_all();
    }

    /// For the writer: ends the queue and drops waiting entries.
    pub fn close(&self) {
        let waiting = {
            let mut state = self.lock();
            state.is_closed = true;
            state.bytes = 0;
            std::mem::take(&mut state.notes)
        };
        drop(waiting);
    }

    /// Number of dropped frames and notes.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// For the writer: blocks for the next task until `until`.
    pub fn next(&self, until: Instant) -> Due {
        let mut state = self.lock();
        loop {
            if let Some((note, bytes)) = state.notes.pop_front() {
                state.bytes -= bytes.min(state.bytes);
                return Due::Note(note, bytes);
            }
            if let Some(reason) = state.end.clone() {
                return Due::End(reason);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left == Duration::ZERO {
                return Due::Nothing;
            }
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_jit::PixelFormat;
    use isophote_tracker::Plane;

    fn frame(number: u64) -> Frame {
        let side = 1 << 12;
        Frame::new(&[side, side], vec![Plane::owned(PixelFormat::U8, vec![0; side * side], side)])
            .unwrap()
            .with_sequence(number)
    }

    /// On a blocked disk frames are dropped, their notes are not.
    #[test]
    fn overflow_is_dropped_and_counted() {
        let tap = Tap::default();
        let room = LIMITS.recording_bytes / (1 << 24);
        let one = frame(7);
        for number in 0..room as u64 + 3 {
            tap.frame(&one.clone().with_sequence(number), number);
        }
        assert_eq!(tap.dropped(), 3);
        let fit = LoggedFit {
            frame: 0,
            fit: 0,
            has_pixels: true,
            has_jumped: false,
            capture_ns: None,
            time_s: None,
            largest: None,
            ready: Default::default(),
            stopped: None,
            postponed: 0,
        };
        let note = || Note::Fit(Box::new(FitNote { fit: fit.clone(), at_ns: 0, estimates: Vec::new() }));
        let notes = LIMITS.recording_note_bytes / NOTE_BYTES;
        assert!(!tap.take_wish());
        (0..notes).for_each(|_| tap.note(note()));
        assert_eq!((tap.dropped(), tap.take_wish()), (3, false));
        tap.note(note());
        assert_eq!((tap.dropped(), tap.take_wish()), (4, true));
        tap.end("done");
        tap.note(note());
        let due = || match tap.next(Instant::now()) {
            Due::Note(Note::Frame(..), _) => 'p',
            Due::Note(..) => 'n',
            Due::Nothing => '.',
            Due::End(_) => 'e',
        };
        let all: String = (0..room + notes + 1).map(|_| due()).collect();
        assert_eq!(all, format!("{}{}e", "p".repeat(room), "n".repeat(notes)));
    }

    /// The frame waiting when a recording begins is recorded as well, once.
    #[test]
    fn earlier_frame_is_recorded_when_fitted() {
        let tap = Tap::default();
        let numbered =
            |number| Frame::new(&[1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap().with_sequence(number);
        tap.frame(&numbered(5), 0);
        tap.fitting(&numbered(4), 0);
        tap.fitting(&numbered(5), 0);
        tap.end("done");
        let mut found = Vec::new();
        while let Due::Note(Note::Frame(frame, _), _) = tap.next(Instant::now()) {
            found.push(frame.sequence);
        }
        assert_eq!(found, [5, 4]);
    }
}
