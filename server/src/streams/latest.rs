//! `LatestPace`: when a reader of the newest estimates is sent another one: not before it has read nearly all of those before.
//!
//! A reader that is slower than the frames gets what it has time for, and each of it new. But what is written to a socket is on its
//! way: the systems of both sides hold hundreds of kilobytes, which are seconds of a slow reader. So a message is written when the
//! one before has left this machine, and the window that the reader's system offers, which unread bytes make smaller, says that
//! little is unread. That window is told with acknowledgements only, and not when the reader reads later: where too much was
//! unread, messages go out at intervals that grow until they are as long as the reader needs, and become shorter again.
//!
//! What comes in: what the system knows of the connection, when messages were sent and how long they were. What goes out: whether
//! there may be another one. The pace itself knows no socket and no clock.

use std::sync::Arc;
use std::time::{Duration, Instant};

use isophote_machine::PeerProgress;

use crate::limits::LIMITS;
use crate::socket::ClientLink;

/// Between questions whether what was sent has arrived; as often as timers of the runtime allow, twice over.
const POLL: Duration = Duration::from_millis(2);
/// So long may messages come one after the other whatever is unread: a reader that is as fast is late by no more.
const BURST: Duration = Duration::from_millis(5);
/// The longest interval: a reader that needs more for a message is one that has stopped.
const GAP_MAX: Duration = Duration::from_secs(10);
/// Where too much is unread the interval grows by this, …
const SLOWER: f64 = 1.5;
/// … becomes shorter by this where nothing is, …
const FASTER: f64 = 0.7;
/// … and by this where one message is, which a reader may have read since: it tries what is possible.
const TRIES: f64 = 0.93;
/// So many times the same number of unread bytes, at longer and longer intervals: the reader's window has become smaller, and is so
/// with nothing unread.
const ALIKE_MAX: u32 = 4;

/// Of one reader.
#[derive(Debug, Default)]
pub struct LatestPace {
    /// The largest window: that of a reader that has read everything.
    widest_bytes: u64,
    /// Of a message, the longest of the last ones.
    message_bytes: u64,
    last: Option<Sent>,
    /// Between messages, on the whole.
    interval: Duration,
    /// Between messages, at least.
    gap: Duration,
    unread_before: u64,
    alike: u32,
}

#[derive(Debug)]
struct Sent {
    at: Instant,
    /// All of it was acknowledged, and what was unread then is counted.
    is_judged: bool,
}

/// Whether there may be another message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permit {
    /// Now.
    Now,
    /// Ask again after so long.
    Later(Duration),
    /// The reader's system has acknowledged nothing for too long.
    Gone,
}

impl LatestPace {
    /// Whether there may be another message, as far as the system knows.
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

    /// From so many unread bytes on there are too many: one message and a half, or what comes in a burst.
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

    /// A message of so many bytes goes out.
    pub fn send(&mut self, bytes: usize, now: Instant) {
        self.message_bytes = (bytes as u64).max(self.message_bytes * 3 / 4);
        if let Some(last) = self.last.replace(Sent { at: now, is_judged: false }) {
            let since = now.saturating_duration_since(last.at);
            self.interval = (self.interval * 7 + since) / 8;
        }
    }
}

/// A pace with the connection that it is for.
pub struct ClientPace {
    link: Arc<ClientLink>,
    pace: LatestPace,
    /// When the system has taken so many bytes, it has all that was sent.
    written_bytes: u64,
}

impl ClientPace {
    /// Of a client that has been sent nothing yet.
    pub fn new(link: Arc<ClientLink>) -> ClientPace {
        ClientPace { link, pace: LatestPace::default(), written_bytes: 0 }
    }

    /// Waits until there may be another message; false where the client has gone. Nothing is lost when the future is dropped.
    pub async fn permitted(&mut self) -> bool {
        loop {
            let Some(mut peer) = self.link.progress() else { return true }; // the socket's buffer is the only bound then
            peer.unsent_bytes += self.written_bytes.saturating_sub(self.link.written_bytes());
            match self.pace.permit(peer, Instant::now()) {
                Permit::Now => return true,
                Permit::Gone => return false,
                Permit::Later(wait) => tokio::time::sleep(wait).await,
            }
        }
    }

    /// A message of so many bytes is handed to the connection.
    pub fn send(&mut self, bytes: usize) {
        self.written_bytes = self.link.written_bytes() + bytes as u64;
        self.pace.send(bytes, Instant::now());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the messages in these tests.
    const BYTES: u64 = 2300;
    const WINDOW: u64 = 65_536;

    /// A reader over a system that acknowledges at once and tells its window then, and only then.
    struct Reader {
        /// When the unread messages were sent, and of those in the reader's own buffer.
        unread: Vec<Duration>,
        taken: Vec<Duration>,
        /// What it needs for a message.
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

        /// It takes all that is there, as buffered readers do, up to 8 KiB, and then one message after the other.
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

    /// Ages of what it reads in the last half of so many seconds, of frames at that rate; and how many it read in a second.
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
    fn a_slow_reader_reads_new_estimates_as_many_as_it_can() {
        for (needs_ms, rate_hz) in [(50, 60), (100, 200), (30, 60), (400, 60), (50, 500), (1000, 30)] {
            let needs = Duration::from_millis(needs_ms);
            let (age, read_hz) = run(&mut LatestPace::default(), &mut Reader::new(needs), rate_hz, 60, WINDOW);
            let possible_hz = 1e3 / needs_ms as f64;
            assert!(age <= 4 * needs, "{needs_ms} ms, {rate_hz} Hz: {age:?}");
            assert!(read_hz >= 0.6 * possible_hz, "{needs_ms} ms, {rate_hz} Hz: {read_hz} of {possible_hz} Hz");
        }
    }

    #[test]
    fn a_fast_reader_gets_all_and_a_slow_one_that_becomes_fast_again() {
        let mut pace = LatestPace::default();
        let mut reader = Reader::new(Duration::from_millis(1));
        assert!(run(&mut pace, &mut reader, 250, 4, WINDOW).1 > 249.0);
        reader.needs = Duration::from_millis(100);
        run(&mut LatestPace::default(), &mut reader, 250, 20, WINDOW);
        reader = Reader::new(Duration::from_millis(1));
        pace.last = None;
        assert!(run(&mut pace, &mut reader, 250, 20, WINDOW).1 > 240.0);
    }

    /// A system that is short of memory offers less for good.
    #[test]
    fn a_window_that_has_become_smaller_does_not_slow_a_reader_down() {
        let mut pace = LatestPace::default();
        let mut reader = Reader::new(Duration::from_millis(1));
        run(&mut pace, &mut reader, 60, 4, 4 * WINDOW);
        pace.last = None;
        reader = Reader::new(Duration::from_millis(1));
        assert!(run(&mut pace, &mut reader, 60, 10, WINDOW).1 > 59.0);
    }

    #[test]
    fn what_has_not_left_the_machine_holds_up_the_next_and_a_silent_client_is_left() {
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
