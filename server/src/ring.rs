//! `EstimateRing`: estimates that somebody who wants all of them may still get, within bounded bytes.
//!
//! What comes in: estimates, one after the other, and those who want them. What goes out: to each the next one that it has not had;
//! who is too slow goes on with the oldest that is left. What all have had is forgotten, but for the last one, unless a reader may
//! come back for it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use crate::limits::LIMITS;
use crate::written::WrittenEstimate;

/// Of one session.
#[derive(Default)]
pub struct EstimateRing {
    /// In order, the last of them with the number before `next`.
    kept: VecDeque<Arc<WrittenEstimate>>,
    bytes: usize,
    /// The number of the next estimate.
    next: u64,
    /// Readers had all that they get of those before that number.
    readers: BTreeMap<u64, u64>,
    readers_so_far: u64,
    /// How many of them may come back for what they have had.
    returning: usize,
    /// Those that have left may come back until then.
    until: Option<Instant>,
}

/// Who reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingReader(u64);

impl EstimateRing {
    /// Whether anybody reads, or may come back.
    pub fn is_read(&self) -> bool {
        !self.readers.is_empty() || self.until.is_some()
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// One more, kept only where anybody reads; its number.
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

    /// One more reader, who gets what comes from now on.
    pub fn join(&mut self) -> RingReader {
        let reader = self.readers_so_far;
        self.readers_so_far += 1;
        self.readers.insert(reader, self.next);
        RingReader(reader)
    }

    /// That one may come back for what it has had. Whoever says so gives [`EstimateRing::leave`] a time.
    pub fn keep_had(&mut self) {
        self.returning += 1;
    }

    /// That one goes on with the first wanted one that is kept.
    pub fn go_back(&mut self, RingReader(reader): RingReader, is_wanted: impl Fn(&WrittenEstimate) -> bool) {
        let first = self.first(self.oldest(), is_wanted);
        self.readers.insert(reader, first.unwrap_or(self.next));
    }

    /// That one reads no more; if it may come back, until then.
    pub fn leave(&mut self, RingReader(reader): RingReader, until: Option<Instant>) {
        self.readers.remove(&reader);
        if until.is_some() {
            self.returning -= 1;
            self.until = until;
        }
        self.forget_had();
    }

    /// The next wanted one for a reader, who gets none of those before it.
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

    /// Whether there is a wanted one for a reader.
    pub fn has(&self, RingReader(reader): RingReader, is_wanted: impl Fn(&WrittenEstimate) -> bool) -> bool {
        self.first(self.place(reader), is_wanted).is_some()
    }

    /// The number of the first wanted one from that number on, which is kept.
    fn first(&self, from: u64, is_wanted: impl Fn(&WrittenEstimate) -> bool) -> Option<u64> {
        let skipped = (from - self.oldest()) as usize;
        let found = self.kept.iter().skip(skipped).position(|estimate| is_wanted(estimate));
        found.map(|found| from + found as u64)
    }

    /// The number of the first that is kept.
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

    /// What all have had, but for the last; where nobody reads, all of it.
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
