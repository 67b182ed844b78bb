//! `LatestPace`: delays the next message to a reader of the newest estimates until it has read nearly all earlier ones.
//!
//! So a reader that is slower than the frames gets as many estimates as it can read, each of them new. The socket buffers of
//! both systems hold hundreds of kilobytes, which are seconds of a slow reader. So a message is written once the one before has
//! left this machine and the TCP window of the peer, which unread bytes narrow, shows that little is unread. The window is
//! reported with acknowledgements only, not when the reader reads later: if too much was unread, the interval of messages grows
//! until it suits the reader, and shrinks again.
//!
//! The pace itself depends on no socket and no clock.

use std::sync::Arc;
use std::time::{Duration, Instant};

use isophote_machine::PeerProgress;

use crate::limits::LIMITS;
use crate::net::socket::ClientLink;

/// Interval between checks that sent messages have arrived: two ticks of the runtime's timer.
const POLL: Duration = Duration::from_millis(2);
/// Time span of messages at the mean rate that may be unread: a reader that is as fast is late by no more.
const BURST: Duration = Duration::from_millis(5);
/// The longest interval: a reader that needs more for a message counts as stalled.
const GAP_MAX: Duration = Duration::from_secs(10);
/// Factor of the interval if too much is unread.
const SLOWER: f64 = 1.5;
/// Factor of the interval if nothing is unread.
const FASTER: f64 = 0.7;
/// Factor of the interval if one message is unread, which the reader may have read since: tries a shorter interval.
const TRIES: f64 = 0.93;
/// Repetitions of the same number of unread bytes, at longer and longer intervals, after which the peer's window is taken to be
/// smaller with nothing unread.
const ALIKE_MAX: u32 = 4;

/// The pace of one reader.
#[derive(Debug, Default)]
pub struct LatestPace {
    /// The largest window so far: that of a reader that has read everything.
    widest_bytes: u64,
    /// Length of the longest recent message.
    message_bytes: u64,
    last: Option<Sent>,
    /// Mean interval of messages.
    interval: Duration,
    /// Smallest interval of messages.
    gap: Duration,
    unread_before: u64,
    alike: u32,
}

#[derive(Debug)]
struct Sent {
    at: Instant,
    /// All of it was acknowledged, and the unread bytes at that time were evaluated.
    is_judged: bool,
}

/// Whether there may be another message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permit {
    /// A message may be sent now.
    Now,
    /// Ask again after this time.
    Later(Duration),
    /// The peer has acknowledged nothing for too long.
    Gone,
}

impl LatestPace {
    /// Whether there may be another message, by the kernel's counters.
    pub fn permit(&mut self, peer: PeerProgress, now: Instant) -> Permit {
        self.widest_bytes = self.widest_bytes.max(peer.window_bytes);
        let unread = self.widest_bytes - peer.window_bytes;
        let bound = self.bound() + peer.window_step_bytes;
        let Some(last) = &mut self.last else { return Permit::Now };
        let since = now.saturating_duration_since(last.at);
        if peer.is_acknowledged && peer.unsent_bytes == 0 && !last.is_judged {
            last.is_judged = true;
            self.judge(unread, bound, since, peer.window_bytes);
        }
        let is_judged = self.last.as_ref().is_none_or(|last| last.is_judged);
        if !is_judged && since > LIMITS.send_time {
            return Permit::Gone;
        }
        let wait = self.gap.saturating_sub(since);
        let is_free = peer.unsent_bytes == 0 && (is_judged || unread < bound);
        if is_free && wait.is_zero() { Permit::Now } else { Permit::Later(wait.max(POLL)) }
    }

    /// Number of unread bytes that is too many: one and a half messages, or a burst.
    fn bound(&self) -> u64 {
        let burst = BURST.as_nanos() as u64 * self.message_bytes / (self.interval.as_nanos() as u64).max(1);
        (self.message_bytes * 3 / 2).max(if self.interval.is_zero() { 0 } else { burst })
    }

    fn judge(&mut self, unread: u64, bound: u64, since: Duration, window_bytes: u64) {
        if unread >= bound {
            self.gap = self.gap.mul_f64(SLOWER).max(2 * since).min(GAP_MAX);
            let is_alike = unread.abs_diff(self.unread_before) < self.message_bytes / 2;
            self.alike = if is_alike { self.alike + 1 } else { 0 };
            if self.alike >= ALIKE_MAX {
                (self.widest_bytes, self.gap, self.alike) = (window_bytes, Duration::ZERO, 0);
            }
        } else {
            let is_read = unread < self.message_bytes / 2;
            self.gap = self.gap.mul_f64(if is_read { FASTER } else { TRIES });
            if self.gap < POLL {
                self.gap = Duration::ZERO;
            }
            self.alike = 0;
        }
        self.unread_before = unread;
    }

    /// Notes a sent message of so many bytes.
    pub fn send(&mut self, bytes: usize, now: Instant) {
        self.message_bytes = (bytes as u64).max(self.message_bytes * 3 / 4);
        if let Some(last) = self.last.replace(Sent { at: now, is_judged: false }) {
            let since = now.saturating_duration_since(last.at);
            self.interval = (self.interval * 7 + since) / 8;
        }
    }
}

/// The pace of one connection.
pub struct ClientPace {
    link: Arc<ClientLink>,
    pace: LatestPace,
    /// Value of the link's `written_bytes` at which the system has accepted all messages.
    written_bytes: u64,
}

impl ClientPace {
    /// The pace of a client that has been sent nothing yet.
    pub fn new(link: Arc<ClientLink>) -> ClientPace {
        ClientPace { link, pace: LatestPace::default(), written_bytes: 0 }
    }

    /// Waits until there may be another message; false if the client is gone. Cancel-safe.
    pub async fn permitted(&mut self) -> bool {
        loop {
            let Some(mut peer) = self.link.progress() else { return true }; // then the socket's buffer is the only limit
            peer.unsent_bytes += self.written_bytes.saturating_sub(self.link.written_bytes());
            match self.pace.permit(peer, Instant::now()) {
                Permit::Now => return true,
                Permit::Gone => return false,
                Permit::Later(wait) => tokio::time::sleep(wait).await,
            }
        }
    }

    /// Notes that a message of so many bytes is handed to the connection.
    pub fn send(&mut self, bytes: usize) {
        self.written_bytes = self.link.written_bytes() + bytes as u64;
        self.pace.send(bytes, Instant::now());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length of the messages in these tests.
    const BYTES: u64 = 2300;
    const WINDOW: u64 = 65_536;

    /// A reader on a system that acknowledges at once, and reports its window only then.
    struct Reader {
        /// Send times of the messages in the system's buffer, and below of those in the reader's own.
        unread: Vec<Duration>,
        taken: Vec<Duration>,
        /// Time that it needs for a message.
        needs: Duration,
        busy_until: Duration,
        told_window: u64,
        ages: Vec<Duration>,
    }

    impl Reader {
        fn new(needs: Duration) -> Reader {
            let (unread, taken, ages) = (Vec::new(), Vec::new(), Vec::new());
            Reader { unread, taken, needs, busy_until: Duration::ZERO, told_window: WINDOW, ages }
        }

        /// Takes all that is there, up to 8 KiB, as buffered readers do, and then reads one message after the other.
        fn read(&mut self, now: Duration) {
            while self.busy_until <= now {
                if self.taken.is_empty() {
                    let count = self.unread.len().min(8192 / BYTES as usize);
                    self.taken = self.unread.drain(..count).collect();
                }
                if self.taken.is_empty() {
                    return;
                }
                let sent = self.taken.remove(0);
                self.ages.push(now - sent);
                self.busy_until = now + self.needs;
            }
        }
    }

    /// The largest age of the messages read in the second half of `seconds`, of frames at `rate_hz`, and the messages read per
    /// second.
    fn run(pace: &mut LatestPace, reader: &mut Reader, rate_hz: u64, seconds: u64, window: u64) -> (Duration, f64) {
        let begin = Instant::now();
        let (mut frame, half) = (None, Duration::from_secs(seconds) / 2);
        let mut read_by_half = 0;
        for ms in 0..1000 * seconds {
            let now = Duration::from_millis(ms);
            if now == half {
                read_by_half = reader.ages.len();
            }
            let newest = ms * rate_hz / 1000;
            let peer = PeerProgress {
                unsent_bytes: 0,
                is_acknowledged: true,
                acknowledged_bytes: 0,
                window_bytes: reader.told_window,
                window_step_bytes: 128,
            };
            if frame != Some(newest) && pace.permit(peer, begin + now) == Permit::Now {
                frame = Some(newest);
                pace.send(BYTES as usize, begin + now);
                reader.unread.push(now);
                reader.told_window = window - BYTES * reader.unread.len() as u64;
            }
            reader.read(now);
        }
        let late = &reader.ages[read_by_half..];
        (late.iter().copied().max().unwrap_or_default(), late.len() as f64 / half.as_secs_f64())
    }

    #[test]
    fn a_slow_reader_gets_new_estimates_at_its_own_rate() {
        for (needs_ms, rate_hz) in [(50, 60), (100, 200), (30, 60), (400, 60), (50, 500), (1000, 30)] {
            let needs = Duration::from_millis(needs_ms);
            let (age, read_hz) = run(&mut LatestPace::default(), &mut Reader::new(needs), rate_hz, 60, WINDOW);
            let possible_hz = 1e3 / needs_ms as f64;
            assert!(age <= 4 * needs, "{needs_ms} ms, {rate_hz} Hz: {age:?}");
            assert!(read_hz >= 0.6 * possible_hz, "{needs_ms} ms, {rate_hz} Hz: {read_hz} of {possible_hz} Hz");
        }
    }

    #[test]
    fn a_reader_that_becomes_fast_gets_all_estimates_again() {
        let mut pace = LatestPace::default();
        let mut reader = Reader::new(Duration::from_millis(1));
        assert!(run(&mut pace, &mut reader, 250, 4, WINDOW).1 > 249.0);
        reader.needs = Duration::from_millis(100);
        run(&mut LatestPace::default(), &mut reader, 250, 20, WINDOW);
        reader = Reader::new(Duration::from_millis(1));
        pace.last = None;
        assert!(run(&mut pace, &mut reader, 250, 20, WINDOW).1 > 240.0);
    }

    /// A system that is short of memory keeps a smaller window.
    #[test]
    fn a_narrower_window_does_not_slow_a_reader_down() {
        let mut pace = LatestPace::default();
        let mut reader = Reader::new(Duration::from_millis(1));
        run(&mut pace, &mut reader, 60, 4, 4 * WINDOW);
        pace.last = None;
        reader = Reader::new(Duration::from_millis(1));
        assert!(run(&mut pace, &mut reader, 60, 10, WINDOW).1 > 59.0);
    }

    #[test]
    fn unsent_bytes_delay_the_next_message_and_a_silent_client_times_out() {
        let mut pace = LatestPace::default();
        let begin = Instant::now();
        let peer = PeerProgress { is_acknowledged: true, window_bytes: WINDOW, ..PeerProgress::default() };
        assert_eq!(pace.permit(peer, begin), Permit::Now);
        pace.send(1000, begin);
        let unsent = PeerProgress { unsent_bytes: 1, ..peer };
        assert_eq!(pace.permit(unsent, begin), Permit::Later(POLL));
        let flying = PeerProgress { is_acknowledged: false, ..peer };
        assert_eq!(pace.permit(flying, begin), Permit::Now, "a long way is no unread message");
        pace.send(1000, begin);
        assert_eq!(pace.permit(flying, begin + LIMITS.send_time), Permit::Now);
        assert_eq!(pace.permit(flying, begin + LIMITS.send_time + POLL), Permit::Gone);
    }
}
