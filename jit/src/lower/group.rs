//! The pixel level: one group of lanes.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{self, InstBuilder, types};
use isophote_symbolic::{Level, Op, PixelSet, Precision, Sink, Value};

use super::Row;
use super::emit::{Emitter, Form};
use super::load::Reach;
use super::running::{Running, vector};
use super::scalar::condition;
use crate::abi::Functions;

/// One group while it is emitted.
pub(super) struct Group<'e, 'a, 'p> {
    emit: &'e mut Emitter<'a, 'p>,
    /// The group's first pixel, relative to the window.
    first: ir::Value,
    /// Truth values of the lanes that are not beyond the row's end; `None`: all are alive.
    live: Option<ir::Value>,
    reach: Reach,
}

impl<'e, 'a, 'p> Group<'e, 'a, 'p> {
    /// A group of live lanes that starts at pixel `first`.
    pub fn full(emit: &'e mut Emitter<'a, 'p>, first: ir::Value) -> Self {
        Group { emit, first, live: None, reach: Reach::Full }
    }

    /// The row's last group, which has at least one live and one dead lane.
    pub fn tail(emit: &'e mut Emitter<'a, 'p>, row: Row) -> Self {
        let lanes = emit.lanes();
        let left = emit.b.ins().isub(row.end, row.rest);
        let last = emit.truth.lane_type();
        let left_lane = if last == types::I64 { left } else { emit.b.ins().ireduce(last, left) };
        let left_lanes = emit.b.ins().splat(emit.truth, left_lane);
        let bytes: Vec<u8> = match emit.options.precision {
            Precision::F32 => (0..4_i32).flat_map(i32::to_le_bytes).collect(),
            Precision::F64 => (0..2_i64).flat_map(i64::to_le_bytes).collect(),
        };
        let constant = emit.b.func.dfg.constants.insert(bytes.into());
        let steps = emit.b.ins().vconst(emit.truth, constant);
        let live = emit.b.ins().icmp(IntCC::SignedGreaterThanOrEqual, left_lanes, steps);
        let clamped = (0..lanes).map(|lane| {
            let at = emit.b.ins().iadd_imm_s(row.rest, lane as i64);
            emit.b.ins().smin(at, row.end)
        });
        let reach = Reach::Clamped(clamped.collect());
        Group { emit, first: row.rest, live: Some(live), reach }
    }

    /// Emits the group: pixel set, then every value, which is summed as soon as it is there.
    pub fn run(mut self, mut state: Running) -> Running {
        let plan = self.emit.plan;
        let PixelSet { mask, saturated, .. } = *plan.program.pixel_set();
        let roots: Vec<Value> = mask.into_iter().chain(saturated).collect();
        let decided = roots.iter().filter_map(|root| plan.pixels.iter().position(|v| v == root)).max();
        let mut used = None;
        if decided.is_none() {
            used = self.decide(&mut state);
            self.sink(None, used, &mut state);
        }
        let mut running = 0;
        for (at, value) in plan.pixels.iter().enumerate() {
            self.emit.speak_for(Some(*value));
            let result = match plan.program.instruction(*value).op {
                Op::Offset(_) => {
                    let (t, next) = self.step(state.offsets[running], *value);
                    state.offsets[running] = next;
                    running += 1;
                    t
                }
                op => self.op(op),
            };
            self.emit.results[value.index()] = Some(result);
            match decided {
                Some(last) if at < last => {}
                Some(last) if at == last => {
                    used = self.decide(&mut state);
                    self.sink(None, used, &mut state);
                    plan.pixels[..=at].iter().for_each(|v| self.sink(Some(*v), used, &mut state));
                }
                _ => self.sink(Some(*value), used, &mut state),
            }
        }
        self.emit.speak_for(None);
        state
    }

    /// The value of an offset in this group, and its running part in the next.
    fn step(&mut self, running: ir::Value, value: Value) -> (ir::Value, ir::Value) {
        let lanes = self.emit.lanes() as f64;
        let fraction = self.operand_held(value);
        let result = self.emit.b.ins().fadd(running, fraction);
        let step = vector(self.emit, |_| lanes);
        (result, self.emit.b.ins().fadd(running, step))
    }

    fn operand_held(&self, value: Value) -> ir::Value {
        match self.emit.held[value.index()] {
            Some(held) => held,
            None => unreachable!("Running::start leaves every fraction"),
        }
    }

    /// A lane vector; what lives in the record is loaded anew for each reader.
    fn operand(&mut self, value: Value) -> ir::Value {
        let emit = &mut *self.emit;
        let known = match emit.plan.program.instruction(value).level {
            Level::Pixel => emit.results[value.index()],
            _ => emit.held[value.index()],
        };
        match (known, emit.plan.splats[value.index()]) {
            (Some(known), _) => known,
            (None, Some(home)) => {
                let kind = if emit.plan.program.is_truth(value) { emit.truth } else { emit.number };
                emit.load(kind, home.slot)
            }
            (None, None) => unreachable!("the check refuses instructions before their operands"),
        }
    }

    fn op(&mut self, op: Op) -> ir::Value {
        if let Op::Channel(channel) = op {
            return self.emit.channel(channel.index(), self.first, &self.reach);
        }
        let operands: Vec<ir::Value> = op.operands().map(|v| self.operand(v)).collect();
        let at = |i: usize| operands[i];
        let emit = &mut *self.emit;
        match op {
            Op::Const(x) => vector(emit, |_| x),
            Op::Neg(_) => emit.b.ins().fneg(at(0)),
            Op::Abs(_) => emit.b.ins().fabs(at(0)),
            Op::Sqrt(_) => emit.b.ins().sqrt(at(0)),
            Op::Add(..) => emit.b.ins().fadd(at(0), at(1)),
            Op::Sub(..) => emit.b.ins().fsub(at(0), at(1)),
            Op::Mul(..) => emit.b.ins().fmul(at(0), at(1)),
            Op::Div(..) => emit.b.ins().fdiv(at(0), at(1)),
            Op::Fma(..) => emit.b.ins().fma(at(0), at(1), at(2)),
            Op::Compare(comparison, ..) => emit.b.ins().fcmp(condition(comparison), at(0), at(1)),
            Op::And(..) => emit.b.ins().band(at(0), at(1)),
            Op::Or(..) => emit.b.ins().bor(at(0), at(1)),
            Op::Not(_) => emit.b.ins().bnot(at(0)),
            Op::Select(..) => {
                let kind = emit.b.func.dfg.value_type(at(1));
                let condition = emit.cast(kind, at(0));
                emit.b.ins().bitselect(condition, at(1), at(2))
            }
            Op::Call1(f, _) => self.call(Functions::lanes1(self.emit.options.precision, f), Form::Lanes1, &operands),
            Op::Call2(f, ..) => self.call(Functions::lanes2(self.emit.options.precision, f), Form::Lanes2, &operands),
            _ => unreachable!("the check refuses scalar instructions at the pixel level"),
        }
    }

    /// An elementary function takes its lanes through the record.
    fn call(&mut self, offset: i32, form: Form, operands: &[ir::Value]) -> ir::Value {
        let emit = &mut *self.emit;
        let slots = emit.plan.operands;
        operands.iter().zip(slots).for_each(|(value, slot)| emit.store(*value, slot));
        let addresses: Vec<ir::Value> = slots[..operands.len()].iter().map(|slot| emit.address(*slot)).collect();
        emit.call(offset, form, &addresses);
        emit.load(emit.number, slots[0])
    }

    /// The lanes that take part, as a vector like the numbers, and both counts; `None`: all lanes take part.
    fn decide(&mut self, state: &mut Running) -> Option<ir::Value> {
        let PixelSet { mask, saturated, .. } = *self.emit.plan.program.pixel_set();
        let mut used = self.live;
        if let Some(mask) = mask {
            self.emit.speak_for(Some(mask));
            let mask = self.operand(mask);
            used = Some(used.map_or(mask, |used| self.emit.b.ins().band(used, mask)));
        }
        if let Some(saturated) = saturated {
            self.emit.speak_for(Some(saturated));
            let over = self.operand(saturated);
            let dropped = used.map_or(over, |used| self.emit.b.ins().band(used, over));
            state.saturated = state.saturated.map(|count| self.add_count(count, dropped));
            used = Some(match used {
                Some(used) => self.emit.b.ins().band_not(used, over),
                None => self.emit.b.ins().bnot(over),
            });
        }
        if let Some(used) = used {
            state.used = state.used.map(|count| self.add_count(count, used));
        }
        self.emit.speak_for(None);
        used.map(|used| self.emit.cast(self.emit.number, used))
    }

    /// `count` plus the lanes that hold.
    fn add_count(&mut self, count: ir::Value, truth: ir::Value) -> ir::Value {
        let bits = self.emit.b.ins().vhigh_bits(types::I32, truth);
        let lanes = self.emit.b.ins().popcnt(bits);
        let lanes = self.emit.b.ins().uextend(types::I64, lanes);
        self.emit.b.ins().iadd(count, lanes)
    }

    /// Sums, or writes, what `value` is wanted for; `None` stands for every value of the pass or the row.
    fn sink(&mut self, value: Option<Value>, used: Option<ir::Value>, state: &mut Running) {
        let program = self.emit.plan.program;
        let meant = |v: &Value| match value {
            Some(value) => *v == value,
            None => program.instruction(*v).level != Level::Pixel,
        };
        match program.sink() {
            Sink::Sums { accumulators, .. } => {
                for (i, v) in accumulators.iter().enumerate().filter(|(_, v)| meant(v)) {
                    self.accumulate(i, *v, used, state);
                }
            }
            Sink::Plane(v) if meant(v) => {
                self.emit.speak_for(Some(*v));
                let value = self.operand(*v);
                self.emit.write(value, used, self.first, &self.reach);
            }
            Sink::Plane(_) => {}
        }
    }

    fn accumulate(&mut self, i: usize, value: Value, used: Option<ir::Value>, state: &mut Running) {
        self.emit.speak_for(Some(value));
        let mut term = self.operand(value);
        if let Some(used) = used {
            term = self.emit.b.ins().band(term, used);
        }
        let emit = &mut *self.emit;
        match &mut state.sums[i] {
            Some(sum) => *sum = emit.b.ins().fadd(*sum, term),
            None => {
                let slot = emit.plan.accumulators[i].slot;
                let sum = emit.load(emit.number, slot);
                let sum = emit.b.ins().fadd(term, sum);
                emit.store(sum, slot);
            }
        }
    }
}
