//! The tracker's clock: strictly increasing frame times, s, from the clock of the frames' source or of the machine.
//!
//! No clock is trusted: one that stands still, goes back, is replaced by another or gives an impossible time advances the time
//! by one frame period.

use isophote_frame::Frame;
use serde::{Deserialize, Serialize};

use crate::solve::exact;

/// The clock of a frame's time.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
enum Origin {
    Source,
    Machine,
}

/// The last frame's time.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Last {
    #[serde(with = "exact")]
    time_s: f64,
    sequence: u64,
    /// The clock and the time of the last frame with a time, s.
    #[serde(rename = "told")]
    clock_time: Option<(Origin, f64)>,
}

/// The strictly increasing clock of a tracker.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FrameClock {
    last: Option<Last>,
    /// Added to the frames' own times.
    #[serde(with = "exact")]
    shift_s: f64,
}

/// Times beyond this are ignored: 300 years.
const FARTHEST_S: f64 = 1e10;

impl FrameClock {
    /// The frame's time by its source's clock, else by the machine's, else by its number, with frames `period_s` apart; always
    /// after the last one.
    pub fn time_s(&mut self, frame: &Frame, period_s: f64) -> f64 {
        let machine_s = frame.capture_ns.map(|ns| (Origin::Machine, ns as f64 * 1e-9));
        let clock_time = frame.time_s.map(|time_s| (Origin::Source, time_s)).or(machine_s);
        let clock_time = clock_time.filter(|(_, clock_s)| clock_s.abs() <= FARTHEST_S);
        let time_s = match (clock_time, self.last) {
            (Some((_, clock_s)), None) => clock_s,
            (Some((origin, clock_s)), Some(last)) => {
                let is_same = last.clock_time.is_some_and(|(known, _)| known == origin);
                let (next_s, shifted_s) = (last.time_s + period_s, clock_s + self.shift_s);
                match last.clock_time {
                    Some(_) if is_same && shifted_s > last.time_s => shifted_s,
                    // Two frames of one time: the shift is kept, so that later times hold.
                    Some((_, before_s)) if is_same && clock_s >= before_s => next_s,
                    // A restarted clock, or another one: later times continue from here.
                    _ => {
                        self.shift_s = next_s - clock_s;
                        next_s
                    }
                }
            }
            (None, None) => frame.sequence as f64 * period_s,
            (None, Some(last)) => last.time_s + frame.sequence.saturating_sub(last.sequence).max(1) as f64 * period_s,
        };
        let clock_time = clock_time.or(self.last.and_then(|last| last.clock_time));
        self.last = Some(Last { time_s, sequence: frame.sequence, clock_time });
        time_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::TestPicture;

    const PERIOD_S: f64 = 0.01;

    /// Clock times of frames with these times, s: of the source, and of the machine.
    fn times(times: &[(Option<f64>, Option<f64>)]) -> Vec<f64> {
        let mut clock = FrameClock::default();
        let mut time = |(number, (source_s, machine_s)): (usize, &(Option<f64>, Option<f64>))| {
            let mut frame = TestPicture::new(4, 4, Vec::new()).frame().with_sequence(number as u64);
            (frame.time_s, frame.capture_ns) = (*source_s, machine_s.map(|s| (s * 1e9) as u64));
            clock.time_s(&frame, PERIOD_S)
        };
        times.iter().enumerate().map(&mut time).collect()
    }

    fn are_near(found: &[f64], expected: &[f64]) {
        let is_near = found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(is_near, "{found:?}, expected {expected:?}");
    }

    fn source(times: &[f64]) -> Vec<(Option<f64>, Option<f64>)> {
        times.iter().map(|time| (Some(*time), Some(100.0 + time))).collect()
    }

    #[test]
    fn equal_times_do_not_shift_later_ones() {
        are_near(&times(&source(&[0.0, 0.0, 0.1, 0.1, 0.2])), &[0.0, 0.01, 0.1, 0.11, 0.2]);
        // A clock that stands still for several frames, then continues.
        are_near(&times(&source(&[1.0, 1.0, 1.0, 1.005, 1.5])), &[1.0, 1.01, 1.02, 1.03, 1.5]);
    }

    #[test]
    fn a_restarted_or_replaced_clock_continues() {
        are_near(&times(&source(&[5.0, 5.1, 0.0, 0.1])), &[5.0, 5.1, 5.11, 5.21]);
        let mixed = [(Some(2.0), Some(50.0)), (Some(2.1), Some(50.1)), (None, Some(50.2)), (Some(2.3), Some(50.3))];
        are_near(&times(&mixed), &[2.0, 2.1, 2.11, 2.12]);
        are_near(&times(&[(None, None), (None, None), (Some(7.0), None)]), &[0.0, 0.01, 0.02]);
    }

    #[test]
    fn impossible_times_are_ignored() {
        for absurd in [1e300, -1e300, f64::INFINITY, f64::NAN] {
            are_near(&times(&source(&[0.0, 0.1, absurd, 0.3])), &[0.0, 0.1, 0.11, 0.3]);
        }
    }
}
