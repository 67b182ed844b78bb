//! `Playback`: whether a source of frames that are made or read stands still, how fast it goes, and where it is.
//!
//! What comes in: wishes of clients, at any time. What goes out: what its thread does next. It never waits. Numbers of frames grow
//! whatever is wished; places in a recording do not.

use isophote_machine::monotonic_ns;
use isophote_tracker::plain;
use isophote_wire::{PlaybackDocument, PlaybackView};

use crate::limits::LIMITS;
use crate::problem::Problem;

/// Of one source.
pub struct Playback {
    /// Somebody has paused it.
    pub is_paused: bool,
    /// So many times its rate.
    pub speed: f64,
    /// Where it is, if its frames have places.
    pub tape: Option<Tape>,
    /// Frames that are still to be shown though it is paused.
    pub steps: u64,
    /// How often the picture has jumped.
    pub jumps: u64,
    /// When somebody changed it.
    pub changed_ns: u64,
    /// Of the next frame.
    pub number: u64,
}

/// A recording's.
pub struct Tape {
    /// How many frames it has.
    pub count: usize,
    /// It begins again after the last.
    pub repeat: bool,
    /// The place of the frame that was shown last.
    pub shown: Option<usize>,
    /// Where to go on.
    pub seek: Option<usize>,
}

impl Playback {
    /// It plays at its rate.
    pub fn new(tape: Option<Tape>) -> Playback {
        Playback { is_paused: false, speed: 1.0, tape, steps: 0, jumps: 0, changed_ns: 0, number: 0 }
    }

    /// Whether the next frame is not to be shown.
    pub fn is_still(&self) -> bool {
        self.is_paused && self.steps == 0
    }

    /// Whether it goes on elsewhere.
    pub fn is_sought(&self) -> bool {
        self.tape.as_ref().is_some_and(|tape| tape.seek.is_some())
    }

    /// Where to go on, if that is elsewhere. From then on the picture has jumped.
    pub fn take_seek(&mut self) -> Option<usize> {
        let tape = self.tape.as_mut()?;
        let place = tape.seek.take()?;
        self.jumps += u64::from(tape.shown.is_some_and(|shown| shown + 1 != place));
        Some(place)
    }

    /// The frame at that place is shown now, as number n.
    pub fn shows(&mut self, place: Option<usize>, number: u64) {
        self.steps = self.steps.saturating_sub(1);
        self.number = number + 1;
        if let Some(tape) = &mut self.tape {
            tape.shown = place;
        }
    }

    /// Takes a client's wishes, all or none.
    pub fn change(&mut self, document: &PlaybackDocument) -> Result<(), Problem> {
        let PlaybackDocument { paused, frame, step, speed, repeat } = *document;
        let is_paused = paused.unwrap_or(self.is_paused);
        let (least, most) = LIMITS.speed;
        if let Some(speed) = speed.filter(|speed| !(least..=most).contains(speed)) {
            let message = format!("speed is {}; it may be {least} to {most} times the rate", plain(speed));
            return Err(Problem::wrong_key("out-of-range", "speed", message));
        }
        if frame.is_some() && step.is_some() {
            return Err(Problem::wrong_key("wrong-value", "step", "frame says where to go, or step how far; not both"));
        }
        if step.is_some() && !is_paused {
            let message = "a source that plays makes no steps; pause it, with \"paused\": true in the same document";
            return Err(Problem::conflict("not-applicable", message));
        }
        if self.tape.is_none() && (frame.is_some() || repeat.is_some() || step.is_some_and(i64::is_negative)) {
            let message = "a synthetic source has no frames to go back to, and no end: its time goes on. It can be paused, \
                           go on by steps above 0, and have a speed";
            return Err(Problem::conflict("not-applicable", message));
        }
        // What a seek leads to is one of the frames that are still to be shown.
        let pending = self.steps.saturating_sub(u64::from(self.is_sought()));
        let sought = match (&self.tape, frame, step) {
            (Some(tape), Some(frame), _) => Some(tape.place("frame", i64::try_from(frame).unwrap_or(i64::MAX))?),
            (Some(tape), None, Some(step)) => tape.stepped(step, pending, repeat)?,
            _ => None,
        };
        let steps = match step {
            // A step back shows one frame.
            Some(step) if step < 0 => 1,
            // Those before that are not shown yet go on.
            Some(step) if self.is_paused => self.steps.saturating_add(step as u64),
            Some(step) => step as u64,
            None => u64::from(frame.is_some()),
        };
        if steps > LIMITS.steps {
            let message = format!("step is {steps}; it may be {} at most", LIMITS.steps);
            return Err(Problem::wrong_key("out-of-range", "step", message));
        }
        if is_paused != self.is_paused || is_paused && (step.is_some() || frame.is_some()) {
            self.steps = if is_paused { steps } else { 0 };
        }
        (self.is_paused, self.speed) = (is_paused, speed.unwrap_or(self.speed));
        if let Some(tape) = &mut self.tape {
            tape.repeat = repeat.unwrap_or(tape.repeat);
            tape.seek = sought.or(tape.seek);
        }
        self.changed_ns = monotonic_ns();
        Ok(())
    }

    /// For whoever asks.
    pub fn view(&self) -> PlaybackView {
        let tape = self.tape.as_ref();
        PlaybackView {
            paused: self.is_paused,
            frame: tape.and_then(Tape::now).map(|place| place as u64),
            length: tape.map(|tape| tape.count as u64),
            speed: self.speed,
            repeat: tape.map(|tape| tape.repeat),
            next_frame: self.number,
        }
    }
}

impl Tape {
    /// Where it is, or is about to be.
    fn now(&self) -> Option<usize> {
        self.seek.or(self.shown)
    }

    /// That place, if the recording has it.
    fn place(&self, key: &str, place: i64) -> Result<usize, Problem> {
        let found = usize::try_from(place).ok().filter(|place| *place < self.count);
        found.ok_or_else(|| {
            let last = self.count - 1;
            let message = format!("there is no frame {place}: the recording has {} frames, 0 to {last}", self.count);
            Problem::wrong_key("out-of-range", key, message)
        })
    }

    /// Where a step leads behind those that are still to be made, unless that is just the next frames.
    fn stepped(&self, step: i64, pending: u64, repeat: Option<bool>) -> Result<Option<usize>, Problem> {
        let now = self.now().map_or(-1, |place| place as i64);
        if step >= 0 {
            let is_round = repeat.unwrap_or(self.repeat);
            let ahead = step.saturating_add(i64::try_from(pending).unwrap_or(i64::MAX));
            return if is_round {
                Ok(None)
            } else {
                self.place("step", now.saturating_add(ahead).max(0)).map(|_| None)
            };
        }
        self.place("step", now.saturating_add(step)).map(Some)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn recording() -> Playback {
        Playback::new(Some(Tape { count: 10, repeat: false, shown: None, seek: None }))
    }

    fn change(playback: &mut Playback, text: &str) -> Result<PlaybackView, u16> {
        let document: PlaybackDocument = serde_json::from_str(text).unwrap();
        playback.change(&document).map(|()| playback.view()).map_err(|problem| problem.status.as_u16())
    }

    #[test]
    fn a_seek_is_a_jump_unless_it_leads_to_the_next_frame() {
        let mut playback = recording();
        change(&mut playback, r#"{"frame": 3}"#).unwrap();
        assert_eq!((playback.take_seek(), playback.jumps), (Some(3), 0), "nothing was shown before");
        playback.shows(Some(3), 0);
        assert_eq!((playback.take_seek(), playback.jumps), (None, 0));
        change(&mut playback, r#"{"frame": 4}"#).unwrap();
        assert_eq!((playback.take_seek(), playback.jumps), (Some(4), 0));
        playback.shows(Some(4), 1);
        change(&mut playback, r#"{"frame": 4}"#).unwrap();
        assert_eq!((playback.take_seek(), playback.jumps), (Some(4), 1));
    }

    #[test]
    fn steps_are_made_while_it_stands_still() {
        let mut playback = recording();
        assert_eq!(change(&mut playback, r#"{"step": 1}"#), Err(409));
        let view = change(&mut playback, r#"{"paused": true, "step": 2, "speed": 0.5}"#).unwrap();
        assert_eq!((view.paused, view.speed, view.frame, view.length), (true, 0.5, None, Some(10)));
        playback.shows(Some(0), 7);
        assert!(!playback.is_still());
        playback.shows(Some(1), 8);
        assert!(playback.is_still());
        // Two steps in a row are two, whenever they are made.
        for left in [1, 2] {
            change(&mut playback, r#"{"step": 1}"#).unwrap();
            assert_eq!(playback.steps, left);
        }
        assert_eq!(change(&mut playback, r#"{"step": 7}"#), Err(422), "2 + 7 beyond frame 1 of 0 to 9");
        playback.shows(Some(2), 9);
        playback.shows(Some(3), 10);
        change(&mut playback, r#"{"frame": 1}"#).unwrap();
        playback.take_seek();
        playback.shows(Some(1), 11);
        playback.jumps = 0;
        // Back by one: the frame before, once.
        assert_eq!(change(&mut playback, r#"{"step": -1}"#).unwrap().frame, Some(0));
        assert!(playback.is_sought() && playback.steps == 1);
        assert_eq!(change(&mut playback, r#"{"step": -1}"#), Err(422), "there is none before");
        assert_eq!((playback.take_seek(), playback.jumps), (Some(0), 1));
        playback.shows(Some(0), 9);
        let view = change(&mut playback, r#"{"paused": false}"#).unwrap();
        assert_eq!((view.frame, view.next_frame), (Some(0), 10));
        assert_eq!(change(&mut playback, r#"{"paused": true}"#).map(|_| playback.is_still()), Ok(true));
    }

    #[test]
    fn what_is_out_of_range_changes_nothing() {
        let mut playback = recording();
        playback.shows(Some(8), 8);
        let wrong = [
            r#"{"speed": 0.01, "paused": true}"#,
            r#"{"speed": 17}"#,
            r#"{"frame": 10}"#,
            r#"{"frame": 18446744073709551615, "paused": true}"#,
            r#"{"paused": true, "frame": 1, "step": 1}"#,
            r#"{"paused": true, "step": 2}"#,
            r#"{"paused": true, "step": -9}"#,
            r#"{"paused": true, "step": 9223372036854775807, "loop": true}"#,
            r#"{"paused": true, "step": -9223372036854775808}"#,
        ];
        let before = playback.view();
        for text in wrong {
            assert_eq!(change(&mut playback, text), Err(422), "{text}");
            assert_eq!(playback.view(), before, "{text}");
        }
        for text in [r#"{"speed": 0.05}"#, r#"{"speed": 16}"#, r#"{"paused": true, "step": 2, "loop": true}"#] {
            change(&mut playback, text).unwrap();
        }
        let mut synthetic = Playback::new(None);
        for text in [r#"{"frame": 0}"#, r#"{"loop": true}"#, r#"{"paused": true, "step": -1}"#] {
            assert_eq!(change(&mut synthetic, text), Err(409), "{text}");
        }
        let view = change(&mut synthetic, r#"{"paused": true, "step": 3, "speed": 2}"#).unwrap();
        assert_eq!((view.frame, view.length, view.repeat, synthetic.steps), (None, None, None, 3));
    }
}
