//! The clock of a recording: maps the time stamps of its frames to seconds that never decrease.
//!
//! A frame's time comes from `truth.jsonl`, else from its file (MCAP log time, video rate), else from its number and the
//! given rate; without any of these it has no time. The system clock is never read.

/// Time stamp of a picture in its file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stamp {
    /// Nanoseconds on a clock that all files of a recording share.
    LogTime(u64),
    /// Index of a picture in its file, and seconds between two.
    Number { number: usize, period_s: f64 },
    /// Seconds on the recording's clock.
    Seconds(f64),
}

/// Clock of one recording; see the module documentation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clock {
    /// Frame rate, Hz, for pictures without a time.
    pub rate_hz: Option<f64>,
    /// Frames so far.
    frames: u64,
    /// The first log time.
    origin_ns: Option<u64>,
    /// Added to the stamps, so that the clock continues across files and after a rewind.
    shift_s: f64,
    last_s: Option<f64>,
    /// Difference between the last two distinct times.
    step_s: Option<f64>,
    /// The next frame starts another pass.
    is_rewound: bool,
}

impl Clock {
    /// Time of the next frame, s. Log times count from the first.
    pub fn time_s(&mut self, stamp: Option<Stamp>) -> Option<f64> {
        let (number, is_rewound) = (self.frames, std::mem::take(&mut self.is_rewound));
        self.frames += 1;
        let (stamp_s, period_s, may_repeat) = match stamp {
            None => return self.rate_hz.filter(|_| self.last_s.is_none()).map(|rate_hz| number as f64 / rate_hz),
            Some(Stamp::LogTime(ns)) => {
                let origin_ns = *self.origin_ns.get_or_insert(ns);
                // Subtracts as integers: nanoseconds since 1970 lose digits as a float.
                let since = if ns < origin_ns { -((origin_ns - ns) as f64) } else { (ns - origin_ns) as f64 };
                (since * 1e-9, None, true)
            }
            Some(Stamp::Number { number, period_s }) => (number as f64 * period_s, Some(period_s), false),
            Some(Stamp::Seconds(stamp_s)) => (stamp_s, None, true),
        };
        let stamp_s = stamp_s + self.shift_s;
        let Some(last_s) = self.last_s else {
            self.last_s = Some(stamp_s);
            return Some(stamp_s);
        };
        let has_gone_on = !is_rewound && (stamp_s > last_s || stamp_s == last_s && may_repeat);
        let step_s = period_s.or(self.step_s).or(self.rate_hz.map(f64::recip));
        let time_s = if has_gone_on { stamp_s } else { last_s + step_s? };
        self.shift_s += time_s - stamp_s;
        if time_s > last_s {
            self.step_s = Some(time_s - last_s);
        }
        self.last_s = Some(time_s);
        Some(time_s)
    }

    /// Starts another pass; the clock continues.
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
        // The next pass continues after the last step.
        clock.rewind();
        assert_eq!(times(&mut clock, &[at(5), at(100_000_005)]), [Some(4.1), Some(4.199_999_999_999_999)]);
    }

    #[test]
    fn consecutive_videos_continue_at_their_rate() {
        let at = |number| Some(Stamp::Number { number, period_s: 0.04 });
        assert_eq!(times(&mut Clock::default(), &[at(0), at(1), at(0), at(0)]), [0.0, 0.04, 0.08, 0.12].map(Some));
    }

    #[test]
    fn frames_without_stamps_use_the_rate_or_have_no_time() {
        assert_eq!(times(&mut Clock::default(), &[None, None]), [None, None]);
        let mut clock = Clock { rate_hz: Some(50.0), ..Clock::default() };
        assert_eq!(times(&mut clock, &[None, None]), [Some(0.0), Some(0.02)]);
        clock.rewind();
        assert_eq!(times(&mut clock, &[None]), [Some(0.04)]);
        // A single repeated picture has no step.
        let mut clock = Clock::default();
        assert_eq!(clock.time_s(Some(Stamp::Seconds(3.0))), Some(3.0));
        clock.rewind();
        assert_eq!(clock.time_s(Some(Stamp::Seconds(3.0))), None);
        // A frame missing from truth.jsonl has no time, even if others have one.
        let stamp_s = |t| Some(Stamp::Seconds(t));
        let mut clock = Clock { rate_hz: Some(50.0), ..Clock::default() };
        assert_eq!(times(&mut clock, &[stamp_s(1.0), None, stamp_s(1.5)]), [Some(1.0), None, Some(1.5)]);
    }
}
