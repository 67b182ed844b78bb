//! Random blocks pass the check of their registers, and planted faults do not.
#![allow(clippy::unwrap_used)]

use iced_x86::{Code, Instruction, OpKind, Register};
use smallvec::{SmallVec, smallvec};

use super::acts::{Vectors, recorded};
use super::allocation::count;
use super::assembler::{Assembler, Item};
use super::checker::{Fault, Written, check};
use super::emulation_tests::Random;
use super::slots::Slots;
use crate::options::VectorWidth;
use crate::vector::{
    Act, Anchor, Block, Constants, Element, Id, Integer, Integers, MemoryPlace, Operation, Portion, Resident,
    StackFrame, comparison,
};

const DOUBLE: Element = Element::Double;
const WIDTHS: [VectorWidth; 2] = [VectorWidth::Bits256, VectorWidth::Bits512];

/// Kinds of acts, the last two of which call functions.
const KINDS: usize = 17;

/// A random block of the first so many kinds of acts. Many registers outlive it, so that values are evicted.
fn written(random: &mut Random, width: VectorWidth, kinds: usize) -> Written {
    let (mut constants, mut frame) = (Constants::default(), StackFrame::default());
    let registers = count(width);
    let free = 7 + random.below(4);
    let reserved = (free..registers).fold(0_u32, |bits, register| bits | 1 << register);
    let bytes = width.bytes();
    let mut block = Block::new(&mut constants, width);
    let [first, second, third] = [0, 1, 2].map(|n| (registers - 1 - n) as u8);
    let mut resident = |register| Resident { register, memory: frame.take(bytes, bytes) };
    let [held, elsewhere, sum, sum_in_memory, set] =
        [Some(first), None, Some(second), None, Some(third)].map(&mut resident);
    let [kept, fleeting] = [(); 2].map(|()| frame.take(bytes, bytes));
    let numbers = [1.0, -2.5, 3.0].map(|number| block.number(DOUBLE, number));
    let mut values = vec![block.held(held), block.held(elsewhere), block.kept(kept)];
    values.extend(numbers);
    for _ in 0..10 + random.below(60) {
        // Mostly late values, and sometimes early ones, which are evicted meanwhile.
        let recent = if random.below(4) > 0 { values.len().saturating_sub(6) } else { 0 };
        let mut any = || values[recent + random.below(values.len() - recent)];
        let [a, b, c] = [any(), any(), any()];
        let made = match random.below(kinds) {
            0..5 => {
                let operations = [
                    Operation::Add,
                    Operation::Sub,
                    Operation::Mul,
                    Operation::AndNot,
                    Operation::Min,
                    Operation::Compare(comparison::LESS),
                    Operation::EqualBits,
                ];
                block.compute(*random.pick(&operations), DOUBLE, [a, b])
            }
            5..8 => block.compute(Operation::Fma, DOUBLE, [a, b, c]),
            8 => block.compute(Operation::Select, DOUBLE, [a, b, c]),
            9 => block.compute(*random.pick(&[Operation::Sqrt, Operation::ShiftLeft(3)]), DOUBLE, [a]),
            10 => {
                // The address changes with each instruction on its register.
                let from = [fleeting, MemoryPlace::new(Anchor::At(Integer::A), 8)][random.below(2)];
                block.integers(|i| i.mov(Integer::A, fleeting));
                let from = block.fleeting(from);
                block.compute(Operation::Load, DOUBLE, [from])
            }
            11 => {
                let result = block.new_value();
                let bound = block.pattern(40);
                block.act(Act::Gather { cells: a, bound, offset: 24, result });
                result
            }
            12 => {
                block.act(Act::Truths { operand: b, element: DOUBLE });
                block.integers(|i| i.store_low(fleeting, Integer::A));
                continue;
            }
            13 => {
                let variable = block.variable(*random.pick(&[sum, sum_in_memory]));
                let terms: SmallVec<[Id; 2]> = if random.below(2) == 0 { smallvec![a] } else { smallvec![a, b] };
                let is_masked = width == VectorWidth::Bits512 && random.below(2) == 0;
                block.sum(variable, DOUBLE, terms, is_masked.then_some(c));
                continue;
            }
            14 => {
                block.set(DOUBLE, set, a);
                continue;
            }
            15 => {
                let (operands, result) =
                    (if random.below(2) == 0 { smallvec![a] } else { smallvec![a, b] }, block.new_value());
                block.act(Act::Call { element: DOUBLE, offset: 8 * random.below(9) as i32, operands, result });
                result
            }
            _ => {
                let result = block.new_value();
                block.act(Act::Rare { truth: a, usual: b, x: c, offset: 16, result });
                result
            }
        };
        values.push(made);
        if random.below(6) == 0 {
            let extent = *random.pick(&[Portion::Whole, Portion::Half, Portion::Least]);
            block.store(DOUBLE, extent, made, frame.take(bytes, bytes));
        }
    }
    for value in values.into_iter().rev().take(9) {
        block.store(DOUBLE, Portion::Whole, value, frame.take(bytes, bytes));
    }
    let (acts, givens) = block.into_parts();
    recorded(Vectors { width, acts, givens, reserved }, &mut Slots::of(frame), &mut Assembler::new(0))
}

#[test]
fn random_blocks_have_the_right_registers() {
    for width in WIDTHS {
        for seed in 0..400 {
            let written = written(&mut Random(seed), width, KINDS);
            assert_eq!(check(&written), Ok(()), "seed {seed}, {width:?}");
        }
    }
}

/// How many changes of one instruction are caught, and how many were tried.
fn caught(kinds: usize, plant: impl Fn(&Instruction, &mut Random) -> Option<Option<Instruction>>) -> [usize; 2] {
    let mut counts = [0, 0];
    for width in WIDTHS {
        for seed in 0..40 {
            let mut random = Random(seed);
            let mut written = written(&mut random, width, kinds);
            for act in 0..written.acts.len() {
                for at in 0..written.acts[act].body.len() {
                    let right = written.acts[act].body.clone();
                    let Item::Instruction { instruction, .. } = &mut written.acts[act].body[at] else { continue };
                    match plant(instruction, &mut random) {
                        None => continue,
                        Some(Some(wrong)) => *instruction = wrong,
                        Some(None) => drop(written.acts[act].body.remove(at)),
                    }
                    counts[1] += 1;
                    counts[0] += usize::from(check(&written).is_err());
                    written.acts[act].body = right;
                }
            }
        }
    }
    counts
}

/// Nearly every change counts: two registers may hold the same value.
fn assert_caught(kinds: usize, plant: impl Fn(&Instruction, &mut Random) -> Option<Option<Instruction>>) {
    let [seen, all] = caught(kinds, plant);
    assert!(all > 200 && seen * 20 > all * 19, "{seen} of {all}");
}

/// Another register of the same size.
fn another(register: Register, random: &mut Random) -> Register {
    let first = [Register::XMM0, Register::YMM0, Register::ZMM0].into_iter().rfind(|first| *first <= register).unwrap();
    first + ((register as u32 - first as u32) + 1 + random.below(6) as u32) % 7
}

#[test]
fn operand_in_a_wrong_register_is_caught() {
    assert_caught(KINDS, |i, random| {
        let is_vector = i.op_count() > 1 && i.op1_kind() == OpKind::Register && i.op1_register().is_vector_register();
        let mut wrong = *i;
        is_vector.then(|| {
            wrong.set_op1_register(another(i.op1_register(), random));
            (wrong != *i).then_some(Some(wrong))
        })?
    });
}

#[test]
fn result_in_a_wrong_register_is_caught() {
    assert_caught(KINDS, |i, random| {
        let is_vector = i.op_count() > 1 && i.op0_kind() == OpKind::Register && i.op0_register().is_vector_register();
        let mut wrong = *i;
        is_vector.then(|| {
            wrong.set_op0_register(another(i.op0_register(), random));
            (wrong != *i).then_some(Some(wrong))
        })?
    });
}

#[test]
fn value_in_a_wrong_place_in_memory_is_caught() {
    // Calls save registers more than once in the same place.
    assert_caught(KINDS - 2, |i, _| {
        let is_frame = i.op_count() == 2 && i.memory_base() == Register::RSP && i.code() != Code::Lea_r64_m;
        let mut wrong = *i;
        wrong.set_memory_displacement64(i.memory_displacement64() + 64);
        is_frame.then_some(Some(wrong))
    });
}

#[test]
fn missing_instruction_is_caught() {
    assert_caught(KINDS - 2, |_, _| Some(None));
}

#[test]
fn missing_mask_is_caught() {
    let [seen, all] = caught(KINDS, |i, _| {
        let mut wrong = *i;
        wrong.set_op_mask(Register::None);
        (i.op_mask() != Register::None).then_some(Some(wrong))
    });
    assert!(all > 20 && seen == all, "{seen} of {all}");
}

#[test]
fn other_operations_on_integers_are_caught() {
    let mut written = written(&mut Random(1), VectorWidth::Bits256, KINDS);
    let mut integers = Integers::default();
    integers.mov(Integer::A, 1);
    let at = written.acts.iter().position(|written| matches!(written.act, Act::Integers(_))).unwrap();
    written.acts[at].act = Act::Integers(integers);
    assert_eq!(check(&written), Err((at, Fault::Integers)));
}
