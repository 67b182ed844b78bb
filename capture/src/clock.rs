//! The clock of a recording: what its frames say of their times in, seconds on one clock out, which never goes back.
//!
//! A frame's time is the one that `truth.jsonl` names, else that of its file (MCAP's log time, a video's rate), else its number
//! over the rate at which the recording is said to be taken. Where none of them is known there is no time. Nothing here looks
//! at a clock of the machine.

/// When a picture was taken, as a file tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stamp {
    /// Nanoseconds on a clock that all files of a recording share.
    LogTime(u64),
    /// Number of a picture in its file, and seconds between two.
    Number { number: usize, period_s: f64 },
    /// Seconds on the recording's clock.
    Seconds(f64),
}

/// See the text above.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clock {
    /// Frames a second, for pictures that have no time.
    pub rate_hz: Option<f64>,
    /// Frames so far.
    frames: u64,
    /// The first log time.
    origin_ns: Option<u64>,
    /// Added to what frames say: the clock goes on where a file follows another, and where a recording begins again.
    shift_s: f64,
    last_s: Option<f64>,
    /// Between the last two frames whose times differ.
    step_s: Option<f64>,
    /// The next frame is the first of another round.
    is_rewound: bool,
}

impl Clock {
    /// The time of the next frame, s. Log times count from the first.
    pub fn time_s(&mut self, stamp: Option<Stamp>) -> Option<f64> {
        let (number, is_rewound) = (self.frames, std::mem::take(&mut self.is_rewound));
        self.frames += 1;
        let (told, period_s, may_repeat) = match stamp {
            None => return self.rate_hz.filter(|_| self.last_s.is_none()).map(|rate_hz| number as f64 / rate_hz),
            Some(Stamp::LogTime(ns)) => {
                let origin_ns = *self.origin_ns.get_or_insert(ns);
                // Before the difference becomes a float: nanoseconds since 1970 would lose digits.
                let since = if ns < origin_ns { -((origin_ns - ns) as f64) } else { (ns - origin_ns) as f64 };
                (since * 1e-9, None, true)
            }
            Some(Stamp::Number { number, period_s }) => (number as f64 * period_s, Some(period_s), false),
            Some(Stamp::Seconds(told)) => (told, None, true),
        };
        let told = told + self.shift_s;
        let Some(last_s) = self.last_s else {
            self.last_s = Some(told);
            return Some(told);
        };
        let has_gone_on = !is_rewound && (told > last_s || told == last_s && may_repeat);
        let step_s = period_s.or(self.step_s).or(self.rate_hz.map(f64::recip));
        let time_s = if has_gone_on { told } else { last_s + step_s? };
        self.shift_s += time_s - told;
        if time_s > last_s {
            self.step_s = Some(time_s - last_s);
        }
        self.last_s = Some(time_s);
        Some(time_s)
    }

    /// The first frame comes again: the clock goes on.
    pub fn rewind(&mut self) {
        self.is_rewound = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(clock: &mut Clock, stamps: &[Option<Stamp>]) -> Vec<Option<f64>> {
        stamps.iter().map(|stamp| clock.time_s(*stamp)).collect()
    }

    #[test]
    fn log_times_count_from_the_first_and_keep_their_gaps() {
        let at = |ns: u64| Some(Stamp::LogTime(1_700_000_000_000_000_000 + ns));
        let mut clock = Clock { rate_hz: Some(30.0), ..Clock::default() };
        let found = times(&mut clock, &[at(5), at(100_000_005), at(100_000_005), at(2_100_000_005)]);
        assert_eq!(found, [Some(0.0), Some(0.1), Some(0.1), Some(2.1)]);
        // The next round goes on after the last step.
        clock.rewind();
        assert_eq!(times(&mut clock, &[at(5), at(100_000_005)]), [Some(4.1), Some(4.199_999_999_999_999)]);
    }

    #[test]
    fn a_video_follows_another_at_its_rate() {
        let at = |number| Some(Stamp::Number { number, period_s: 0.04 });
        assert_eq!(times(&mut Clock::default(), &[at(0), at(1), at(0), at(0)]), [0.0, 0.04, 0.08, 0.12].map(Some));
    }

    #[test]
    fn without_a_time_of_its_own_a_frame_has_that_of_the_rate_or_none() {
        assert_eq!(times(&mut Clock::default(), &[None, None]), [None, None]);
        let mut clock = Clock { rate_hz: Some(50.0), ..Clock::default() };
        assert_eq!(times(&mut clock, &[None, None]), [Some(0.0), Some(0.02)]);
        clock.rewind();
        assert_eq!(times(&mut clock, &[None]), [Some(0.04)]);
        // One picture, again and again, has no step.
        let mut clock = Clock::default();
        assert_eq!(clock.time_s(Some(Stamp::Seconds(3.0))), Some(3.0));
        clock.rewind();
        assert_eq!(clock.time_s(Some(Stamp::Seconds(3.0))), None);
        // A frame that is missing in truth.jsonl has no time, though the others have.
        let told = |t| Some(Stamp::Seconds(t));
        let mut clock = Clock { rate_hz: Some(50.0), ..Clock::default() };
        assert_eq!(times(&mut clock, &[told(1.0), None, told(1.5)]), [Some(1.0), None, Some(1.5)]);
    }
}
