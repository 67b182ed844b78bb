//! A source whose frames are made or read: its thread goes on by the clock, or with the fits, and as [`Playback`](super::playback)
//! says.

use std::sync::PoisonError;
use std::time::Instant;

use isophote_capture::{FrameSource, Reel};
use isophote_wire::{Pace, SourceState};

use super::{Worker, finish};

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
                    self.faults = 0;
                    match self.wait_until_due(&mut *frames, place) {
                        Turn::Now => self.number(captured, None),
                        Turn::Left => {}
                        Turn::Over => return,
                    }
                }
                Ok(None) => match frames.reel().filter(|_| self.repeats()) {
                    Some(reel) => reel.seek(0),
                    None => return finish(&self.shared, SourceState::Ended, "the recording has ended".into()),
                },
                // It may be whole when its turn comes again. Its number is missing, and its place in time stays.
                Err(error) if self.faults < self.faults_max(&mut *frames) => {
                    self.faults += 1;
                    self.shared.lock().reason = Some(format!("a frame is left out: {error}"));
                    match self.wait_until_due(&mut *frames, place) {
                        Turn::Now => self.frame += 1,
                        Turn::Left => {}
                        Turn::Over => return,
                    }
                }
                Err(error) => return finish(&self.shared, SourceState::Failed, error.to_string()),
            }
        }
    }

    fn repeats(&self) -> bool {
        let state = self.shared.lock();
        state.playback.as_ref().and_then(|playback| playback.tape.as_ref()).is_some_and(|tape| tape.repeat)
    }

    /// Frames that may fail one after the other: of a recording that is played again and again, one whole round.
    fn faults_max(&self, frames: &mut dyn FrameSource) -> usize {
        frames.reel().filter(|_| self.repeats()).map_or(0, |reel: &mut dyn Reel| reel.count())
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
