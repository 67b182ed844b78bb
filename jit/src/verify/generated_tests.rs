//! Generated sequences: those that pass stay inside their memory when emulated, and all facts about registers and frame hold on the
//! way.
#![allow(clippy::unwrap_used)]

use std::mem::offset_of;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::sequences_tests::{INPUTS, Random, sequence};
use super::state::claims::Entry;
use super::*;
use crate::abi::Args;
use crate::x86::emulator_tests::Emulator;

const ARGS: u64 = 0x1_0000;
const NUMBERS: u64 = 0x2_0000;
const STACK: u64 = 0x10_0000;
const STACK_BYTES: usize = 4096;
const REACH: Permitted<'static> =
    Permitted { inputs: INPUTS, outputs: 1, tables: 0, formats: &[], packed: false, lanes: 4 };

/// A processor before the first instruction. The caller's stack is at a random multiple of 16.
fn entered(random: &mut Random) -> (Emulator, Entry) {
    let mut args = vec![0_u8; size_of::<Args>()];
    let last = offset_of!(Args, last);
    for (field, value) in [(offset_of!(Args, inputs), NUMBERS), (offset_of!(Args, furthest), 5), (last, 3)] {
        args[field..field + 8].copy_from_slice(&value.to_le_bytes());
    }
    let mut processor = Emulator::new(0);
    let stack = STACK + STACK_BYTES as u64 - 8 - 16 * random.below(4) as u64;
    processor.regions.insert(ARGS, args.clone());
    processor.regions.insert(NUMBERS, (0..8 * INPUTS).map(|byte| byte as u8).collect());
    processor.regions.insert(STACK, vec![0xCC; STACK_BYTES]);
    for register in &mut processor.general {
        *register = (random.below(1 << 20) as u64) << 20 | 0xABCD;
    }
    processor.general[4] = stack;
    processor.general[7] = ARGS;
    let entry = Entry { general: processor.general, args };
    (processor, entry)
}

/// Runs the sequence and returns the first fact that does not hold.
fn broken(instructions: &[Instruction], known: &BTreeMap<usize, State>, random: &mut Random) -> Option<String> {
    let (mut processor, entry) = entered(random);
    let bounds = BTreeMap::new();
    let (mut state, mut found) = (None, None);
    let run = catch_unwind(AssertUnwindSafe(|| {
        processor.watched(instructions, |processor, at| {
            if found.is_some() || processor.steps > 2_000 {
                return;
            }
            let mut now: State = known.get(&at).cloned().or_else(|| state.take()).unwrap();
            found = now.broken_claim(&entry, processor).map(|claim| format!("at {at}: {claim}"));
            Check { instruction: &instructions[at], reach: REACH, bounds: &bounds }.run(&mut now).unwrap();
            state = Some(now);
        })
    }));
    found.or_else(|| run.err().map(|_| "it leaves its memory, or an address is not aligned".into()))
}

/// The number of sequences of some seeds that pass; none of these violates a fact.
fn held(seeds: std::ops::Range<u64>) -> usize {
    let mut passed = 0;
    for seed in seeds {
        let mut random = Random(seed);
        let instructions = sequence(&mut random);
        let Ok(known) = known(&instructions, &Pool { first: u64::MAX, bytes: Vec::new() }, REACH) else { continue };
        passed += 1;
        for _ in 0..3 {
            let broken = broken(&instructions, &known, &mut random);
            assert!(broken.is_none(), "seed {seed}, {}\n{}", broken.unwrap(), listing(&instructions));
        }
    }
    passed
}

fn listing(instructions: &[Instruction]) -> String {
    let each = instructions.iter().enumerate().map(|(at, i)| format!("{at:3} {:#06x} {i}\n", i.ip()));
    each.collect()
}

#[test]
fn passing_sequences_stay_in_memory_and_satisfy_all_facts() {
    let passed = held(0..20_000);
    assert!(passed > 2_000, "{passed} sequences pass, too few to say much");
}
