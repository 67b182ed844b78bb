//! `Playback`: pause, speed and position of a source whose frames are rendered or read.
//!
//! Changed by clients, followed by the source's thread; never blocks. Frame numbers only grow; positions in a recording may go
//! back.

use isophote_machine::monotonic_ns;
use isophote_tracker::plain;
use isophote_wire::{PlaybackDocument, PlaybackView};

use crate::http::preconditions::EntityTag;
use crate::limits::LIMITS;
use crate::problem::Problem;

/// The playback of one source.
pub struct Playback {
    /// Whether it is paused.
    pub is_paused: bool,
    /// Factor on its rate.
    pub speed: f64,
    /// The position in a recording; `None` for a synthetic source.
    pub tape: Option<Tape>,
    /// Frames still to be shown while paused.
    pub steps: u64,
    /// Number of jumps in the picture.
    pub jumps: u64,
    /// Time of the last change.
    pub changed_ns: u64,
    /// Number of the next frame.
    pub number: u64,
    /// No session has subscribed since the last frame was shown.
    pub is_seen: bool,
    /// New after each change.
    pub tag: EntityTag,
}

/// Position in a recording.
pub struct Tape {
    /// Number of frames.
    pub count: usize,
    /// Whether it loops.
    pub repeat: bool,
    /// Position of the last shown frame.
    pub shown: Option<usize>,
    /// Position to continue from.
    pub seek: Option<usize>,
}

impl Playback {
    /// Plays at its rate.
    pub fn new(tape: Option<Tape>) -> Playback {
        Playback {
            is_paused: false,
            speed: 1.0,
            tape,
            steps: 0,
            jumps: 0,
            changed_ns: 0,
            number: 0,
            is_seen: false,
            tag: EntityTag::unique(),
        }
    }

    /// Whether the next frame is withheld.
    pub fn is_still(&self) -> bool {
        self.is_paused && self.steps == 0
    }

    /// Whether a seek is pending.
    pub fn is_sought(&self) -> bool {
        self.tape.as_ref().is_some_and(|tape| tape.seek.is_some())
    }

    /// Takes a pending seek; counts a jump unless it leads to the next frame.
    pub fn take_seek(&mut self) -> Option<usize> {
        let tape = self.tape.as_mut()?;
        let place = tape.seek.take()?;
        self.jumps += u64::from(tape.shown.is_some_and(|shown| shown + 1 != place));
        Some(place)
    }

    /// Records that the frame at `place` is shown as `number`.
    pub fn shows(&mut self, place: Option<usize>, number: u64) {
        self.steps = self.steps.saturating_sub(1);
        self.number = number + 1;
        self.is_seen = true;
        if let Some(tape) = &mut self.tape {
            tape.shown = place;
        }
    }

    /// Applies a client's document, all or nothing. Repeating a document while paused shows nothing again.
    pub fn change(&mut self, document: &PlaybackDocument) -> Result<(), Problem> {
        let PlaybackDocument { paused, frame, speed, repeat } = *document;
        let is_paused = paused.unwrap_or(self.is_paused);
        let (least, most) = LIMITS.speed;
        if let Some(speed) = speed.filter(|speed| !(least..=most).contains(speed)) {
            let message = format!("speed is {}; it may be {least} to {most} times the rate", plain(speed));
            return Err(Problem::wrong_key("out-of-range", "speed", message));
        }
        if self.tape.is_none() && repeat.is_some() {
            let message = "a synthetic source has no end, so that it cannot loop: its time goes on";
            return Err(Problem::conflict("not-applicable", message));
        }
        let (mut seek, mut steps) = (None, if is_paused && self.is_paused { self.steps } else { 0 });
        match (&self.tape, frame) {
            (_, None) => {}
            (Some(tape), Some(frame)) => {
                let place = tape.place(frame)?;
                if !(is_paused && tape.now() == Some(place) && (tape.seek.is_some() || self.is_seen)) {
                    (seek, steps) = (Some(place), u64::from(is_paused));
                }
            }
            (None, Some(frame)) => steps = self.steps_to(frame, is_paused)?,
        }
        (self.is_paused, self.steps, self.speed) = (is_paused, steps, speed.unwrap_or(self.speed));
        if let Some(tape) = &mut self.tape {
            tape.repeat = repeat.unwrap_or(tape.repeat);
            tape.seek = seek.or(tape.seek);
        }
        self.changed_ns = monotonic_ns();
        self.tag = EntityTag::unique();
        Ok(())
    }

    /// Frames that a synthetic source shows up to and including `frame`.
    fn steps_to(&self, frame: u64, is_paused: bool) -> Result<u64, Problem> {
        if !is_paused {
            let message = "a synthetic source that plays cannot be sent to a frame; pause it, with \"paused\": true in the \
                           same document, and it goes on to that frame";
            return Err(Problem::conflict("not-applicable", message));
        }
        let Some(steps) = frame.saturating_add(1).checked_sub(self.number) else {
            let last = self.number - 1;
            let message =
                format!("frame {frame} is over: frame {last} was shown, and the time of a synthetic source goes on");
            return Err(Problem::conflict("not-applicable", message));
        };
        if steps > LIMITS.steps {
            let most = self.number.saturating_add(LIMITS.steps - 1);
            let message = format!("frame is {frame}; it may be {most} at most, {} frames on", LIMITS.steps);
            return Err(Problem::wrong_key("out-of-range", "frame", message));
        }
        Ok(steps)
    }

    /// The playback as published.
    pub fn view(&self) -> PlaybackView {
        let tape = self.tape.as_ref();
        PlaybackView {
            paused: self.is_paused,
            frame: match tape {
                Some(tape) => tape.now().map(|place| place as u64),
                None => self.number.checked_sub(1),
            },
            length: tape.map(|tape| tape.count as u64),
            speed: self.speed,
            repeat: tape.map(|tape| tape.repeat),
            next_frame: self.number,
        }
    }
}

impl Tape {
    /// Current position, or the pending seek's.
    fn now(&self) -> Option<usize> {
        self.seek.or(self.shown)
    }

    /// Checks a position.
    fn place(&self, frame: u64) -> Result<usize, Problem> {
        let found = usize::try_from(frame).ok().filter(|place| *place < self.count);
        found.ok_or_else(|| {
            let last = self.count - 1;
            let message = format!("there is no frame {frame}: the recording has {} frames, 0 to {last}", self.count);
            Problem::wrong_key("out-of-range", "frame", message)
        })
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
    fn seek_counts_as_a_jump_unless_to_the_next_frame() {
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
    fn repeated_seek_shows_its_frame_once() {
        let mut playback = recording();
        let paused = r#"{"paused": true, "frame": 2, "speed": 0.5}"#;
        for _ in 0..2 {
            let view = change(&mut playback, paused).unwrap();
            assert_eq!((view.paused, view.speed, view.frame, view.length), (true, 0.5, Some(2), Some(10)));
            assert!(playback.is_sought() && playback.steps == 1);
        }
        assert_eq!(playback.take_seek(), Some(2));
        playback.shows(Some(2), 7);
        for _ in 0..2 {
            let view = change(&mut playback, paused).unwrap();
            assert!(playback.is_still() && !playback.is_sought());
            assert_eq!((view.frame, view.next_frame), (Some(2), 8), "nothing is shown twice");
        }
        // A later session has not seen it.
        playback.is_seen = false;
        change(&mut playback, paused).unwrap();
        assert!(playback.is_sought() && playback.steps == 1);
        playback.take_seek();
        playback.shows(Some(2), 8);
        // Positions are absolute; the newest request wins.
        change(&mut playback, r#"{"frame": 4}"#).unwrap();
        change(&mut playback, r#"{"frame": 1}"#).unwrap();
        assert_eq!((playback.take_seek(), playback.steps), (Some(1), 1));
        playback.shows(Some(1), 9);
        let view = change(&mut playback, r#"{"paused": false}"#).unwrap();
        assert_eq!((view.frame, view.next_frame), (Some(1), 10));
        assert_eq!(change(&mut playback, r#"{"paused": true}"#).map(|_| playback.is_still()), Ok(true));
    }

    #[test]
    fn synthetic_source_steps_forward_only() {
        let mut playback = Playback::new(None);
        assert_eq!(change(&mut playback, r#"{"frame": 3}"#), Err(409), "it plays");
        for _ in 0..2 {
            let view = change(&mut playback, r#"{"paused": true, "frame": 2, "speed": 2}"#).unwrap();
            assert_eq!((view.frame, view.length, view.repeat, playback.steps), (None, None, None, 3));
        }
        playback.shows(None, 0);
        change(&mut playback, r#"{"frame": 2}"#).unwrap();
        assert_eq!(playback.steps, 2, "one of them was shown");
        playback.shows(None, 1);
        playback.shows(None, 2);
        assert_eq!(change(&mut playback, r#"{"frame": 2}"#).unwrap().frame, Some(2));
        assert!(playback.is_still());
        assert_eq!(change(&mut playback, r#"{"frame": 1}"#), Err(409));
        assert_eq!(change(&mut playback, r#"{"loop": true}"#), Err(409));
        assert_eq!(change(&mut playback, &format!(r#"{{"frame": {}}}"#, 3 + LIMITS.steps)), Err(422));
        assert_eq!(change(&mut playback, r#"{"frame": 18446744073709551615}"#), Err(422));
        assert!(playback.is_still());
        change(&mut playback, &format!(r#"{{"frame": {}}}"#, 2 + LIMITS.steps)).unwrap();
        assert_eq!(playback.steps, LIMITS.steps);
    }

    #[test]
    fn out_of_range_requests_change_nothing() {
        let mut playback = recording();
        playback.shows(Some(8), 8);
        let wrong = [
            r#"{"speed": 0.01, "paused": true}"#,
            r#"{"speed": 17}"#,
            r#"{"frame": 10}"#,
            r#"{"frame": 18446744073709551615, "paused": true}"#,
            r#"{"paused": true, "frame": 1, "speed": 0}"#,
        ];
        let before = (playback.view(), playback.tag.clone());
        for text in wrong {
            assert_eq!(change(&mut playback, text), Err(422), "{text}");
            assert_eq!((playback.view(), playback.tag.clone()), before, "{text}");
        }
        for text in [r#"{"speed": 0.05}"#, r#"{"speed": 16}"#, r#"{"paused": true, "frame": 9, "loop": true}"#] {
            change(&mut playback, text).unwrap();
            assert_ne!(playback.tag, before.1, "{text}");
        }
    }
}
