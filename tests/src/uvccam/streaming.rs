//! The thread that takes and sends pictures at the negotiated rate.

use std::io;
use std::sync::{MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::descriptors::{Kind, PAYLOAD};
use super::picture::Painter;
use super::state::{Fault, Shared, State};
use super::usbip::Answers;

/// Payload header: its length, and flags.
const HEADER: usize = 2;
const END_OF_HEADER: u8 = 0x80;
const IS_FAULTY: u8 = 0x40;
const LAST_PIECE: u8 = 0x02;

impl Shared {
    /// Waits while `hold` is true, at most until `end`.
    fn wait_while(&self, end: Option<Instant>, hold: impl Fn(&State) -> bool) -> MutexGuard<'_, State> {
        let mut state = self.state();
        while !state.is_gone && hold(&state) {
            let left = end.map_or(Duration::MAX, |end| end.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                break;
            }
            // Split long waits: a deadline must be representable by the clock.
            let waited = self.changed.wait_timeout(state, left.min(Duration::from_secs(60)));
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        state
    }
}

/// Takes and sends pictures while the driver requests them and the camera is plugged in.
pub(super) fn stream_frames(answers: &Answers, shared: &Shared) -> io::Result<()> {
    let mut painter = Painter::default();
    let (mut due, mut toggle) = (Instant::now(), 0);
    loop {
        let is_idle = shared.state().requests.is_empty();
        let mut state = shared.wait_while(None, |state| state.requests.is_empty());
        if is_idle {
            due = due.max(Instant::now());
        }
        if let Some(silence) = state.silence.take() {
            due = Instant::now() + silence;
        }
        let stops = state.stops;
        drop(state);
        let mut state = shared.wait_while(Some(due), |state| state.stops == stops);
        if state.is_gone {
            return Ok(());
        }
        if state.stops != stops {
            continue; // this picture is no longer wanted, and the next one may be requested much later
        }
        let step = Duration::from_nanos(u64::from(state.interval) * 100);
        due = (due + step).max(Instant::now());
        let (kind, fault) = (state.kind, state.fault.take());
        painter.begin(&state.scene, state.noise, state.controls, state.size);
        let number = state.pictures;
        state.pictures = state.pictures.wrapping_add(1);
        let numbered = state.numbered.then_some(number);
        drop(state);
        let mut picture = painter.paint(number, numbered);
        if kind == Kind::Yuyv {
            picture = picture.into_iter().flat_map(|luma| [luma, 128]).collect();
        }
        if fault == Some(Fault::Short) {
            picture.truncate(picture.len() / 2);
        }
        let flags = END_OF_HEADER | toggle | if fault == Some(Fault::Error) { IS_FAULTY } else { 0 };
        send(answers, shared, &picture, flags, stops)?;
        toggle ^= 1;
    }
}

/// Sends a picture in payloads as the driver requests them; drops the rest if the driver stops.
fn send(answers: &Answers, shared: &Shared, picture: &[u8], flags: u8, stops: u32) -> io::Result<()> {
    let pieces = picture.chunks(PAYLOAD - HEADER);
    let last = pieces.len().saturating_sub(1);
    for (number, piece) in pieces.enumerate() {
        let mut state = shared.wait_while(None, |state| state.requests.is_empty() && state.stops == stops);
        if state.stops != stops || state.is_gone {
            return Ok(());
        }
        let Some((request, _)) = state.requests.pop_front() else { return Ok(()) };
        let flags = flags | if number == last { LAST_PIECE } else { 0 };
        // Hold the lock: the driver hangs up on an answer to an unlinked request.
        answers.give(request, &[&[HEADER as u8, flags], piece].concat())?;
        drop(state);
    }
    Ok(())
}
