//! `EstimateRing`: estimates that somebody who wants all of them may still get, within bounded bytes.
//!
//! What comes in: estimates, one after the other, and those who want them. What goes out: to each the next one that it has not had;
//! who is too slow goes on with the oldest that is left. What all have had is forgotten, but for the last one.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

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
}

/// Who reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingReader(u64);

impl EstimateRing {
    /// Whether anybody reads.
    pub fn is_read(&self) -> bool {
        !self.readers.is_empty()
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// One more, kept only where anybody reads; its number.
    pub fn push(&mut self, estimate: impl FnOnce() -> Arc<WrittenEstimate>) -> u64 {
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

    /// That one reads no more.
    pub fn leave(&mut self, RingReader(reader): RingReader) {
        self.readers.remove(&reader);
        self.forget_had();
        if !self.is_read() {
            (self.kept, self.bytes) = (VecDeque::new(), 0);
        }
    }

    /// The next one for a reader.
    pub fn take(&mut self, RingReader(reader): RingReader) -> Option<Arc<WrittenEstimate>> {
        let number = self.place(reader);
        let estimate = self.kept.get((number - self.oldest()) as usize)?.clone();
        self.readers.insert(reader, number + 1);
        self.forget_had();
        Some(estimate)
    }

    /// Whether there is one for a reader.
    pub fn has(&self, RingReader(reader): RingReader) -> bool {
        self.place(reader) < self.next
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

    /// What all have had, but for the last.
    fn forget_had(&mut self) {
        let first = self.readers.values().min().map_or(self.next, |first| *first);
        while self.oldest() < first && self.kept.len() > 1 {
            self.forget_oldest();
        }
    }
}
