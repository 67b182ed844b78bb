//! Cache key of a kernel: everything that its machine code depends on, bit for bit.
//!
//! Spans and names are left out; numbers are compared by their bits (so that 0 and −0 differ and a NaN equals itself).
//! Keys are compared in full, not by hash, so that no two programs collide.

use isophote_symbolic::{Input, Level, Op, Program, Sink, Tables};

use crate::options::KernelOptions;

/// A program without names and spans, and the options.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct KernelKey {
    options: KernelOptions,
    /// Empty unless the program uses lookups.
    tables: Tables,
    words: Box<[u32]>,
    instructions: Box<[(Op, Level)]>,
}

impl KernelKey {
    pub fn new(program: &Program, options: &KernelOptions) -> KernelKey {
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
            Sink::Plane(value) => words.extend([u32::MAX, value.0]), // lists are shorter than `u32::MAX`
        }
        let instructions = program.instructions().iter().map(|x| (x.op, x.level)).collect();
        let tables = if program.looks_up() { program.tables().clone() } else { Tables::default() };
        KernelKey { options: options.clone(), tables, words: words.into(), instructions }
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        size_of::<KernelKey>()
            + size_of_val(&*self.words)
            + size_of_val(&*self.instructions)
            + size_of_val(&*self.options.formats)
    }
}
