//! Pass level, and the ends of rows and passes: scalar f64.

use cranelift_codegen::ir::condcodes::FloatCC;
use cranelift_codegen::ir::{self, InstBuilder, types};
use isophote_symbolic::{Comparison, Level, Op, Opcode, Precision, Sink, Value};

use super::emit::{CallForm, Emitter, PIXELS, arg};
use crate::abi::Functions;
use crate::plan::Home;

/// The condition code of a comparison.
fn condition(comparison: Comparison) -> FloatCC {
    match comparison {
        Comparison::Lt => FloatCC::LessThan,
        Comparison::Le => FloatCC::LessThanOrEqual,
        Comparison::Eq => FloatCC::Equal,
        Comparison::Ne => FloatCC::NotEqual,
    }
}

impl<'p> Emitter<'_, 'p> {
    /// Emits every instruction of a level other than the pixel's and the row's. Each result goes to its consumers (the record,
    /// the lanes, a total, an output) immediately, to keep few values live.
    pub fn level(&mut self, level: Level) {
        let base = match level {
            Level::Pass => Some(self.arg(types::I64, arg::INPUTS)),
            Level::PassEnd => Some(self.arg(types::I64, arg::OUTPUTS)),
            _ => None,
        };
        let mut wanted: Vec<Vec<usize>> = vec![Vec::new(); self.results.len()];
        let ends = self.ends(level);
        ends.iter().enumerate().for_each(|(i, value)| wanted[value.index()].push(i));
        for (value, op) in self.instructions(level) {
            self.set_source(Some(value));
            let result = match (op.code, base) {
                (Opcode::Input(input), Some(inputs)) => {
                    self.b.ins().load(types::F64, PIXELS, inputs, 8 * input.0 as i32)
                }
                _ => self.scalar_op(op, level),
            };
            self.results[value.index()] = Some(result);
            if let Some(slot) = self.plan.scalars[value.index()] {
                self.store(result, slot);
            }
            if let Some(slot) = self.plan.pairs[value.index()] {
                let pair = self.spread_pair(value, result);
                self.store(pair, slot);
            }
            self.splat(value, result);
            for i in std::mem::take(&mut wanted[value.index()]) {
                self.end(i, result, base);
            }
        }
        for (i, value) in ends.iter().enumerate().filter(|(_, value)| !wanted[value.index()].is_empty()) {
            self.set_source(Some(*value));
            let result = self.scalar(*value, level);
            self.end(i, result, base);
        }
        self.set_source(None);
    }

    /// Totals at the end of a row, outputs at the end of a pass.
    fn ends(&self, level: Level) -> &'p [Value] {
        let program = self.plan.program;
        match (program.sink(), level) {
            (Sink::Sums { totals, .. }, Level::RowEnd) => totals,
            (Sink::Sums { outputs, .. }, Level::PassEnd) => outputs,
            _ => &[],
        }
    }

    /// Adds to total `i`, or writes output `i`.
    fn end(&mut self, i: usize, result: ir::Value, outputs: Option<ir::Value>) {
        match outputs {
            Some(outputs) => {
                self.b.ins().store(PIXELS, result, outputs, 8 * i as i32);
            }
            None => {
                let slot = self.plan.totals[i];
                let total = self.load(types::F64, slot);
                let total = self.b.ins().fadd(result, total);
                self.store(total, slot);
            }
        }
    }

    fn scalar_op(&mut self, op: Op, level: Level) -> ir::Value {
        let op = self.commuted(op, level);
        let operands: Vec<ir::Value> = op.operands().map(|v| self.scalar(v, level)).collect();
        if let Some(result) = self.arithmetic(op, &operands) {
            return result;
        }
        match op.code {
            Opcode::Const(x) => self.constant(x.get()),
            Opcode::Not => self.b.ins().bxor_imm_s(operands[0], 1),
            Opcode::Select => self.b.ins().select(operands[0], operands[1], operands[2]),
            Opcode::Call1(f) => self.call_scalar(Functions::scalar1(f), CallForm::Scalar1, &operands),
            Opcode::Call2(f) => self.call_scalar(Functions::scalar2(f), CallForm::Scalar2, &operands),
            Opcode::Gather(lookup) => {
                let places = [operands[0], operands[1]].map(|place| self.b.ins().splat(types::F64X2, place));
                self.looked_up_one(lookup, places)
            }
            Opcode::RowTotal(accumulator) => self.row_total(accumulator.index()),
            Opcode::PassTotal(total) => {
                let slot = self.plan.totals[total.index()];
                self.load(types::F64, slot)
            }
            Opcode::RowCount | Opcode::PassCount => {
                let count = self.known(self.count);
                self.b.ins().fcvt_from_sint(types::F64, count)
            }
            _ => unreachable!("the check refuses other instructions at this level"),
        }
    }

    /// Operations that are the same for scalars and vectors, with truth values as comparisons yield them. `None` for
    /// operations that read no value, and for those that differ: selection, logical not, calls.
    pub fn arithmetic(&mut self, op: Op, operands: &[ir::Value]) -> Option<ir::Value> {
        let at = |i: usize| operands[i];
        let ins = self.b.ins();
        Some(match op.code {
            Opcode::Neg => ins.fneg(at(0)),
            Opcode::Abs => ins.fabs(at(0)),
            Opcode::Sqrt => ins.sqrt(at(0)),
            Opcode::Add => ins.fadd(at(0), at(1)),
            Opcode::Sub => ins.fsub(at(0), at(1)),
            Opcode::Mul => ins.fmul(at(0), at(1)),
            Opcode::Div => ins.fdiv(at(0), at(1)),
            Opcode::Fma => ins.fma(at(0), at(1), at(2)),
            Opcode::Compare(comparison) => ins.fcmp(condition(comparison), at(0), at(1)),
            Opcode::And => ins.band(at(0), at(1)),
            Opcode::Or => ins.bor(at(0), at(1)),
            Opcode::Not | Opcode::Select | Opcode::Call1(_) | Opcode::Call2(_) | Opcode::Gather(_) => return None,
            Opcode::Const(_) | Opcode::Input(_) | Opcode::Outer(_) | Opcode::Offset | Opcode::Channel(_) => {
                return None;
            }
            Opcode::RowTotal(_) | Opcode::RowCount | Opcode::PassTotal(_) | Opcode::PassCount => return None,
        })
    }

    /// Like [`Self::arithmetic`] for vectors only, whose truth values are masks: also selection and logical not.
    pub fn vector_arithmetic(&mut self, op: Op, operands: &[ir::Value]) -> Option<ir::Value> {
        match op.code {
            Opcode::Not => Some(self.b.ins().bnot(operands[0])),
            Opcode::Select => {
                let kind = self.b.func.dfg.value_type(operands[1]);
                let condition = self.cast(kind, operands[0]);
                Some(self.b.ins().bitselect(condition, operands[1], operands[2]))
            }
            _ => self.arithmetic(op, operands),
        }
    }

    /// Puts the memory operand of a sum or product second, where an instruction can fetch it.
    pub fn commuted(&self, op: Op, level: Level) -> Op {
        let fetched = |v: Value| {
            let instruction = self.plan.program.instruction(v);
            instruction.level != level || instruction.op.constant().is_some()
        };
        match op.parts() {
            (code @ (Opcode::Add | Opcode::Mul), &[a, b]) if fetched(a) && !fetched(b) => code.of([b, a]),
            _ => op,
        }
    }

    pub fn call_scalar(&mut self, offset: i32, form: CallForm, arguments: &[ir::Value]) -> ir::Value {
        let result = self.call(offset, form, arguments);
        self.known(result)
    }

    fn known(&self, value: Option<ir::Value>) -> ir::Value {
        match value {
            Some(value) => value,
            None => unreachable!("the check refuses instructions before their operands"),
        }
    }

    /// The lanes of an accumulator, summed in f64: (l0 + l2) + (l1 + l3), or l0 + l1.
    fn row_total(&mut self, accumulator: usize) -> ir::Value {
        let slot = self.plan.accumulators[accumulator].slot;
        let lanes = match self.sums[accumulator] {
            Some(held) => held,
            None => self.load(self.number, slot),
        };
        let sums = match self.options.precision {
            Precision::F32 => {
                let low = self.b.ins().fvpromote_low(lanes);
                let high = self.upper(lanes);
                let high = self.b.ins().fvpromote_low(high);
                self.b.ins().fadd(low, high)
            }
            Precision::F64 => lanes,
        };
        let [low, high] = [0, 1].map(|lane| self.b.ins().extractlane(sums, lane));
        self.b.ins().fadd(low, high)
    }

    /// Rounds the value to the lane type, once, and splats it, if pixels read it.
    fn splat(&mut self, value: Value, scalar: ir::Value) {
        if let Some(Home { slot, .. }) = self.plan.splats[value.index()] {
            let vector = self.spread(value, scalar);
            self.store(vector, slot);
        }
    }

    /// Loads the vectors that stay in registers during the row.
    pub fn load_pinned(&mut self) {
        let plan = self.plan;
        for (i, home) in plan.splats.iter().enumerate() {
            if let Some(home) = home.filter(|home| home.register) {
                let truth = plan.program.is_truth(Value(i as u32));
                self.held[i] = Some(self.load(if truth { self.truth } else { self.number }, home.slot));
            }
        }
    }

    /// Splats a pass value for two rows; truth values become masks.
    fn spread_pair(&mut self, value: Value, scalar: ir::Value) -> ir::Value {
        if self.plan.program.is_truth(value) {
            let mask = self.b.ins().bmask(types::I64, scalar);
            return self.b.ins().splat(types::I64X2, mask);
        }
        self.b.ins().splat(types::F64X2, scalar)
    }

    fn spread(&mut self, value: Value, scalar: ir::Value) -> ir::Value {
        if self.plan.program.is_truth(value) {
            let mask = self.b.ins().bmask(self.truth.lane_type(), scalar);
            return self.b.ins().splat(self.truth, mask);
        }
        let rounded = self.rounded(scalar);
        self.b.ins().splat(self.number, rounded)
    }

    /// Rounds an f64 to the lane type.
    pub fn rounded(&mut self, scalar: ir::Value) -> ir::Value {
        match self.options.precision {
            Precision::F32 => self.b.ins().fdemote(types::F32, scalar),
            Precision::F64 => scalar,
        }
    }
}
