//! A source whose frames are made or read: its thread goes on by the clock, or with the fits, and as [`Playback`](super::playback)
//! says.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use isophote_capture::{FrameSource, Reel, SourceError};
use isophote_wire::{Pace, SourceState};

use super::playback::Playback;
use super::state::SourceNow;
use super::{Worker, finish, label};
use crate::session::inbox::TimeOrigin;

/// What becomes of a frame that is there.
enum Turn {
    /// It is shown now.
    Now,
    /// It is not shown: there is another one to go on with.
    Left,
    /// The source stops.
    Over,
}

impl Worker {
    /// Until the source stops, or has no more frames.
    pub(super) fn run_frames(&mut self, mut frames: Box<dyn FrameSource>) {
        while self.wait_for_turn(&mut *frames) {
            let place = frames.reel().map(|reel| reel.place());
            match frames.next() {
                Ok(Some(captured)) => {
                    self.has_read(&mut *frames);
                    match self.wait_until_due(&mut *frames, place) {
                        // A synthetic camera takes its frames when it hands them on.
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
                // It may be whole when its turn comes again. Its number is missing, and its place in time stays.
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

    /// Frames of one round of a recording that is played again and again.
    fn round(&self, frames: &mut dyn FrameSource) -> Option<usize> {
        frames.reel().filter(|_| self.repeats()).map(|reel: &mut dyn Reel| reel.count())
    }

    /// A frame was read. With the first after a whole round of which none was the source runs again; with a whole round of them
    /// nothing is left to be said.
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

    /// Says which frame could not be read, and for how long to rest after a whole round of such.
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

    /// Waits before the next round, unless something else is wanted before.
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

    /// Waits until there is somebody to show a frame to, and it is not to stand still; goes to where it is to go on. False when
    /// the source stops.
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
            // Woken by whatever happens; the loop looks what it was.
            drop(self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// For a frame that is there, and the place that it has.
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
            // A frame that is left has taken no time; what is made anew then shows what has changed in the meantime.
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
