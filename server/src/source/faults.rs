//! `ReadFaults`: frames of a recording that could not be read, and for how long to rest after a whole round of them.
//!
//! What comes in: each frame that could be read, or not. What goes out: what is to be said of it. It knows no clock.

use std::time::Duration;

use crate::limits::LIMITS;

/// Of one source.
#[derive(Default)]
pub struct ReadFaults {
    /// One after the other.
    in_a_row: usize,
    /// Frames that could be read since the last that could not.
    read_since: usize,
    /// The source has a reason that tells of them.
    are_said: bool,
}

impl ReadFaults {
    /// A frame was read. `None` where there is nothing to be taken back, else whether a whole round is free of faults.
    pub fn read(&mut self, round: usize) -> Option<bool> {
        if !self.are_said {
            return None;
        }
        (self.in_a_row, self.read_since) = (0, self.read_since + 1);
        self.are_said = self.read_since < round;
        Some(!self.are_said)
    }

    /// One could not be read: whether that makes a whole round of them, or more, and for how long to rest at the end of one.
    pub fn failed(&mut self, round: usize) -> (bool, Option<Duration>) {
        *self = ReadFaults { in_a_row: self.in_a_row + 1, read_since: 0, are_said: true };
        let rest = self.in_a_row.is_multiple_of(round).then(|| rest_after(self.in_a_row / round));
        (self.in_a_row >= round, rest)
    }
}

/// After so many rounds, from 1.
fn rest_after(rounds: usize) -> Duration {
    let (least, most) = LIMITS.reread_time;
    (least * (1 << rounds.saturating_sub(1).min(16))).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rests_come_after_rounds_and_grow_up_to_a_bound() {
        let (least, most) = LIMITS.reread_time;
        let mut faults = ReadFaults::default();
        assert_eq!(faults.read(2), None);
        assert_eq!((faults.failed(2), faults.failed(2)), ((false, None), (true, Some(least))));
        assert_eq!((faults.failed(2), faults.failed(2)), ((true, None), (true, Some(2 * least))));
        assert_eq!((faults.read(2), faults.failed(2)), (Some(false), (false, None)));
        assert_eq!((faults.read(2), faults.read(2), faults.read(2)), (Some(false), Some(true), None));
        assert_eq!(rest_after(usize::MAX), most);
    }
}
