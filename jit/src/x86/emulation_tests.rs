//! Emulated wide code equals the interpreter bit for bit: at 256 bits as on the machine, and at 512 where the machine lacks
//! such vectors. Planted wrong registers and missing masks are detected.
#![allow(clippy::unwrap_used)]

use std::mem::offset_of;

use iced_x86::{Instruction, OpKind, Register};
use isophote_symbolic::interpreter::Outcome;
use isophote_symbolic::{Precision, Program, Sink};

use super::emulator_tests::{Emulator, Ended};
use crate::abi::{Args, Functions, PlaneArgs};
use crate::options::{KernelOptions, VectorWidth};
use crate::verify::{Decoded, Pool, decode};

#[path = "../../tests/common/mod.rs"]
mod common;

pub(crate) use common::Random;
pub(crate) use common::differential::Stage;
use common::differential::{Case, agree};
use common::generate::{Variety, program};

const ARGS: u64 = 0x1_0000;
const PLANES: u64 = 0x2_0000;
const INPUTS: u64 = 0x3_0000;
const OUTPUTS: u64 = 0x4_0000;
const FUNCTIONS: u64 = 0x5_0000;
const TABLES: u64 = 0x6_0000;
const TARGET: u64 = 0x7_0000;
const STACK: u64 = 0x100_0000;
const PIXELS: u64 = 0x1000_0000;

/// Code of a program for the emulator.
struct Emulated<'p> {
    program: &'p Program,
    options: KernelOptions,
    instructions: Vec<Instruction>,
    pool: Pool,
}

impl<'p> Emulated<'p> {
    fn new(program: &'p Program, options: KernelOptions) -> Emulated<'p> {
        let (assembled, _) = super::code(program, &options).unwrap();
        let Decoded { instructions, pool } = decode(&assembled.bytes, assembled.code_end).unwrap();
        Emulated { program, options, instructions, pool }
    }

    /// `None`: it did not terminate.
    fn run(&self, case: &Case, stage: &Stage) -> Option<(Outcome, Vec<f32>)> {
        let (bindings, window, before) = case.parts();
        let lanes = self.options.lanes().count();
        let mut e = Emulator::new(FUNCTIONS);
        let mut args = vec![0_u8; size_of::<Args>()];
        let mut set = |field: usize, value: i64| args[field..field + 8].copy_from_slice(&value.to_le_bytes());
        let pitch = window.width.max(lanes);
        let [depth, length] = window.slices.count;
        let fields = [
            (offset_of!(Args, inputs), INPUTS as i64),
            (offset_of!(Args, outputs), OUTPUTS as i64),
            (offset_of!(Args, functions), FUNCTIONS as i64),
            (offset_of!(Args, planes), PLANES as i64),
            (offset_of!(Args, tables), TABLES as i64),
            (offset_of!(Args, target), TARGET as i64),
            (offset_of!(Args, x), window.x as i64),
            (offset_of!(Args, y), window.y as i64),
            (offset_of!(Args, width), window.width as i64),
            (offset_of!(Args, height), window.height as i64),
            (offset_of!(Args, z), window.slices.first[0] as i64),
            (offset_of!(Args, w), window.slices.first[1] as i64),
            (offset_of!(Args, depth), depth as i64),
            (offset_of!(Args, length), length as i64),
            (offset_of!(Args, furthest), window.width.saturating_sub(lanes) as i64),
            (offset_of!(Args, last), window.height as i64 - 1),
            (offset_of!(Args, last) + 8, depth as i64 - 1),
            (offset_of!(Args, last) + 16, length as i64 - 1),
            (offset_of!(Args, last_row), (window.pixels() / window.width) as i64 - 1),
            (offset_of!(Args, target_stride), 4 * pitch as i64),
        ];
        fields.iter().for_each(|(field, value)| set(*field, *value));
        let inputs: Vec<u8> = self.program.gather(&bindings).flat_map(f64::to_le_bytes).collect();
        e.regions.insert(ARGS, args);
        e.regions.insert(INPUTS, inputs);
        e.regions.insert(OUTPUTS, vec![0; 8 * self.program.sink().outputs().len()]);
        let numbers = self.program.tables().numbers();
        e.regions.insert(TABLES, numbers.iter().copied().flat_map(f64::to_le_bytes).collect());
        e.regions.insert(FUNCTIONS, vec![0; size_of::<Functions>()]);
        e.regions.insert(STACK, vec![0xAA; 1 << 20]);
        e.regions.insert(self.pool.first, self.pool.bytes.clone());
        let mut planes = Vec::new();
        for (channel, view) in stage.views().iter().enumerate() {
            let region = view.region(window).unwrap();
            let padded = (window.width < lanes).then(|| region.padded(lanes));
            let (bytes, strides) = match &padded {
                Some(padded) => (padded.bytes(), padded.strides()),
                None => (region.first(), view.strides()),
            };
            let first = PIXELS + (channel as u64) * 0x100_0000;
            e.regions.insert(first, bytes.to_vec());
            let mut plane = vec![0_u8; size_of::<PlaneArgs>()];
            let [pixel, row, slice, volume] = strides;
            for (field, value) in [
                (offset_of!(PlaneArgs, first), first as i64),
                (offset_of!(PlaneArgs, pixel_stride), pixel as i64),
                (offset_of!(PlaneArgs, row_stride), row as i64),
                (offset_of!(PlaneArgs, slice_stride), slice as i64),
                (offset_of!(PlaneArgs, volume_stride), volume as i64),
            ] {
                plane[field..field + 8].copy_from_slice(&value.to_le_bytes());
            }
            planes.extend(plane);
        }
        e.regions.insert(PLANES, planes);
        let row = |numbers: &[f32]| -> Vec<u8> {
            let rest = std::iter::repeat_n(0.0_f32, pitch - numbers.len());
            numbers.iter().copied().chain(rest).flat_map(f32::to_le_bytes).collect()
        };
        e.regions.insert(TARGET, before.chunks(window.width).flat_map(row).collect());
        e.general[7] = ARGS;
        e.general[4] = STACK + (1 << 20) - 64;
        if e.run(&self.instructions) == Ended::Never {
            return None;
        }
        let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap());
        let field = |field: usize| number(&e.regions[&ARGS][field..field + 8]);
        let plane = e.regions[&TARGET].chunks(4 * pitch).flat_map(|row| row[..4 * window.width].chunks(4));
        let plane: Vec<f32> = plane.map(|pixel| f32::from_le_bytes(pixel.try_into().unwrap())).collect();
        if matches!(self.program.sink(), Sink::Plane(_)) {
            return Some((Outcome::default(), plane));
        }
        let outputs = e.regions[&OUTPUTS].chunks(8).map(|bytes| f64::from_bits(number(bytes))).collect();
        let counts = [offset_of!(Args, pixels), offset_of!(Args, saturated)].map(field);
        Some((Outcome { outputs, pixels: counts[0], saturated: counts[1] }, before.to_vec()))
    }
}

/// A generated program with its stage.
pub(crate) fn subject(seed: u64, width: VectorWidth) -> (Program, Precision, Stage, Random) {
    let mut random = Random(seed);
    let longest = *random.pick(&[4, 10, 30, 60, 150]);
    let lengths = [longest, longest / 2, longest].map(|most| 1 + random.below(most));
    let (fma, calls, tables) = (random.below(2) == 0, random.below(3) == 0, random.below(2) == 0);
    let variety = Variety { fma, calls, tables, lengths, sums: 9 };
    let renders = random.below(8) == 0;
    let program = program(&mut random, variety, renders);
    let precision = *random.pick(&[Precision::F32, Precision::F64]);
    let stage = Stage::new(&mut random, &program, width.lanes(precision));
    (program, precision, stage, random)
}

fn emulation_agrees(width: VectorWidth, seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let (program, precision, mut stage, mut random) = subject(seed, width);
        let emulated = Emulated::new(&program, stage.options(precision, width));
        for odds in [0, 3, 10, 40] {
            stage.draw(&mut random, odds);
            for _ in 0..3 {
                let case = Case::new(&mut random, &stage, odds);
                let expected = case.interpreted(&program, &emulated.options, &stage);
                let seen = emulated.run(&case, &stage).unwrap();
                assert!(
                    agree(&seen, &expected),
                    "seed {seed}, {width:?}\n{seen:?}\n{expected:?}\n{case:?}\n{program:?}"
                );
            }
        }
    }
}

#[test]
fn emulation_agrees_at_256_bits() {
    emulation_agrees(VectorWidth::Bits256, 0..150);
}

#[test]
fn emulation_agrees_at_512_bits() {
    emulation_agrees(VectorWidth::Bits512, 0..300);
}

/// Changes of one instruction that affect the result, and changes tried.
fn noticed(width: VectorWidth, plant: impl Fn(&mut Instruction) -> bool) -> [usize; 2] {
    let mut counts = [0, 0];
    for seed in 0..40 {
        let (program, precision, mut stage, mut random) = subject(seed, width);
        stage.draw(&mut random, 0);
        let mut emulated = Emulated::new(&program, stage.options(precision, width));
        let cases: Vec<Case> = (0..24).map(|_| Case::new(&mut random, &stage, 0)).collect();
        let places: Vec<usize> =
            (0..emulated.instructions.len()).filter(|at| plant(&mut emulated.instructions[*at].clone())).collect();
        for at in places.iter().step_by(1 + places.len() / 4) {
            let right = emulated.instructions[*at];
            plant(&mut emulated.instructions[*at]);
            counts[1] += 1;
            counts[0] += usize::from(cases.iter().any(|case| {
                let expected = case.interpreted(&program, &emulated.options, &stage);
                emulated.run(case, &stage).is_none_or(|seen| !agree(&seen, &expected))
            }));
            emulated.instructions[*at] = right;
        }
    }
    counts
}

#[test]
fn planted_wrong_registers_are_detected() {
    for width in [VectorWidth::Bits256, VectorWidth::Bits512] {
        let [seen, all] = noticed(width, |i| {
            let is_sum = i.op_count() == 3 && i.op1_kind() == OpKind::Register && i.op0_kind() == OpKind::Register;
            let first = if width == VectorWidth::Bits256 { Register::YMM0 } else { Register::ZMM0 };
            let is_meant = is_sum && (first..=first + 12).contains(&i.op1_register());
            if is_meant {
                i.set_op1_register(first + 15);
            }
            is_meant
        });
        // Changes that matter only for special numbers, the last group, or rows that a small window lacks, may pass.
        assert!(all > 100 && seen * 4 > all, "{width:?}: {seen} of {all}");
    }
}

#[test]
fn planted_missing_masks_are_detected() {
    let [seen, all] = noticed(VectorWidth::Bits512, |i| {
        let is_meant = i.op_mask() != Register::None && !i.is_vsib();
        if is_meant {
            i.set_op_mask(Register::None);
        }
        is_meant
    });
    assert!(all > 50 && seen * 2 > all, "{seen} of {all}");
}
