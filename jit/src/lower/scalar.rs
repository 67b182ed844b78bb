//! Pass and row level: f64, one value at a time.

use cranelift_codegen::ir::condcodes::FloatCC;
use cranelift_codegen::ir::{self, InstBuilder, types};
use isophote_symbolic::{Comparison, Level, Op, Precision, Sink, Value};

use super::emit::{Emitter, Form, arg};
use crate::abi::Functions;
use crate::plan::Home;

/// The condition code of a comparison.
pub(super) fn condition(comparison: Comparison) -> FloatCC {
    match comparison {
        Comparison::Lt => FloatCC::LessThan,
        Comparison::Le => FloatCC::LessThanOrEqual,
        Comparison::Eq => FloatCC::Equal,
        Comparison::Ne => FloatCC::NotEqual,
    }
}

impl Emitter<'_, '_> {
    /// Emits every instruction of a level other than the pixel's; what other levels read goes to the record.
    pub fn level(&mut self, level: Level) {
        for (value, op) in self.instructions(level) {
            let result = self.scalar_op(op, level);
            self.results[value.index()] = Some(result);
            if let Some(slot) = self.plan.scalars[value.index()] {
                self.store(result, slot);
            }
        }
    }

    fn scalar_op(&mut self, op: Op, level: Level) -> ir::Value {
        let operands: Vec<ir::Value> = op.operands().map(|v| self.scalar(v, level)).collect();
        let at = |i: usize| operands[i];
        match op {
            Op::Const(x) => self.b.ins().f64const(x),
            Op::Input(input) => {
                let inputs = self.arg(types::I64, arg::INPUTS);
                self.b.ins().load(types::F64, super::emit::PIXELS, inputs, 8 * input.0 as i32)
            }
            Op::Neg(_) => self.b.ins().fneg(at(0)),
            Op::Abs(_) => self.b.ins().fabs(at(0)),
            Op::Sqrt(_) => self.b.ins().sqrt(at(0)),
            Op::Add(..) => self.b.ins().fadd(at(0), at(1)),
            Op::Sub(..) => self.b.ins().fsub(at(0), at(1)),
            Op::Mul(..) => self.b.ins().fmul(at(0), at(1)),
            Op::Div(..) => self.b.ins().fdiv(at(0), at(1)),
            Op::Fma(..) => self.b.ins().fma(at(0), at(1), at(2)),
            Op::Compare(comparison, ..) => self.b.ins().fcmp(condition(comparison), at(0), at(1)),
            Op::And(..) => self.b.ins().band(at(0), at(1)),
            Op::Or(..) => self.b.ins().bor(at(0), at(1)),
            Op::Not(_) => self.b.ins().bxor_imm_s(at(0), 1),
            Op::Select(..) => self.b.ins().select(at(0), at(1), at(2)),
            Op::Call1(f, _) => self.call_scalar(Functions::scalar1(f), Form::Scalar1, &operands),
            Op::Call2(f, ..) => self.call_scalar(Functions::scalar2(f), Form::Scalar2, &operands),
            Op::Outer(_) => self.known(self.outer),
            Op::RowTotal(accumulator) => self.row_total(accumulator.index()),
            Op::PassTotal(total) => {
                let slot = self.plan.totals[total.index()];
                self.load(types::F64, slot)
            }
            Op::RowCount | Op::PassCount => {
                let count = self.known(self.count);
                self.b.ins().fcvt_from_sint(types::F64, count)
            }
            Op::Offset(_) | Op::Channel(_) => unreachable!("the plan refuses pixel instructions at other levels"),
        }
    }

    fn call_scalar(&mut self, offset: i32, form: Form, arguments: &[ir::Value]) -> ir::Value {
        let result = self.call(offset, form, arguments);
        self.known(result)
    }

    fn known(&self, value: Option<ir::Value>) -> ir::Value {
        match value {
            Some(value) => value,
            None => unreachable!("the plan refuses instructions before their operands"),
        }
    }

    /// The lanes of an accumulator, summed in f64: ((l0 + l1) + (l2 + l3)) or (l0 + l1).
    fn row_total(&mut self, accumulator: usize) -> ir::Value {
        let slot = self.plan.accumulators[accumulator].slot;
        let held = self.sums[accumulator];
        let bytes = self.lane().bytes() as i32;
        let mut lanes: Vec<ir::Value> = (0..self.lanes())
            .map(|lane| {
                let value = match held {
                    Some(vector) => self.b.ins().extractlane(vector, lane as u8),
                    None => self.load(self.lane(), crate::plan::Slot(slot.0 + bytes * lane as i32)),
                };
                match self.options.precision {
                    Precision::F32 => self.b.ins().fpromote(types::F64, value),
                    Precision::F64 => value,
                }
            })
            .collect();
        while lanes.len() > 1 {
            lanes = lanes.chunks(2).map(|pair| self.b.ins().fadd(pair[0], pair[1])).collect();
        }
        lanes[0]
    }

    /// Adds the row's contributions to the totals.
    pub fn totals(&mut self) {
        let program = self.plan.program;
        let Sink::Sums { totals, .. } = program.sink() else { return };
        for (value, slot) in totals.iter().zip(self.plan.totals.clone()) {
            let value = self.scalar(*value, Level::RowEnd);
            let total = self.load(types::F64, slot);
            let total = self.b.ins().fadd(value, total);
            self.store(total, slot);
        }
    }

    /// Writes the outputs.
    pub fn outputs(&mut self, outputs: &[Value]) {
        for (i, value) in outputs.iter().enumerate() {
            let value = self.scalar(*value, Level::PassEnd);
            let address = self.arg(types::I64, arg::OUTPUTS);
            self.b.ins().store(super::emit::PIXELS, value, address, 8 * i as i32);
        }
    }

    /// Rounds the values of `level` that pixels read to the lane type, once, and spreads them over the lanes. At row level
    /// those of the pass that a register holds are fetched as well.
    pub fn splat(&mut self, level: Level) {
        for (i, home) in self.plan.splats.clone().into_iter().enumerate() {
            let Some(Home { slot, register }) = home else { continue };
            let value = Value(i as u32);
            let own = self.plan.program.instruction(value).level;
            if own == level {
                let vector = self.spread(value, level);
                if level == Level::Row && register {
                    self.held[i] = Some(vector);
                } else {
                    self.store(vector, slot);
                }
            } else if level == Level::Row && register {
                let kind = if self.plan.program.is_truth(value) { self.truth } else { self.number };
                self.held[i] = Some(self.load(kind, slot));
            }
        }
    }

    fn spread(&mut self, value: Value, level: Level) -> ir::Value {
        let scalar = self.scalar(value, level);
        if self.plan.program.is_truth(value) {
            let mask = self.b.ins().bmask(self.truth.lane_type(), scalar);
            return self.b.ins().splat(self.truth, mask);
        }
        let rounded = self.rounded(scalar);
        self.b.ins().splat(self.number, rounded)
    }

    /// An f64 in the lane type.
    pub fn rounded(&mut self, scalar: ir::Value) -> ir::Value {
        match self.options.precision {
            Precision::F32 => self.b.ins().fdemote(types::F32, scalar),
            Precision::F64 => scalar,
        }
    }
}
