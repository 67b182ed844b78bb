//! A source whose frames are rendered or read: its thread follows the clock or the fits, and [`Playback`](super::playback).

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use isophote_capture::{FrameSource, Reel, SourceError};
use isophote_wire::{Pace, SourceState};

use super::playback::Playback;
use super::state::SourceNow;
use super::{Worker, finish, label};
use crate::session::inbox::TimeOrigin;

/// Decision about a frame that was read.
enum Turn {
    /// Show it.
    Now,
    /// Drop it and continue with another.
    Left,
    /// The source stops.
    Over,
}

impl Worker {
    /// Runs until the source stops or has no more frames.
    pub(super) fn run_frames(&mut self, mut frames: Box<dyn FrameSource>) {
        while self.wait_for_turn(&mut *frames) {
            let place = frames.reel().map(|reel| reel.place());
            match frames.next() {
                Ok(Some(captured)) => {
                    self.has_read(&mut *frames);
                    match self.wait_until_due(&mut *frames, place) {
                        // A synthetic camera captures its frames when it sends them.
                        Turn::Now if place.is_none() => self.number(captured, TimeOrigin::OfFrame, None),
                        Turn::Now => self.number(captured, TimeOrigin::OfArrival, None),
                        Turn::Left => {}
                        Turn::Over => return,
                    }
                }
                Ok(None) => match frames.reel().filter(|_| self.repeats()) {
                    Some(reel) => reel.seek(0),
                    None => return finish(&self.shared, SourceState::Ended, "the recording has ended".into()),
                },
                // The frame may be readable in the next round. Its number is skipped, its time slot stays.
                Err(error) => {
                    let Some(round) = self.round(&mut *frames) else {
                        return finish(&self.shared, SourceState::Failed, error.to_string());
                    };
                    let rest = self.leave_out(&error, round);
                    match self.wait_until_due(&mut *frames, place) {
                        Turn::Now => self.frame += 1,
                        Turn::Left => {}
                        Turn::Over => return,
                    }
                    rest.into_iter().for_each(|time| self.rest(time));
                }
            }
        }
    }

    fn repeats(&self) -> bool {
        let state = self.shared.lock();
        state.playback.as_ref().and_then(|playback| playback.tape.as_ref()).is_some_and(|tape| tape.repeat)
    }

    /// Number of frames in one round of a looping recording.
    fn round(&self, frames: &mut dyn FrameSource) -> Option<usize> {
        frames.reel().filter(|_| self.repeats()).map(|reel: &mut dyn Reel| reel.count())
    }

    /// After a frame was read: the first one after an unreadable round ends the stall; a whole readable round clears the
    /// reason.
    fn has_read(&mut self, frames: &mut dyn FrameSource) {
        let round = frames.reel().map_or(1, |reel| reel.count());
        let Some(is_whole) = self.faults.read(round) else { return };
        let mut state = self.shared.lock();
        if state.state == SourceState::Stalled {
            state.state = SourceState::Running;
            tracing::info!(source = label(), frame = self.frame, "source is back");
        }
        if is_whole {
            state.reason = None;
        }
    }

    /// Reports an unreadable frame; returns the pause after a whole round of them.
    fn leave_out(&mut self, error: &SourceError, round: usize) -> Option<Duration> {
        let (is_stalled, rest) = self.faults.failed(round);
        let mut state = self.shared.lock();
        state.unread += 1;
        let reason = match is_stalled {
            true => format!("no frame of the recording could be read; it is tried again until one can be: {error}"),
            false => format!("a frame is left out: {error}"),
        };
        if is_stalled && state.state != SourceState::Stalled {
            state.state = SourceState::Stalled;
            tracing::warn!(source = label(), frame = self.frame, reason, "source stalled");
        }
        state.reason = Some(reason);
        rest
    }

    /// Waits before the next round, unless a client requests something else.
    fn rest(&mut self, time: Duration) {
        let is_idle = |state: &mut SourceNow| {
            let plays_on = |playback: &Playback| {
                !playback.is_still() && playback.tape.as_ref().is_some_and(|tape| tape.repeat && tape.seek.is_none())
            };
            state.is_wanted() && state.playback.as_ref().is_some_and(plays_on)
        };
        let waited = self.shared.changed.wait_timeout_while(self.shared.lock(), time, is_idle);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
        self.schedule.restart();
    }

    /// Waits until a session listens and the source is not paused; applies a pending seek. False when the source stops.
    fn wait_for_turn(&mut self, frames: &mut dyn FrameSource) -> bool {
        loop {
            if !self.wait_for_sessions() {
                return false;
            }
            let mut state = self.shared.lock();
            let Some(playback) = &mut state.playback else { return true };
            if let (Some(place), Some(reel)) = (playback.take_seek(), frames.reel()) {
                reel.seek(place);
            }
            if !playback.is_still() {
                return true;
            }
            self.schedule.restart();
            // Woken by any change; the loop checks which.
            drop(self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// Waits until a frame that was read, with its position `place`, is due.
    fn wait_until_due(&mut self, frames: &mut dyn FrameSource, place: Option<usize>) -> Turn {
        if self.pace == Pace::Fit {
            self.wait_for_fits();
        }
        let mut due = self.schedule.due(Instant::now());
        let mut state = self.shared.lock();
        loop {
            let now = Instant::now();
            if state.is_stopping {
                return Turn::Over;
            }
            let Some(playback) = &mut state.playback else { return Turn::Now };
            // A dropped frame has taken no time; a re-rendered one shows the changes since.
            if playback.is_sought() {
                frames.take_back();
                return Turn::Left;
            }
            if playback.is_still() {
                if frames.take_back() {
                    return Turn::Left;
                }
                state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                self.schedule.restart();
                due = self.schedule.due(Instant::now());
                continue;
            }
            due = self.schedule.retimed(due, self.rate_hz * playback.speed);
            if now >= due {
                playback.shows(place, self.frame);
                return Turn::Now;
            }
            let waited = self.shared.changed.wait_timeout(state, due - now);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
