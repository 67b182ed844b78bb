//! The row level: f64, two rows at once.
//!
//! Stores in the record, for each row: its values, as f64 and splatted over the lanes, its first and last pixel, and its
//! offsets. [`Emitter::prepare_row`] adds the addresses of its pixels.

use cranelift_codegen::ir::condcodes::FloatCC;
use cranelift_codegen::ir::{self, InstBuilder, MemFlagsData, types};
use isophote_elementary::MAGIC;
use isophote_symbolic::{Level, Op, Opcode, Precision, Value};

use super::emit::{CallForm, Emitter, arg};
use super::running::vector;
use crate::abi::Functions;
use crate::plan::Home;

impl Emitter<'_, '_> {
    /// Prepares two rows; `outer` holds their outer coordinates, y first, as f64.
    pub fn prepare(&mut self, outer: &[ir::Value]) {
        for (value, op) in self.instructions(Level::Row) {
            self.set_source(Some(value));
            let result = match op.code {
                Opcode::Outer(coordinate) => outer[coordinate.index() - 1],
                _ => self.pair_op(op),
            };
            self.results[value.index()] = Some(result);
            if let Some(slot) = self.plan.scalars[value.index()] {
                self.store(result, slot);
            }
            if let Some(Home { slot, .. }) = self.plan.splats[value.index()] {
                let is_truth = self.plan.program.is_truth(value);
                let lanes = if is_truth { self.truths(result) } else { self.lanes_of(result) };
                (0..2).for_each(|row| self.store_of(lanes[row], slot, row as i32));
            }
        }
        self.set_source(None);
        let first = self.range();
        self.offsets(first);
    }

    /// Prepares two rows without pixels.
    pub fn prepare_empty(&mut self) {
        let range = [0, -1].map(|number| {
            let number = self.integer(number);
            self.b.ins().splat(types::I64X2, number)
        });
        range.into_iter().zip(self.plan.range).for_each(|(pixel, slot)| self.store(pixel, slot));
        (0..2).for_each(|row| self.prepare_no_row(row));
    }

    /// A pass or row value, for both rows.
    fn both(&mut self, value: Value) -> ir::Value {
        let program = self.plan.program;
        if let Some(number) = program.instruction(value).op.constant() {
            return self.pair(number);
        }
        let kind = if program.is_truth(value) { types::I64X2 } else { types::F64X2 };
        match (program.instruction(value).level, self.results[value.index()], self.plan.pairs[value.index()]) {
            (Level::Row, Some(result), _) => result,
            (_, _, Some(slot)) => self.load(kind, slot),
            _ => unreachable!("the plan gives a slot to every value that crosses levels"),
        }
    }

    fn pair_op(&mut self, op: Op) -> ir::Value {
        let operands: Vec<ir::Value> = self.commuted(op, Level::Row).operands().map(|v| self.both(v)).collect();
        if let Some(result) = self.vector_arithmetic(op, &operands) {
            return result;
        }
        match op.code {
            Opcode::Const(x) => self.pair(x.get()),
            Opcode::Gather(lookup) => self.looked_up(lookup, [operands[0], operands[1]]),
            Opcode::Call1(f) => self.call_pair(Functions::scalar1(f), CallForm::Scalar1, &operands),
            Opcode::Call2(f) => self.call_pair(Functions::scalar2(f), CallForm::Scalar2, &operands),
            _ => unreachable!("the check refuses other instructions at the row level"),
        }
    }

    fn call_pair(&mut self, offset: i32, form: CallForm, operands: &[ir::Value]) -> ir::Value {
        let [first, second] = [0, 1].map(|row| {
            let arguments: Vec<ir::Value> = operands.iter().map(|v| self.b.ins().extractlane(*v, row)).collect();
            self.call_scalar(offset, form, &arguments)
        });
        let pair = self.b.ins().splat(types::F64X2, first);
        self.b.ins().insertlane(pair, second, 1)
    }

    /// A number of each row, rounded to the lane type and splatted.
    fn lanes_of(&mut self, pair: ir::Value) -> [ir::Value; 2] {
        match self.options.precision {
            Precision::F32 => {
                let single = self.b.ins().fvdemote(pair);
                [0, 4].map(|byte: u8| self.shuffled(single, single, [byte, byte + 1, byte + 2, byte + 3].repeat(4)))
            }
            Precision::F64 => self.spread_halves(pair),
        }
    }

    /// A truth value of each row, splatted.
    fn truths(&mut self, pair: ir::Value) -> [ir::Value; 2] {
        let halves = self.spread_halves(pair);
        halves.map(|half| self.cast(self.truth, half))
    }

    fn spread_halves(&mut self, pair: ir::Value) -> [ir::Value; 2] {
        let kind = self.b.func.dfg.value_type(pair);
        [0, 8].map(|first: u8| {
            let half = self.shuffled(pair, pair, (first..first + 8).collect::<Vec<u8>>().repeat(2));
            self.cast(kind, half)
        })
    }

    /// Stores the first and the last pixel of both rows in the record (last before first if there is none) and returns the
    /// first as f64. Comparisons follow the interpreter's order, so that NaN and infinities give the same result.
    fn range(&mut self) -> ir::Value {
        let Some((lo, hi)) = self.plan.program.pixel_set().bounds else {
            let width = self.arg(types::I64, arg::WIDTH);
            let last = self.b.ins().iadd_imm_s(width, -1);
            let zero = self.integer(0);
            for (pixel, slot) in [zero, last].into_iter().zip(self.plan.range) {
                let pair = self.b.ins().splat(types::I64X2, pixel);
                self.store(pair, slot);
            }
            return self.pair(0.0);
        };
        let (lo, hi) = (self.both(lo), self.both(hi));
        let [first, last] = self.plan.columns.map(|slot| self.load(types::F64X2, slot));
        let ordered = self.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        let lo = self.larger(first, lo);
        let hi = self.smaller(hi, last);
        let still = self.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        let any = self.b.ins().band(ordered, still);

        // Where there are pixels, both are inside the window: distances below 2³¹, which the addition of 1.5 · 2⁵² rounds
        // to integers. As an integer, true is −1.
        let distance = self.b.ins().fsub(lo, first);
        let (near, integer) = self.nearest(distance);
        let short = self.b.ins().fcmp(FloatCC::LessThan, near, distance);
        let start = self.b.ins().isub(integer, short);
        let start = self.b.ins().band(start, any);
        let one = self.pair(1.0);
        let short = self.cast(types::F64X2, short);
        let step = self.b.ins().band(short, one);
        let first_pixel = self.b.ins().fadd(near, step);
        let mask = self.cast(types::F64X2, any);
        let first_pixel = self.b.ins().band(first_pixel, mask);

        let distance = self.b.ins().fsub(hi, first);
        let (near, integer) = self.nearest(distance);
        let over = self.b.ins().fcmp(FloatCC::LessThan, distance, near);
        let end = self.b.ins().iadd(integer, over);
        let none = self.b.ins().bnot(any);
        let end = self.b.ins().bor(end, none);
        [start, end].into_iter().zip(self.plan.range).for_each(|(pixel, slot)| self.store(pixel, slot));
        first_pixel
    }

    /// `a < b ? b : a`.
    fn larger(&mut self, a: ir::Value, b: ir::Value) -> ir::Value {
        let less = self.b.ins().fcmp(FloatCC::LessThan, a, b);
        let less = self.cast(types::F64X2, less);
        self.b.ins().bitselect(less, b, a)
    }

    /// `a < b ? a : b`.
    fn smaller(&mut self, a: ir::Value, b: ir::Value) -> ir::Value {
        let less = self.b.ins().fcmp(FloatCC::LessThan, a, b);
        let less = self.cast(types::F64X2, less);
        self.b.ins().bitselect(less, a, b)
    }

    /// The integers nearest to two f64 below 2⁵¹, ties to even: as f64 and as integers. Cannot trap.
    fn nearest(&mut self, x: ir::Value) -> (ir::Value, ir::Value) {
        let magic = self.pair(MAGIC);
        let shifted = self.b.ins().fadd(x, magic);
        let bits =
            self.b.ins().bitcast(types::I64X2, MemFlagsData::new().with_endianness(ir::Endianness::Little), shifted);
        let magic_bits = self.cast(types::I64X2, magic);
        (self.b.ins().fsub(shifted, magic), self.b.ins().isub(bits, magic_bits))
    }

    /// Stores the offsets of both rows in the record; `first` is their first pixel, relative to the window.
    fn offsets(&mut self, first: ir::Value) {
        if self.plan.offsets.is_empty() {
            return;
        }
        let x = self.load(types::F64X2, self.plan.columns[0]);
        let x = self.b.ins().fadd(first, x);
        for offset in &self.plan.offsets {
            let c = self.both(offset.term);
            let magic = self.pair(MAGIC);
            let n = self.b.ins().fsub(magic, c);
            let n = self.b.ins().fsub(n, magic);
            let distance = self.b.ins().fsub(x, n);
            let distance = self.lanes_of(distance);
            let fraction = self.b.ins().fadd(c, n);
            let fraction = self.lanes_of(fraction);
            for row in 0..2 {
                let steps = vector(self, |lane| lane as f64);
                let lanes = self.b.ins().fadd(distance[row], steps);
                self.store_of(lanes, offset.first, row as i32);
                self.store_of(fraction[row], offset.fraction, row as i32);
            }
        }
    }

    /// The indices of two rows along an outer coordinate, as f64.
    pub fn outer_pair(&mut self, numbers: [ir::Value; 2]) -> ir::Value {
        let [first, second] = numbers.map(|number| self.b.ins().fcvt_from_sint(types::F64, number));
        let pair = self.b.ins().splat(types::F64X2, first);
        self.b.ins().insertlane(pair, second, 1)
    }
}
