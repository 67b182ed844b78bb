//! Driver sequence numbers: counts the missing frames.

/// Numbers at least this far ahead, modulo 2³², mean that the driver restarted its count.
const BEHIND_MAX: u32 = 1 << 31;

/// Counts the numbers that a stream skips. They have 32 bits and wrap; consecutive frames may repeat a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sequence {
    last: Option<u32>,
    is_joining: bool,
}

impl Sequence {
    /// For a stream that others already read: its first number is 0, its second arbitrary (v4l2loopback).
    pub fn joining() -> Sequence {
        Sequence { last: None, is_joining: true }
    }

    /// Number of frames missing before this one.
    pub fn step(&mut self, number: u32) -> u64 {
        let Some(last) = self.last.replace(number) else { return 0 };
        if std::mem::take(&mut self.is_joining) {
            return 0;
        }
        match number.wrapping_sub(last) {
            0 => 0,
            ahead if ahead < BEHIND_MAX => u64::from(ahead) - 1,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Sequence;

    fn gaps(mut sequence: Sequence, numbers: &[u32]) -> Vec<u64> {
        numbers.iter().map(|number| sequence.step(*number)).collect()
    }

    #[test]
    fn gaps_are_counted_across_wraparound_and_repeated_numbers() {
        assert_eq!(gaps(Sequence::default(), &[0, 1, 2, 5, 6]), [0, 0, 0, 2, 0]);
        assert_eq!(gaps(Sequence::default(), &[7, 8]), [0, 0], "what was before the first is nobody's loss");
        assert_eq!(gaps(Sequence::default(), &[u32::MAX - 1, u32::MAX, 0, 2]), [0, 0, 0, 1]);
        assert_eq!(gaps(Sequence::default(), &[4, 4, 5, 5, 7]), [0, 0, 0, 0, 1]);
        assert_eq!(gaps(Sequence::default(), &[900, 0, 1]), [0, 0, 0], "begun anew");
        assert_eq!(gaps(Sequence::joining(), &[0, 412, 413, 415]), [0, 0, 0, 1]);
    }
}
