//! `PreviewPace`: limits the previews in flight to a reader, and adapts the quality and size of JPEG, from the times at which
//! messages were sent and read. It depends on no socket and no clock.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Messages in flight: sent, and not known to be read.
const FLIGHTS_MAX: usize = 8;
/// Bytes in flight from which on no further message is sent.
const FLIGHT_BYTES: usize = 64 * 1024;
/// Age of the oldest message in flight from which on no further message is sent.
const FLIGHT_TIME: Duration = Duration::from_millis(100);
/// Delay of a message beyond the fastest one above which the next ones become smaller.
const LATE: Duration = Duration::from_millis(120);
/// Delay of a message beyond the fastest one below which it counts as early.
const EARLY: Duration = Duration::from_millis(50);
/// Consecutive early messages after which the next ones become larger; doubles each time that this was too much.
const CALM: u32 = 60;
const CALM_MAX: u32 = 1920;

/// Quality of JPEG and reduction along x and y, best first.
const LEVELS: [(u8, usize); 6] = [(80, 1), (60, 1), (40, 1), (50, 2), (30, 2), (30, 4)];

/// The pace of one reader.
#[derive(Debug)]
pub struct PreviewPace {
    flights: VecDeque<Flight>,
    next: u64,
    level: usize,
    fastest: Option<Duration>,
    calm: u32,
    calm_wanted: u32,
}

#[derive(Debug)]
struct Flight {
    number: u64,
    level: usize,
    bytes: usize,
    sent: Instant,
}

impl Default for PreviewPace {
    fn default() -> PreviewPace {
        let flights = VecDeque::with_capacity(FLIGHTS_MAX);
        PreviewPace { flights, next: 0, level: 0, fastest: None, calm: 0, calm_wanted: CALM }
    }
}

impl PreviewPace {
    /// Whether there may be another message.
    pub fn is_free(&self, now: Instant) -> bool {
        let bytes: usize = self.flights.iter().map(|flight| flight.bytes).sum();
        let is_young = |flight: &Flight| now.saturating_duration_since(flight.sent) < FLIGHT_TIME;
        match self.flights.iter().find(|flight| flight.bytes > 0) {
            None => true,
            Some(first) => self.flights.len() < FLIGHTS_MAX && bytes < FLIGHT_BYTES && is_young(first),
        }
    }

    /// Quality of JPEG, and reduction on top of the requested one.
    pub fn level(&self) -> (u8, usize) {
        LEVELS[self.level]
    }

    /// Notes a sent message; returns its number for [`PreviewPace::read`]. An empty message before all others measures the
    /// latency.
    pub fn send(&mut self, bytes: usize, now: Instant) -> u64 {
        let number = self.next;
        self.next += 1;
        self.flights.push_back(Flight { number, level: self.level, bytes, sent: now });
        number
    }

    /// Notes that the message of that number, and all before it, were read.
    pub fn read(&mut self, number: u64, now: Instant) {
        while let Some(flight) = self.flights.pop_front_if(|flight| flight.number <= number) {
            let took = now.saturating_duration_since(flight.sent);
            let fastest = self.fastest.map_or(took, |fastest| fastest.min(took));
            self.fastest = Some(fastest);
            // Messages sent before the last change of level do not count.
            if flight.level == self.level {
                self.follow(took - fastest);
            }
        }
    }

    fn follow(&mut self, late: Duration) {
        if late > LATE && self.level + 1 < LEVELS.len() {
            self.level += 1;
            if self.calm > 0 {
                self.calm_wanted = (2 * self.calm_wanted).min(CALM_MAX);
            }
            self.calm = 0;
        } else if late < EARLY {
            self.calm += 1;
            if self.calm >= self.calm_wanted && self.level > 0 {
                (self.level, self.calm) = (self.level - 1, 0);
            }
        } else {
            self.calm = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates a reader of `bytes_s` bytes per second, of pictures with `bytes` at full size and quality. Returns the
    /// messages read per second, and the longest latency in the last second.
    fn read(pace: &mut PreviewPace, begin: Instant, bytes_s: f64, seconds: u64, bytes: f64) -> (f64, Duration) {
        let end = begin + Duration::from_secs(seconds);
        let (mut now, mut idle, mut count, mut longest) = (begin, begin, 0, Duration::ZERO);
        let mut arriving: VecDeque<(u64, Instant, Instant)> = VecDeque::new();
        let probe = pace.send(0, now);
        pace.read(probe, now + Duration::from_millis(1));
        while now < end {
            while let Some((number, sent, at)) = arriving.pop_front_if(|(_, _, at)| *at <= now) {
                pace.read(number, at);
                count += 1;
                if end - at < Duration::from_secs(1) {
                    longest = longest.max(at - sent);
                }
            }
            if pace.is_free(now) {
                let (quality, step) = pace.level();
                let size = bytes * f64::from(quality) / 80.0 / (step * step) as f64;
                let number = pace.send(size as usize, now);
                idle = idle.max(now) + Duration::from_secs_f64(size / bytes_s);
                arriving.push_back((number, now, idle + Duration::from_millis(1)));
            }
            now += Duration::from_millis(33);
        }
        (f64::from(count) / seconds as f64, longest)
    }

    #[test]
    fn a_slow_reader_gets_smaller_messages_without_delay() {
        for (bytes_s, bytes) in [(500e3, 60e3), (500e3, 120e3), (125e3, 40e3)] {
            let (rate_hz, longest) = read(&mut PreviewPace::default(), Instant::now(), bytes_s, 30, bytes);
            assert!(rate_hz >= 5.0 && longest <= Duration::from_millis(300), "{bytes}: {rate_hz} {longest:?}");
        }
    }

    #[test]
    fn a_reader_that_becomes_fast_gets_full_quality_again() {
        let mut pace = PreviewPace::default();
        let begin = Instant::now();
        assert!(read(&mut pace, begin, 1e8, 5, 60e3).0 > 29.0);
        assert_eq!(pace.level(), LEVELS[0]);
        read(&mut pace, begin, 125e3, 10, 60e3);
        assert_ne!(pace.level(), LEVELS[0]);
        pace.flights.clear();
        read(&mut pace, begin, 1e8, 400, 60e3);
        assert_eq!(pace.level(), LEVELS[0]);
    }

    #[test]
    fn a_stalled_reader_is_sent_little_more_than_one_message() {
        let mut pace = PreviewPace::default();
        let now = Instant::now();
        pace.send(0, now);
        assert!(pace.is_free(now + Duration::from_secs(1)), "there is no message that could be read");
        pace.send(10_000_000, now);
        assert!(!pace.is_free(now));
        let mut pace = PreviewPace::default();
        for _ in 0..FLIGHTS_MAX {
            assert!(pace.is_free(now));
            pace.send(1, now);
        }
        assert!(!pace.is_free(now));
        pace.read(6, now);
        assert!(pace.is_free(now) && !pace.is_free(now + FLIGHT_TIME));
    }
}
