//! When a frame is due: an absolute schedule, so that waiting errors do not accumulate.

use std::time::{Duration, Instant};

/// Ticks at a rate.
pub struct Ticks {
    period: Duration,
    next: Option<Instant>,
}

/// Period of a rate; zero at rate 0.
fn period(rate_hz: f64) -> Duration {
    if rate_hz > 0.0 { Duration::from_secs_f64(1.0 / rate_hz) } else { Duration::ZERO }
}

impl Ticks {
    /// `rate_hz` 0: always due at once.
    pub fn new(rate_hz: f64) -> Ticks {
        Ticks { period: period(rate_hz), next: None }
    }

    /// Due time at another rate of the frame that was due at `due`: one new period after the previous frame.
    pub fn retimed(&mut self, due: Instant, rate_hz: f64) -> Instant {
        let (before, now) = (self.period, period(rate_hz));
        if before == now {
            return due;
        }
        self.period = now;
        let due = due.checked_sub(before).map_or(due, |begun| begun + now);
        self.next = Some(due + now);
        due
    }

    /// When the next frame is due, seen from `now`. A schedule more than one period behind restarts at `now`: frames are late
    /// then, never in a burst.
    pub fn due(&mut self, now: Instant) -> Instant {
        let due = match self.next {
            Some(next) if next + self.period >= now => next,
            _ => now,
        };
        self.next = Some(due + self.period);
        due
    }

    /// Restarts the schedule, after a pause.
    pub fn restart(&mut self) {
        self.next = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedule_is_absolute_without_bursts() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut schedule = Ticks::new(100.0);
        assert_eq!(schedule.due(at(0)), at(0));
        assert_eq!(schedule.due(at(3)), at(10));
        assert_eq!(schedule.due(at(14)), at(20)); // woken late: the grid stays
        assert_eq!(schedule.due(at(39)), at(30)); // one behind: at once
        assert_eq!(schedule.due(at(95)), at(95)); // far behind: a new grid
        assert_eq!(schedule.due(at(96)), at(105));
    }

    #[test]
    fn rate_change_counts_from_the_last_frame() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut schedule = Ticks::new(100.0);
        assert_eq!(schedule.due(at(0)), at(0));
        let due = schedule.due(at(1));
        assert_eq!(schedule.retimed(due, 100.0), at(10));
        assert_eq!(schedule.retimed(due, 10.0), at(100));
        assert_eq!(schedule.retimed(at(100), 1000.0), at(1));
        assert_eq!(schedule.due(at(1)), at(2));
    }
}
