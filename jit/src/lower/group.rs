//! The pixel level: one group of lanes.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{self, Block, BlockArg, InstBuilder, types};
use isophote_symbolic::{Level, Op, Opcode, PixelSet, Precision, Sink, Value};

use super::emit::Emitter;
use super::running::{Running, vector};
use super::{Row, with};

/// Emits one group.
pub(super) struct Group<'e, 'a, 'p> {
    emit: &'e mut Emitter<'a, 'p>,
    /// The group's first pixel, relative to the window.
    first: ir::Value,
    kind: Kind,
}

/// Which lanes of a group take part.
enum Kind {
    /// All; if the pixel set excludes one, the block takes over, with the pixel and the state.
    Full { otherwise: Block, pixel: ir::Value },
    /// Those of the row that the pixel set does not exclude.
    Partial {
        /// Truth values of the lanes that belong to the group.
        live: ir::Value,
        /// Pixels by which the group starts left of its first live one.
        surplus: ir::Value,
    },
}

impl<'e, 'a, 'p> Group<'e, 'a, 'p> {
    /// The full group that starts at `first`; `otherwise` has the same parameters as this block.
    pub fn full(emit: &'e mut Emitter<'a, 'p>, first: ir::Value, otherwise: Block) -> Self {
        Group { emit, first, kind: Kind::Full { otherwise, pixel: first } }
    }

    /// The group at `pixel`, as far as the row goes. It starts far enough left to end inside the window.
    pub fn partial(emit: &'e mut Emitter<'a, 'p>, pixel: ir::Value, row: Row) -> Self {
        let furthest = emit.load(types::I64, emit.plan.furthest);
        let first = emit.b.ins().umin(pixel, furthest);
        let before = emit.b.ins().isub(pixel, first);
        let until = emit.b.ins().isub(row.end, first);
        let until = emit.b.ins().iadd_imm_s(until, 1);

        let bytes: Vec<u8> = match emit.options.precision {
            Precision::F32 => (0..4_i32).flat_map(i32::to_le_bytes).collect(),
            Precision::F64 => (0..2_i64).flat_map(i64::to_le_bytes).collect(),
        };
        let steps = emit.constant_vector(emit.truth, bytes);
        let [before, until] = [before, until].map(|number| spread(emit, number));
        let early = emit.b.ins().icmp(IntCC::SignedGreaterThan, before, steps);
        let reached = emit.b.ins().icmp(IntCC::SignedGreaterThan, until, steps);
        let live = emit.b.ins().band_not(reached, early);
        let surplus = emit.b.ins().fcvt_from_sint(emit.number, before);
        Group { emit, first, kind: Kind::Partial { live, surplus } }
    }

    /// Emits the group: the pixel set, then every value, summed as soon as it is computed.
    pub fn run(mut self, mut state: Running) -> Running {
        let plan = self.emit.plan;
        let PixelSet { mask, saturated, .. } = *plan.program.pixel_set();
        let roots: Vec<Value> = mask.into_iter().chain(saturated).collect();
        let decided = roots.iter().filter_map(|root| plan.pixels.iter().position(|v| v == root)).max();
        let before = state.clone();
        let mut used = None;
        let mut join = None;
        if decided.is_none() {
            used = self.decide(&before, &mut state);
            self.sink(None, used, &mut state);
        }
        let mut running = 0;
        for (at, value) in plan.pixels.iter().enumerate() {
            // No other value reads it, so it follows the pixel set.
            if plan.is_contracted[value.index()] {
                self.sink(Some(*value), used, &mut state);
                continue;
            }
            self.emit.set_source(Some(*value));
            let op = plan.program.instruction(*value).op;
            let result = match op.code {
                Opcode::Offset => {
                    let (t, next) = self.step(state.offsets[running], *value);
                    state.offsets[running] = next;
                    running += 1;
                    t
                }
                _ => self.op(op),
            };
            self.emit.results[value.index()] = Some(result);
            match decided {
                Some(last) if at < last => {}
                Some(last) if at == last => {
                    used = self.decide(&before, &mut state);
                    join = used.map(|used| self.skip_when_empty(used, &state, running));
                    self.sink(None, used, &mut state);
                    plan.pixels[..=at].iter().for_each(|v| self.sink(Some(*v), used, &mut state));
                }
                _ => self.sink(Some(*value), used, &mut state),
            }
        }
        self.emit.set_source(None);
        let Some((block, joined)) = join else { return state };
        self.emit.b.ins().jump(block, &state.values());
        self.emit.b.switch_to_block(block);
        joined
    }

    /// Continues only if any lane is `used`; otherwise jumps to the end of the group, a block that the rest joins.
    /// `running` offsets have been stepped.
    fn skip_when_empty(&mut self, used: ir::Value, state: &Running, running: usize) -> (Block, Running) {
        let mut skipped = state.clone();
        let lanes = self.emit.lanes() as f64;
        let step = vector(self.emit, |_| lanes);
        for offset in &mut skipped.offsets[running..] {
            *offset = self.emit.b.ins().fadd(*offset, step);
        }
        let block = self.emit.b.create_block();
        let joined = state.parameters(self.emit, block);
        let truth = self.emit.cast(self.emit.truth, used);
        let bits = self.emit.b.ins().vhigh_bits(types::I32, truth);
        let any = self.emit.b.ins().icmp_imm_s(IntCC::NotEqual, bits, 0);
        self.emit.go_on_if(any, block, &skipped.values());
        (block, joined)
    }

    /// The value of an offset in this group, and its running part in the next.
    fn step(&mut self, running: ir::Value, value: Value) -> (ir::Value, ir::Value) {
        let lanes = self.emit.lanes() as f64;
        let fraction = self.operand_held(value);
        let here = match self.kind {
            Kind::Full { .. } => running,
            Kind::Partial { surplus, .. } => self.emit.b.ins().fsub(running, surplus),
        };
        let result = self.emit.b.ins().fadd(here, fraction);
        let step = vector(self.emit, |_| lanes);
        (result, self.emit.b.ins().fadd(running, step))
    }

    fn operand_held(&self, value: Value) -> ir::Value {
        match self.emit.held[value.index()] {
            Some(held) => held,
            None => unreachable!("Running::start leaves every fraction"),
        }
    }

    /// A lane vector; a value in the record is loaded again for each reader.
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
        if let Opcode::Channel(channel) = op.code {
            return self.emit.channel(channel.index(), self.first);
        }
        let operands: Vec<ir::Value> = op.operands().map(|v| self.operand(v)).collect();
        let emit = &mut *self.emit;
        if let Some(result) = emit.vector_arithmetic(op, &operands) {
            return result;
        }
        match op.code {
            Opcode::Const(x) => vector(emit, |_| x.get()),
            Opcode::Gather(lookup) => emit.looked_up(lookup, [operands[0], operands[1]]),
            Opcode::Call1(f) => emit.function1(f, operands[0]),
            Opcode::Call2(f) => emit.function2(f, operands[0], operands[1]),
            _ => unreachable!("the check refuses scalar instructions at the pixel level"),
        }
    }

    /// The lanes that take part, as a number vector; `None`: all. `before` is the state at the start of the block.
    fn decide(&mut self, before: &Running, state: &mut Running) -> Option<ir::Value> {
        let PixelSet { mask, saturated, .. } = *self.emit.plan.program.pixel_set();
        self.emit.set_source(mask.or(saturated));
        let mask = mask.map(|mask| self.operand(mask));
        let over = saturated.map(|saturated| self.operand(saturated));
        let used = match self.kind {
            Kind::Full { otherwise, pixel } => {
                if mask.is_some() || over.is_some() {
                    self.leave(mask, over, otherwise, &with(pixel, &before.values()));
                }
                None
            }
            Kind::Partial { live, .. } => {
                let in_set = mask.map_or(live, |mask| self.emit.b.ins().band(live, mask));
                let used = over.map_or(in_set, |over| self.emit.b.ins().band_not(in_set, over));
                if let Some(count) = state.unused {
                    let unused = self.emit.b.ins().band_not(live, used);
                    state.unused = Some(self.add_count(count, unused));
                }
                if let (Some(count), Some(over)) = (state.saturated, over) {
                    let dropped = self.emit.b.ins().band(in_set, over);
                    state.saturated = Some(self.add_count(count, dropped));
                }
                Some(self.emit.cast(self.emit.number, used))
            }
        };
        self.emit.set_source(None);
        used
    }

    /// `count` plus the number of true lanes.
    fn add_count(&mut self, count: ir::Value, truth: ir::Value) -> ir::Value {
        let bits = self.emit.b.ins().vhigh_bits(types::I32, truth);
        let lanes = self.emit.b.ins().popcnt(bits);
        let lanes = self.emit.b.ins().uextend(types::I64, lanes);
        self.emit.b.ins().iadd(count, lanes)
    }

    /// Continues only if every lane is in the set and none is saturated; else `otherwise` takes the group over.
    fn leave(&mut self, mask: Option<ir::Value>, over: Option<ir::Value>, otherwise: Block, arguments: &[BlockArg]) {
        let emit = &mut *self.emit;
        let all = (1_i64 << emit.lanes()) - 1;
        let (lanes, expected) = match (mask, over) {
            (Some(mask), Some(over)) => (emit.b.ins().band_not(mask, over), all),
            (Some(mask), None) => (mask, all),
            (None, Some(over)) => (over, 0),
            (None, None) => return,
        };
        let bits = emit.b.ins().vhigh_bits(types::I32, lanes);
        let whole = emit.b.ins().icmp_imm_s(IntCC::Equal, bits, expected);
        emit.go_on_if(whole, otherwise, arguments);
    }

    /// Adds `value` to its sums or writes it to the plane; `None` stands for every pass or row value.
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
                self.emit.set_source(Some(*v));
                let value = self.operand(*v);
                self.emit.write(value, used, self.first);
            }
            Sink::Plane(_) => {}
        }
    }

    fn accumulate(&mut self, i: usize, value: Value, used: Option<ir::Value>, state: &mut Running) {
        self.emit.set_source(Some(value));
        let plan = self.emit.plan;
        let slot = plan.accumulators[i].slot;
        let term = match plan.contractions[i] {
            Some((a, b)) => Term::Product(self.operand(a), self.operand(b)),
            None => Term::Value(self.operand(value)),
        };
        let emit = &mut *self.emit;
        let old = state.sums[i].unwrap_or_else(|| emit.load(emit.number, slot));
        let new = match (term, used) {
            (Term::Value(value), None) => emit.b.ins().fadd(old, value),
            (Term::Value(value), Some(used)) => {
                let value = emit.b.ins().band(value, used);
                emit.b.ins().fadd(old, value)
            }
            (Term::Product(a, b), None) => emit.b.ins().fma(a, b, old),
            (Term::Product(a, b), Some(used)) => {
                let new = emit.b.ins().fma(a, b, old);
                emit.b.ins().bitselect(used, new, old)
            }
        };
        match &mut state.sums[i] {
            Some(sum) => *sum = new,
            None => emit.store(new, slot),
        }
    }
}

/// The term added to an accumulator.
enum Term {
    Value(ir::Value),
    /// Fused multiply-add.
    Product(ir::Value, ir::Value),
}

/// A small integer in every lane of the truth type.
fn spread(emit: &mut Emitter<'_, '_>, number: ir::Value) -> ir::Value {
    let lane = emit.truth.lane_type();
    let number = if lane == types::I64 { number } else { emit.b.ins().ireduce(lane, number) };
    emit.b.ins().splat(emit.truth, number)
}
