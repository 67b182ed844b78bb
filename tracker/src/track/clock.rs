//! The clock of a tracker: when each frame was taken, on one clock that always goes on.
//!
//! What comes in: frames that may say when they were taken, by their source's clock or by the machine's. What goes out:
//! seconds, each later than the ones before. It trusts no clock: one that stands still, goes back, gives way to another or
//! says what cannot be moves the time on by a frame.

use isophote_frame::Frame;
use serde::{Deserialize, Serialize};

use crate::solve::exact;

/// Whose clock a frame's time is of.
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
    /// What the last frame with a time said, and by which clock.
    told: Option<(Origin, f64)>,
}

/// See the text above.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FrameClock {
    last: Option<Last>,
    /// Added to what frames say of their times.
    #[serde(with = "exact")]
    shift_s: f64,
}

/// Times beyond this are no times: 300 years.
const FARTHEST_S: f64 = 1e10;

impl FrameClock {
    /// When the frame was taken: by its source's clock, else by the machine's, else by its number, frames being `period_s`
    /// apart; always after the last one.
    pub fn time_s(&mut self, frame: &Frame, period_s: f64) -> f64 {
        let machine_s = frame.capture_ns.map(|ns| (Origin::Machine, ns as f64 * 1e-9));
        let told = frame.time_s.map(|time_s| (Origin::Source, time_s)).or(machine_s);
        let told = told.filter(|(_, told_s)| told_s.abs() <= FARTHEST_S);
        let time_s = match (told, self.last) {
            (Some((_, told_s)), None) => told_s,
            (Some((origin, told_s)), Some(last)) => {
                let is_same = last.told.is_some_and(|(known, _)| known == origin);
                let (next_s, shifted_s) = (last.time_s + period_s, told_s + self.shift_s);
                match last.told {
                    Some(_) if is_same && shifted_s > last.time_s => shifted_s,
                    // Two frames of one time: what comes after is as late as it says.
                    Some((_, before_s)) if is_same && told_s >= before_s => next_s,
                    // A clock that begins anew, or another one: what comes after goes on from here.
                    _ => {
                        self.shift_s = next_s - told_s;
                        next_s
                    }
                }
            }
            (None, None) => frame.sequence as f64 * period_s,
            (None, Some(last)) => last.time_s + frame.sequence.saturating_sub(last.sequence).max(1) as f64 * period_s,
        };
        let told = told.or(self.last.and_then(|last| last.told));
        self.last = Some(Last { time_s, sequence: frame.sequence, told });
        time_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::TestPicture;

    const PERIOD_S: f64 = 0.01;

    /// Times of frames that say these: seconds of the source, else of the machine.
    fn times(said: &[(Option<f64>, Option<f64>)]) -> Vec<f64> {
        let mut clock = FrameClock::default();
        let mut time = |(number, (source_s, machine_s)): (usize, &(Option<f64>, Option<f64>))| {
            let mut frame = TestPicture::new(4, 4, Vec::new()).frame().with_sequence(number as u64);
            (frame.time_s, frame.capture_ns) = (*source_s, machine_s.map(|s| (s * 1e9) as u64));
            clock.time_s(&frame, PERIOD_S)
        };
        said.iter().enumerate().map(&mut time).collect()
    }

    fn are_near(found: &[f64], expected: &[f64]) {
        let is_near = found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(is_near, "{found:?}, expected {expected:?}");
    }

    fn source(times: &[f64]) -> Vec<(Option<f64>, Option<f64>)> {
        times.iter().map(|time| (Some(*time), Some(100.0 + time))).collect()
    }

    #[test]
    fn equal_times_move_no_later_one() {
        are_near(&times(&source(&[0.0, 0.0, 0.1, 0.1, 0.2])), &[0.0, 0.01, 0.1, 0.11, 0.2]);
        // A clock that stands still for long, and goes on.
        are_near(&times(&source(&[1.0, 1.0, 1.0, 1.005, 1.5])), &[1.0, 1.01, 1.02, 1.03, 1.5]);
    }

    #[test]
    fn a_clock_that_begins_anew_or_gives_way_to_another_goes_on_from_here() {
        are_near(&times(&source(&[5.0, 5.1, 0.0, 0.1])), &[5.0, 5.1, 5.11, 5.21]);
        let mixed = [(Some(2.0), Some(50.0)), (Some(2.1), Some(50.1)), (None, Some(50.2)), (Some(2.3), Some(50.3))];
        are_near(&times(&mixed), &[2.0, 2.1, 2.11, 2.12]);
        are_near(&times(&[(None, None), (None, None), (Some(7.0), None)]), &[0.0, 0.01, 0.02]);
    }

    #[test]
    fn what_cannot_be_a_time_is_none() {
        for absurd in [1e300, -1e300, f64::INFINITY, f64::NAN] {
            are_near(&times(&source(&[0.0, 0.1, absurd, 0.3])), &[0.0, 0.1, 0.11, 0.3]);
        }
    }
}
