//! Compares the facts of a state with the registers and the memory of an emulated processor.

use std::mem::offset_of;

use super::*;
use crate::abi::Args;
use crate::verify::known::Limit;
use crate::x86::emulator_tests::Emulator;

/// Registers and arguments on entry.
#[derive(Clone, Debug)]
pub(in crate::verify) struct Entry {
    pub general: [u64; 16],
    pub args: Vec<u8>,
}

impl Entry {
    fn argument(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.args[at..at + 8].try_into().unwrap_or_default())
    }

    fn limit(&self, limit: Limit) -> u64 {
        self.argument(match limit {
            Limit::Furthest => offset_of!(Args, furthest),
            Limit::Last(n) => offset_of!(Args, last) + 8 * n,
            Limit::LastRow => offset_of!(Args, last_row),
        })
    }

    /// Whether a value satisfies a fact; `None` for facts that no sequence of the tests yields.
    fn is_of(&self, fact: Fact, value: u64, rsp: u64) -> Option<bool> {
        let stack = self.general[RSP];
        let one_of = |few: &Few, from: u64| few.each().any(|number| value == from.wrapping_add(number as u64));
        Some(match fact {
            Fact::Number => true,
            Fact::OneOf(few) => one_of(&few, 0),
            Fact::Frame(few) => one_of(&few, rsp),
            Fact::Below(count) => value < count as u64,
            Fact::Limit(limit) => value == self.limit(limit),
            Fact::Within(limit) => value <= self.limit(limit),
            Fact::Multiple(limit, by) => (0..=self.limit(limit)).any(|n| value == n.wrapping_mul(by as u64)),
            Fact::Args => value == self.general[7],
            Fact::Inputs => value == self.argument(offset_of!(Args, inputs)),
            Fact::Outputs => value == self.argument(offset_of!(Args, outputs)),
            Fact::Stack(depth) => value == stack - 8 * depth as u64,
            Fact::Aligned(bytes) => value.is_multiple_of(bytes as u64),
            Fact::Caller(register) => value == self.general[register],
            _ => return None,
        })
    }
}

impl State {
    /// The first fact that a processor violates.
    pub(in crate::verify) fn broken_claim(&self, entry: &Entry, processor: &mut Emulator) -> Option<String> {
        let general = processor.general;
        let rsp = general[RSP];
        let mut words: Vec<(String, Word, u64)> =
            self.registers.iter().enumerate().map(|(i, known)| (format!("register {i}"), *known, general[i])).collect();
        if self.rsp().is_in_frame() {
            for (at, known) in &self.kept {
                let bytes = processor.read(rsp.wrapping_add(*at as u64), 8);
                let value = u64::from_le_bytes(bytes.try_into().unwrap_or_default());
                words.push((format!("frame at {at}"), *known, value));
            }
            let end = entry.general[RSP] - 8 * self.saved.len() as u64;
            if rsp + self.frame as u64 > end {
                return Some(format!("a frame of {} at {rsp:#x} reaches past {end:#x}", self.frame));
            }
            if let Some(bytes) = [16, 32, 64]
                .into_iter()
                .find(|bytes| self.is_frame_aligned(*bytes) && !rsp.is_multiple_of(*bytes as u64))
            {
                return Some(format!("a frame at {rsp:#x} is said to be at a multiple of {bytes}"));
            }
        }
        for (place, known, value) in &words {
            if !entry.is_of(known.fact, *value, rsp).unwrap_or(true) {
                return Some(format!("{place} is {value:#x}, said to be {:?}", known.fact));
            }
            let other = words.iter().find(|(_, other, number)| other.name == known.name && number != value);
            if let Some((other, _, number)) = other.filter(|_| known.name != 0) {
                return Some(format!("{place} and {other} share a name, and are {value:#x} and {number:#x}"));
            }
        }
        None
    }
}
