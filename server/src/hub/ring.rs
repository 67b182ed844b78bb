//! `EstimateRing`: a ring of estimates, bounded in bytes, with a position for each reader.
//!
//! A reader that falls behind continues with the oldest estimate kept. Estimates that all readers have had are dropped, except
//! the last one, unless a reader may return for them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use crate::hub::written::WrittenEstimate;
use crate::limits::LIMITS;

/// The ring of one session.
#[derive(Default)]
pub struct EstimateRing {
    /// In order; the last one has the number `next - 1`.
    kept: VecDeque<Arc<WrittenEstimate>>,
    bytes: usize,
    /// The number of the next estimate.
    next: u64,
    /// By reader: the first number that it has not had.
    readers: BTreeMap<u64, u64>,
    readers_so_far: u64,
    /// Readers that may return for estimates they have had.
    returning: usize,
    /// Readers that left may return until then.
    until: Option<Instant>,
}

/// Identifies a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingReader(u64);

impl EstimateRing {
    /// Whether there is a reader, or one may return.
    pub fn is_read(&self) -> bool {
        !self.readers.is_empty() || self.until.is_some()
    }

    /// Bytes of the estimates kept.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Appends an estimate, which is kept only if somebody reads; returns its number.
    pub fn push(&mut self, now: Instant, estimate: impl FnOnce() -> Arc<WrittenEstimate>) -> u64 {
        if self.until.is_some_and(|until| now >= until) {
            self.until = None;
            self.forget_had();
        }
        if self.is_read() {
            let estimate = estimate();
            self.bytes += estimate.bytes();
            self.kept.push_back(estimate);
            while self.bytes > LIMITS.ring_bytes && self.kept.len() > 1 {
                self.forget_oldest();
            }
        }
        self.next += 1;
        self.next - 1
    }

    /// Adds a reader, which starts with the next estimate.
    pub fn join(&mut self) -> RingReader {
        let reader = self.readers_so_far;
        self.readers_so_far += 1;
        self.readers.insert(reader, self.next);
        RingReader(reader)
    }

    /// Notes that a reader may return for estimates it has had. [`EstimateRing::leave`] then needs a time.
    pub fn keep_had(&mut self) {
        self.returning += 1;
    }

    /// Moves a reader to the first wanted estimate that is kept.
    pub fn go_back(&mut self, RingReader(reader): RingReader, is_wanted: impl Fn(&WrittenEstimate) -> bool) {
        let first = self.first(self.oldest(), is_wanted);
        self.readers.insert(reader, first.unwrap_or(self.next));
    }

    /// Removes a reader; one that may return may do so until then.
    pub fn leave(&mut self, RingReader(reader): RingReader, until: Option<Instant>) {
        self.readers.remove(&reader);
        if until.is_some() {
            self.returning -= 1;
            self.until = until;
        }
        self.forget_had();
    }

    /// The next wanted estimate for a reader; those before it are skipped.
    pub fn take(
        &mut self,
        RingReader(reader): RingReader,
        is_wanted: impl Fn(&WrittenEstimate) -> bool,
    ) -> Option<Arc<WrittenEstimate>> {
        let number = self.first(self.place(reader), is_wanted);
        let estimate = number.and_then(|number| self.kept.get((number - self.oldest()) as usize)).cloned();
        self.readers.insert(reader, number.map_or(self.next, |number| number + 1));
        self.forget_had();
        estimate
    }

    /// Whether a wanted estimate waits for a reader.
    pub fn has(&self, RingReader(reader): RingReader, is_wanted: impl Fn(&WrittenEstimate) -> bool) -> bool {
        self.first(self.place(reader), is_wanted).is_some()
    }

    /// The number of the first wanted estimate from that number on, which must be kept.
    fn first(&self, from: u64, is_wanted: impl Fn(&WrittenEstimate) -> bool) -> Option<u64> {
        let skipped = (from - self.oldest()) as usize;
        let found = self.kept.iter().skip(skipped).position(|estimate| is_wanted(estimate));
        found.map(|found| from + found as u64)
    }

    /// The number of the oldest estimate kept.
    fn oldest(&self) -> u64 {
        self.next - self.kept.len() as u64
    }

    fn place(&self, reader: u64) -> u64 {
        self.readers.get(&reader).map_or(self.next, |next| *next).max(self.oldest())
    }

    fn forget_oldest(&mut self) {
        let oldest = self.kept.pop_front();
        self.bytes -= oldest.map_or(0, |oldest| oldest.bytes());
    }

    /// Drops the estimates that all readers have had, except the last; all of them if nobody reads.
    fn forget_had(&mut self) {
        if self.returning > 0 || self.until.is_some() {
            return;
        }
        if !self.is_read() {
            (self.kept, self.bytes) = (VecDeque::new(), 0);
        }
        let first = self.readers.values().min().map_or(self.next, |first| *first);
        while self.oldest() < first && self.kept.len() > 1 {
            self.forget_oldest();
        }
    }
}
