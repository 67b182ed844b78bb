//! CLOCK_MONOTONIC as a number, comparable between the service and other programs of the machine. The wall clock is a label for
//! people and enters no computation.

use std::time::{SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};

/// Nanoseconds of CLOCK_MONOTONIC.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// CPU time of the calling thread, nanoseconds.
pub fn thread_ns() -> u64 {
    let used = clock_gettime(ClockId::ThreadCPUTime);
    used.tv_sec as u64 * 1_000_000_000 + used.tv_nsec as u64
}

/// Milliseconds since `start_ns`.
pub fn elapsed_ms(start_ns: u64) -> f64 {
    monotonic_ns().saturating_sub(start_ns) as f64 / 1e6
}

/// Milliseconds since 1970 by the wall clock.
#[allow(clippy::disallowed_methods)] // a label: the time of day of an action
pub fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}

/// Nanoseconds since 1970 of a time of CLOCK_MONOTONIC, by the present offset of the wall clock; `None` before 1970.
pub fn unix_ns_at(monotonic_ns: u64) -> Option<u64> {
    let read = |clock| {
        let now = clock_gettime(clock);
        i128::from(now.tv_sec) * 1_000_000_000 + i128::from(now.tv_nsec)
    };
    let (before, wall, after) = (read(ClockId::Monotonic), read(ClockId::Realtime), read(ClockId::Monotonic));
    u64::try_from(wall - (before + after) / 2 + i128::from(monotonic_ns)).ok()
}

/// A wall-clock time in RFC 3339, UTC: `2026-11-23T04:05:06.789Z`.
pub fn rfc3339(unix_ms: u64) -> String {
    let (days, ms) = (unix_ms / 86_400_000, unix_ms % 86_400_000);
    // Years begin in March, so that the leap day is the last one (H. Hinnant, chrono-compatible date algorithms).
    let days = days + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = 400 * era + year + u64::from(month <= 2);
    let (seconds, ms) = (ms / 1000, ms % 1000);
    let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        for (unix_ms, date) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (951_868_799_999, "2000-02-29T23:59:59.999Z"),
            (1_709_251_199_001, "2024-02-29T23:59:59.001Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
            (1_798_761_600_000, "2027-01-01T00:00:00.000Z"),
        ] {
            assert_eq!(rfc3339(unix_ms), date);
        }
        assert!(unix_ms() > 1_700_000_000_000);
    }

    #[test]
    fn monotonic_times_convert_to_wall_clock_times() {
        let now_ns = monotonic_ns();
        let (before_ms, unix_ns, after_ms) = (unix_ms(), unix_ns_at(now_ns).unwrap(), unix_ms());
        let later_ns = unix_ns_at(now_ns + 3_600_000_000_000).unwrap();
        // The clocks are read one after the other, which takes a busy machine some time.
        let slack_ms = 1 + after_ms - before_ms;
        assert!((before_ms - slack_ms..=after_ms + slack_ms).contains(&(unix_ns / 1_000_000)), "{unix_ns}");
        let hour_ns = later_ns - unix_ns;
        assert!(hour_ns.abs_diff(3_600_000_000_000) < 60_000_000_000, "{hour_ns}");
    }
}
