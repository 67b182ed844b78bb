//! What makes two kernels the same: everything that machine code depends on, bit for bit.
//!
//! Spans and names are left out, numbers are taken by their bits (so that 0 and −0 differ and a NaN equals itself). A key
//! is compared as a whole; there is no hash that two programs could share.

use isophote_symbolic::{Input, Instruction, Op, Program, Sink};

use crate::options::KernelOptions;

/// A program without what only people read, and the options.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Key {
    options: KernelOptions,
    words: Box<[u32]>,
}

impl Key {
    pub fn new(program: &Program, options: &KernelOptions) -> Key {
        let [coordinates, channels] = [program.coordinates(), program.channels()].map(|n| n as u32);
        let mut words = vec![coordinates, channels, program.is_fused().into(), program.inputs().len() as u32];
        words.extend(program.inputs().iter().flat_map(|input| match *input {
            Input::Parameter(p) => [0, p.0],
            Input::Entry(p) => [1, p.0],
            Input::Constant(c) => [2, c.0],
            Input::Saturation(c) => [3, c.0],
            Input::Shift(c) => [4, c.0],
        }));
        let set = program.pixel_set();
        let (lo, hi) = set.bounds.unzip();
        words.extend([lo, hi, set.mask, set.saturated].map(|value| value.map_or(u32::MAX, |value| value.0)));
        match program.sink() {
            Sink::Sums { accumulators, totals, outputs } => {
                for values in [accumulators, totals, outputs] {
                    words.push(values.len() as u32);
                    words.extend(values.iter().map(|value| value.0));
                }
            }
            Sink::Plane(value) => words.extend([u32::MAX, value.0]), // no list is that long
        }
        program.instructions().iter().for_each(|instruction| push(&mut words, instruction));
        Key { options: options.clone(), words: words.into() }
    }

    /// Of memory.
    pub fn bytes(&self) -> usize {
        size_of::<Key>() + size_of_val(&*self.words) + size_of_val(&*self.options.formats)
    }
}

/// An instruction: which operation at which level, then what it works on. How many words follow depends on the operation
/// alone, so that no two lists of instructions read the same.
fn push(words: &mut Vec<u32>, Instruction { op, level, .. }: &Instruction) {
    let (kind, which) = match *op {
        Op::Const(_) => (0, 0),
        Op::Input(_) => (1, 0),
        Op::Outer(_) => (2, 0),
        Op::Offset(_) => (3, 0),
        Op::Channel(_) => (4, 0),
        Op::Neg(_) => (5, 0),
        Op::Abs(_) => (6, 0),
        Op::Sqrt(_) => (7, 0),
        Op::Add(..) => (8, 0),
        Op::Sub(..) => (9, 0),
        Op::Mul(..) => (10, 0),
        Op::Div(..) => (11, 0),
        Op::Fma(..) => (12, 0),
        Op::Compare(comparison, ..) => (13, comparison as u32),
        Op::And(..) => (14, 0),
        Op::Or(..) => (15, 0),
        Op::Not(_) => (16, 0),
        Op::Select(..) => (17, 0),
        Op::Call1(function, _) => (18, function as u32),
        Op::Call2(function, ..) => (19, function as u32),
        Op::RowTotal(_) => (20, 0),
        Op::RowCount => (21, 0),
        Op::PassTotal(_) => (22, 0),
        Op::PassCount => (23, 0),
    };
    words.push((which << 16) | (kind << 8) | *level as u32);
    match *op {
        Op::Const(number) => words.extend([number.to_bits() as u32, (number.to_bits() >> 32) as u32]),
        Op::Input(input) => words.push(input.0),
        Op::Outer(coordinate) => words.push(coordinate.0),
        Op::Channel(channel) => words.push(channel.0),
        Op::RowTotal(accumulator) => words.push(accumulator.0),
        Op::PassTotal(total) => words.push(total.0),
        op => words.extend(op.operands().map(|value| value.0)),
    }
}
