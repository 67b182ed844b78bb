//! The levels outside of the pixel loop: a vector of f64, of which a pass fills all lanes alike and rows take a lane each.

use std::mem::offset_of;

use iced_x86::Register;
use isophote_symbolic::{Level, Opcode, Precision, Program, Sink, Value};
use smallvec::SmallVec;

use super::acts::allocate;
use super::assembler::{Anchor, Assembler, MemoryPlace};
use super::block::{Block, Id};
use super::calls::arg;
use super::operation::{Element, Operation, Portion, comparison};
use super::places::{Homes, element};
use crate::abi::Args;
use crate::options::{KernelOptions, VectorWidth};

const DOUBLE: Element = Element::Double;

/// Writes every instruction of a level other than the pixel's, and what belongs to its end.
pub(super) fn write(
    level: Level,
    program: &Program,
    options: &KernelOptions,
    places: &mut Homes,
    assembler: &mut Assembler,
) {
    let block = Block::new(assembler, options.width);
    let known = vec![None; program.instructions().len()];
    let mut writer = Writer { program, options, places, block, known };
    if level == Level::Pass {
        writer.edges();
    }
    for (i, instruction) in program.instructions().iter().enumerate().filter(|(_, x)| x.level == level) {
        writer.block.speak_for(Some(Value(i as u32)));
        writer.instruction(Value(i as u32), instruction.op.code);
    }
    writer.block.speak_for(None);
    match level {
        Level::Row => {
            let first = writer.range();
            writer.columns(first);
        }
        Level::RowEnd => writer.totals(),
        Level::PassEnd => writer.outputs(),
        Level::Pass | Level::Pixel => {}
    }
    let Writer { block, .. } = writer;
    allocate(block, &mut places.frame, 0);
}

struct Writer<'w, 'a> {
    program: &'w Program,
    options: &'w KernelOptions,
    places: &'w Homes,
    block: Block<'a>,
    known: Vec<Option<Id>>,
}

impl Writer<'_, '_> {
    fn operand(&mut self, value: Value) -> Id {
        if let Some(known) = self.known[value.index()] {
            return known;
        }
        let id = match (self.program.instruction(value).op.constant(), self.places.doubles[value.index()]) {
            (Some(number), _) => self.block.number(DOUBLE, number),
            (None, Some(memory)) => self.block.kept(memory),
            (None, None) => unreachable!("every value that crosses levels has a place"),
        };
        self.known[value.index()] = Some(id);
        id
    }

    /// Integers of 32 bits in memory, one a lane or one for all.
    fn integers(&mut self, memory: MemoryPlace) -> Id {
        let integers = self.block.fleeting(memory);
        self.block.compute(Operation::FromIntegers, DOUBLE, [integers])
    }

    fn instruction(&mut self, value: Value, code: Opcode) {
        let op = self.program.instruction(value).op;
        let result = match code {
            Opcode::Input(input) => {
                self.block.scalar(|i| i.mov(Register::RSI, arg(offset_of!(Args, inputs))));
                let number = MemoryPlace::new(Anchor::At(Register::RSI), (size_of::<f64>() * input.index()) as i32);
                let number = self.block.fleeting(number.spread());
                self.block.compute(Operation::Spread, DOUBLE, [number])
            }
            Opcode::Outer(coordinate) => self.integers(self.places.coordinates[coordinate.index() - 1]),
            Opcode::RowTotal(accumulator) => self.block.kept(self.places.sums[accumulator.index()]),
            Opcode::RowCount => self.integers(self.places.counts),
            Opcode::PassTotal(total) => self.block.kept(self.places.totals[total.index()].spread()),
            Opcode::PassCount => self.block.kept(self.places.counters.pixels.spread()),
            _ => {
                let operands: SmallVec<[Id; 3]> = op.operands().map(|v| self.operand(v)).collect();
                let result = self.block.arithmetic(DOUBLE, op, &operands);
                match result.or_else(|| self.block.outer_function(code, &operands)) {
                    Some(result) => result,
                    None => unreachable!("the check refuses pixel instructions at this level"),
                }
            }
        };
        self.known[value.index()] = Some(result);
        if let Some(memory) = self.places.doubles[value.index()] {
            self.block.store(DOUBLE, Portion::Whole, result, memory);
        }
        self.show(value, result);
    }

    /// Leaves a value as the pixel loop reads it: rounded to the lane type, once.
    fn show(&mut self, value: Value, result: Id) {
        let Some(shown) = self.places.shown[value.index()] else { return };
        let is_truth = self.program.is_truth(value);
        match shown.array {
            Some((array, _)) if is_truth => self.block.store(DOUBLE, Portion::Whole, result, array),
            Some((array, _)) => self.rounded(result, array),
            None => self.spread(result, is_truth, shown.held.memory),
        }
    }

    /// Leaves the lanes in an array of the pixel loop's elements.
    fn rounded(&mut self, lanes: Id, array: MemoryPlace) {
        match self.options.precision {
            Precision::F32 => {
                let rounded = self.block.compute(Operation::Narrow, DOUBLE, [lanes]);
                self.block.store(Element::Single, Portion::Half, rounded, array);
            }
            Precision::F64 => self.block.store(DOUBLE, Portion::Whole, lanes, array),
        }
    }

    /// Leaves the first lane for all lanes of the pixel loop.
    fn spread(&mut self, lanes: Id, is_truth: bool, memory: MemoryPlace) {
        let element = element(self.options.precision);
        let rounds = element == Element::Single && !is_truth;
        let rounded = if rounds { self.block.compute(Operation::Narrow, DOUBLE, [lanes]) } else { lanes };
        if self.options.width == VectorWidth::Bits512 {
            let memory = MemoryPlace { is_spread: false, ..memory };
            return self.block.store(element, Portion::Least, rounded, memory);
        }
        let all = if rounds { self.block.compute(Operation::SpreadFirst, element, [rounded]) } else { rounded };
        self.block.store(element, Portion::Whole, all, memory);
    }

    /// The window's first and last column.
    fn edges(&mut self) {
        use Register::{EAX, RAX};
        let place = self.places.counters.before;
        let [first, last] = self.places.edges;
        self.block.scalar(|i| {
            i.mov(RAX, arg(offset_of!(Args, x)));
            i.store_low(place, EAX);
        });
        let x = self.integers(place.spread());
        self.block.store(DOUBLE, Portion::Whole, x, first);
        self.block.scalar(|i| {
            i.plus(RAX, arg(offset_of!(Args, width)));
            i.minus(RAX, 1);
            i.store_low(place, EAX);
        });
        let x = self.integers(place.spread());
        self.block.store(DOUBLE, Portion::Whole, x, last);
    }

    /// Leaves the first and the last pixel of each row in the frame, the last before the first where there is none, and hands
    /// back the first as f64. The order of comparisons is the interpreter's, so that NaN and infinities end the same way.
    fn range(&mut self) -> Id {
        use Operation::{Add, AddBits, And, Compare, Or, Select, Sub, SubBits};
        let Homes { starts, ends, edges, .. } = *self.places;
        let [first, last] = edges.map(|edge| self.block.kept(edge));
        let b = &mut self.block;
        let Some((lo, hi)) = self.program.pixel_set().bounds else {
            let (zero, width) = (b.pattern(0), b.compute(Sub, DOUBLE, [last, first]));
            let [_, end] = b.nearest(width);
            b.store(DOUBLE, Portion::Whole, zero, starts);
            b.store(DOUBLE, Portion::Whole, end, ends);
            return zero;
        };
        let [lo, hi] = [lo, hi].map(|value| self.operand(value));
        let b = &mut self.block;
        let at_most = Compare(comparison::AT_MOST);
        let less = Compare(comparison::LESS);
        let ordered = b.compute(at_most, DOUBLE, [lo, hi]);
        let inside = b.compute(less, DOUBLE, [first, lo]);
        let lo = b.compute(Select, DOUBLE, [inside, lo, first]);
        let inside = b.compute(less, DOUBLE, [hi, last]);
        let hi = b.compute(Select, DOUBLE, [inside, hi, last]);
        let still = b.compute(at_most, DOUBLE, [lo, hi]);
        let any = b.compute(And, DOUBLE, [ordered, still]);

        // Where there are pixels, both are inside of the window: distances below 2³¹. A truth value is −1 as an integer.
        let distance = b.compute(Sub, DOUBLE, [lo, first]);
        let [near, integer] = b.nearest(distance);
        let short = b.compute(less, DOUBLE, [near, distance]);
        let start = b.compute(SubBits, DOUBLE, [integer, short]);
        let start = b.compute(And, DOUBLE, [start, any]);
        b.store(DOUBLE, Portion::Whole, start, starts);
        let one = b.number(DOUBLE, 1.0);
        let step = b.compute(And, DOUBLE, [short, one]);
        let first_pixel = b.compute(Add, DOUBLE, [near, step]);
        let first_pixel = b.compute(And, DOUBLE, [first_pixel, any]);

        let distance = b.compute(Sub, DOUBLE, [hi, first]);
        let [near, integer] = b.nearest(distance);
        let over = b.compute(less, DOUBLE, [distance, near]);
        let end = b.compute(AddBits, DOUBLE, [integer, over]);
        let none = b.not(DOUBLE, any);
        let end = b.compute(Or, DOUBLE, [end, none]);
        b.store(DOUBLE, Portion::Whole, end, ends);
        first_pixel
    }

    /// Leaves where the offsets of the rows begin; `first` is their first pixel, from the window's first column.
    fn columns(&mut self, first: Id) {
        use Operation::{Add, Sub};
        let edge = self.block.kept(self.places.edges[0]);
        let x = self.block.compute(Add, DOUBLE, [first, edge]);
        for column in &self.places.columns {
            self.block.speak_for(Some(column.value));
            let c = self.operand(column.term);
            let magic = self.block.number(DOUBLE, isophote_elementary::MAGIC);
            let n = self.block.compute(Sub, DOUBLE, [magic, c]);
            let n = self.block.compute(Sub, DOUBLE, [n, magic]);
            let distance = self.block.compute(Sub, DOUBLE, [x, n]);
            self.rounded(distance, column.first);
            let fraction = self.block.compute(Add, DOUBLE, [c, n]);
            if let Some((array, _)) = column.fraction.array {
                self.rounded(fraction, array);
            }
        }
    }

    /// Adds rows to the pass' totals, one after the other. A row without pixels adds 0, whatever it knows.
    fn totals(&mut self) {
        let Sink::Sums { totals, .. } = self.program.sink() else { return };
        let counts = self.integers(self.places.counts);
        let zero = self.block.number(DOUBLE, 0.0);
        let used = self.block.compute(Operation::Compare(comparison::DIFFERENT), DOUBLE, [counts, zero]);
        let (added, rows) = (self.places.added, self.options.width.bytes() / DOUBLE.bytes());
        for (value, place) in totals.iter().zip(&self.places.totals) {
            self.block.speak_for(Some(*value));
            let row = self.operand(*value);
            let row = self.block.compute(Operation::And, DOUBLE, [used, row]);
            self.block.store(DOUBLE, Portion::Whole, row, added);
            let total = self.block.fleeting(place.spread());
            let mut total = self.block.compute(Operation::Spread, DOUBLE, [total]);
            for row in 0..rows {
                let row = self.block.fleeting(added.plus(row * DOUBLE.bytes()));
                total = self.block.compute(Operation::AddFirst, DOUBLE, [total, row]);
            }
            self.block.store(DOUBLE, Portion::Least, total, *place);
        }
    }

    fn outputs(&mut self) {
        let Sink::Sums { outputs, .. } = self.program.sink() else { return };
        for (i, value) in outputs.iter().enumerate() {
            self.block.speak_for(Some(*value));
            let output = self.operand(*value);
            self.block.scalar(|i| i.mov(Register::RSI, arg(offset_of!(Args, outputs))));
            let memory = MemoryPlace::new(Anchor::At(Register::RSI), (size_of::<f64>() * i) as i32);
            self.block.store(DOUBLE, Portion::Least, output, memory);
        }
    }
}
