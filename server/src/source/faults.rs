//! `ReadFaults`: counts unreadable frames of a recording, and sets the pause after a whole round of them.
//!
//! It uses no clock.

use std::time::Duration;

use crate::limits::LIMITS;

/// The faults of one source.
#[derive(Default)]
pub struct ReadFaults {
    /// Consecutive unreadable frames.
    in_a_row: usize,
    /// Frames read since the last unreadable one.
    read_since: usize,
    /// The source's reason reports them.
    are_said: bool,
}

impl ReadFaults {
    /// A frame was read. `None` if there is nothing to clear, else whether a whole round is free of faults.
    pub fn read(&mut self, round: usize) -> Option<bool> {
        if !self.are_said {
            return None;
        }
        (self.in_a_row, self.read_since) = (0, self.read_since + 1);
        self.are_said = self.read_since < round;
        Some(!self.are_said)
    }

    /// A frame was unreadable: returns whether at least a whole round is, and the pause at the end of a round.
    pub fn failed(&mut self, round: usize) -> (bool, Option<Duration>) {
        *self = ReadFaults { in_a_row: self.in_a_row + 1, read_since: 0, are_said: true };
        let rest = self.in_a_row.is_multiple_of(round).then(|| rest_after(self.in_a_row / round));
        (self.in_a_row >= round, rest)
    }
}

/// Pause after that many unreadable rounds, from 1.
fn rest_after(rounds: usize) -> Duration {
    let (least, most) = LIMITS.reread_time;
    (least * (1 << rounds.saturating_sub(1).min(16))).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unreadable_rounds_back_off_up_to_a_bound() {
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
