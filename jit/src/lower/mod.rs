//! From a program to the compiler's own form: the loop nest.
//!
//! What comes in: a [`Plan`] and how the pixels are stored. What goes out: one function of one argument, the address of
//! [`Args`]. Blocks, in the order of execution:
//! ```text
//! entry ─► row_head ─► row ─► begin ─► loop ⟲ ─► rest? ─► tail ─► row_end ─► row_head … ─► pass_end
//!                       └── outside the domain ──────────────────────────────────┘
//! ```
//! `loop` takes full groups of lanes; `tail` takes the last pixels of a row, with the dead lanes reading the row's last
//! pixel again.

mod elementary;
mod emit;
mod group;
mod load;
mod running;
mod scalar;

use cranelift_codegen::ir::condcodes::{FloatCC, IntCC};
use cranelift_codegen::ir::{self, Block, BlockArg, Function, InstBuilder, Signature, UserFuncName, types};
use cranelift_codegen::isa::TargetIsa;
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext};
use isophote_symbolic::{Level, Program};

use self::emit::{Emitter, arg};
use self::group::Group;
use self::running::Running;
use crate::kernel::KernelOptions;
use crate::plan::Plan;

/// The loop nest of `program`, for `isa`'s calling convention.
pub(crate) fn lower(program: &Program, options: &KernelOptions, isa: &dyn TargetIsa) -> Function {
    let plan = Plan::new(program);
    let mut signature = Signature::new(isa.default_call_conv());
    signature.params.push(ir::AbiParam::new(types::I64));
    let mut function = Function::with_name_signature(UserFuncName::default(), signature);
    let mut context = FunctionBuilderContext::new();
    let builder = FunctionBuilder::new(&mut function, &mut context);
    Nest { emit: Emitter::new(builder, &plan, options, isa) }.build();
    function
}

/// Where a row is in the window: its numbers along the outer coordinates, as many as the program has, y at least.
#[derive(Clone)]
struct Place {
    /// y; y, z; or y, z, w.
    at: Vec<ir::Value>,
    /// How many rows came before it.
    row: ir::Value,
}

/// Fields of the argument block, by the outer coordinate: where the window begins, …
const FIRST: [i32; 3] = [arg::Y, arg::Z, arg::W];
/// … and how far it goes.
const COUNT: [i32; 3] = [arg::HEIGHT, arg::DEPTH, arg::LENGTH];

/// A row while it is worked on.
#[derive(Clone, Copy)]
struct Row {
    /// First and last pixel, relative to the window.
    start: ir::Value,
    end: ir::Value,
    /// The first pixel that is left over when full groups are done.
    rest: ir::Value,
}

struct Nest<'a, 'p> {
    emit: Emitter<'a, 'p>,
}

impl Nest<'_, '_> {
    fn build(mut self) {
        let blocks: [Block; 3] = std::array::from_fn(|_| self.emit.b.create_block());
        let [head, row, pass_end] = blocks;
        self.emit.enter();
        let zero = self.emit.b.ins().f64const(0.0);
        for slot in &self.emit.plan.totals {
            self.emit.store(zero, *slot);
        }
        self.emit.level(Level::Pass);
        let zero = self.emit.integer(0);
        let outer = self.emit.plan.program.coordinates().clamp(2, 4) - 1;
        // A picture's y counts its rows as well; a stack needs a counter beside y, z, w.
        let counters = if outer == 1 { 1 } else { outer + 1 };
        self.emit.b.ins().jump(head, &vec![zero.into(); counters + 2]);

        let state: Vec<ir::Value> =
            (0..counters + 2).map(|_| self.emit.b.append_block_param(head, types::I64)).collect();
        let [pixels, saturated] = [state[counters], state[counters + 1]];
        let place = Place { at: state[..outer].to_vec(), row: state[counters - 1] };
        self.emit.b.switch_to_block(head);
        let last = self.emit.arg(types::I64, COUNT[outer - 1]);
        let more = self.emit.b.ins().icmp(IntCC::SignedLessThan, place.at[outer - 1], last);
        self.emit.b.ins().brif(more, row, &[], pass_end, &[]);

        self.emit.b.switch_to_block(row);
        let next = self.emit.b.create_block();
        let counts = self.emit.parameters(next, [types::I64; 2]);
        self.row(&place, next, [pixels, saturated]);

        self.emit.b.switch_to_block(next);
        let mut state: Vec<BlockArg> = self.after(&place).into_iter().map(BlockArg::from).collect();
        state.extend(counts.map(BlockArg::from));
        self.emit.b.ins().jump(head, &state);

        self.emit.b.switch_to_block(pass_end);
        self.emit.count = Some(pixels);
        self.emit.level(Level::PassEnd);
        self.emit.set_arg(pixels, arg::PIXELS);
        self.emit.set_arg(saturated, arg::SATURATED);
        self.emit.b.ins().return_(&[]);
        self.emit.b.seal_all_blocks();
        let frontend = self.emit.frontend;
        self.emit.b.finalize(frontend);
    }

    /// The numbers of the row that follows: y counts up, and each coordinate that has come to its end begins again and
    /// moves the next one on.
    fn after(&mut self, place: &Place) -> Vec<ir::Value> {
        let emit = &mut self.emit;
        let outer = place.at.len();
        let mut numbers = vec![emit.b.ins().iadd_imm_s(place.at[0], 1)];
        for axis in 1..outer {
            let count = emit.arg(types::I64, COUNT[axis - 1]);
            let ends = emit.b.ins().icmp(IntCC::SignedGreaterThanOrEqual, numbers[axis - 1], count);
            let zero = emit.integer(0);
            numbers[axis - 1] = emit.b.ins().select(ends, zero, numbers[axis - 1]);
            let carried = emit.b.ins().uextend(types::I64, ends);
            numbers.push(emit.b.ins().iadd(place.at[axis], carried));
        }
        if outer > 1 {
            numbers.push(emit.b.ins().iadd_imm_s(place.row, 1));
        }
        numbers
    }

    /// One row; ends in a jump to `next` with the pass' pixel counts.
    fn row(&mut self, place: &Place, next: Block, [pixels, saturated]: [ir::Value; 2]) {
        for (axis, at) in place.at.iter().enumerate() {
            let first = self.emit.arg(types::I64, FIRST[axis]);
            let absolute = self.emit.b.ins().iadd(first, *at);
            self.emit.outer[axis + 1] = Some(self.emit.b.ins().fcvt_from_sint(types::F64, absolute));
        }
        self.emit.level(Level::Row);
        let (start, end) = self.range(next, [pixels, saturated]);

        let lanes = self.emit.lanes() as i64;
        let count = self.emit.b.ins().isub(end, start);
        let count = self.emit.b.ins().iadd_imm_s(count, 1);
        let full = self.emit.b.ins().band_imm_s(count, -lanes);
        let rest = self.emit.b.ins().iadd(start, full);
        let row = Row { start, end, rest };

        self.emit.hold();
        self.emit.open_row(&place.at, place.row);
        let before = Running::start(&mut self.emit, row);
        let (body, after, tail, row_end) = (
            self.emit.b.create_block(),
            self.emit.b.create_block(),
            self.emit.b.create_block(),
            self.emit.b.create_block(),
        );
        let any = self.emit.b.ins().icmp(IntCC::SignedLessThan, start, rest);
        let values = before.values();
        self.emit.b.ins().brif(any, body, &with(start, &values), after, &values);

        let i = self.emit.b.append_block_param(body, types::I64);
        let state = before.parameters(&mut self.emit, body);
        self.emit.b.switch_to_block(body);
        let state = Group::full(&mut self.emit, i).run(state);
        let i = self.emit.b.ins().iadd_imm_s(i, lanes);
        let more = self.emit.b.ins().icmp(IntCC::SignedLessThan, i, rest);
        let values = state.values();
        self.emit.b.ins().brif(more, body, &with(i, &values), after, &values);

        let state = before.parameters(&mut self.emit, after);
        let done = before.parameters(&mut self.emit, row_end);
        self.emit.b.switch_to_block(after);
        let left = self.emit.b.ins().icmp(IntCC::SignedLessThanOrEqual, rest, end);
        self.emit.b.ins().brif(left, tail, &[], row_end, &state.values());

        self.emit.b.switch_to_block(tail);
        let state = Group::tail(&mut self.emit, row).run(state);
        self.emit.b.ins().jump(row_end, &state.values());

        self.emit.b.switch_to_block(row_end);
        let (used, dropped) = done.counts(count);
        self.emit.count = Some(used);
        self.emit.sums = done.sums.clone();
        self.emit.level(Level::RowEnd);
        let pixels = self.emit.b.ins().iadd(pixels, used);
        let saturated = match dropped {
            Some(dropped) => self.emit.b.ins().iadd(saturated, dropped),
            None => saturated,
        };
        self.emit.b.ins().jump(next, &[pixels.into(), saturated.into()]);
    }

    /// First and last pixel of the row; jumps to `next` when there is none. The order of comparisons is the
    /// interpreter's, so that NaN and infinities end the same way; conversions saturate, so that nothing traps.
    fn range(&mut self, next: Block, counts: [ir::Value; 2]) -> (ir::Value, ir::Value) {
        let emit = &mut self.emit;
        let width = emit.arg(types::I64, arg::WIDTH);
        let Some((lo, hi)) = emit.plan.program.pixel_set().bounds else {
            let zero = emit.integer(0);
            let last = emit.b.ins().iadd_imm_s(width, -1);
            return (zero, last);
        };
        let counts: [BlockArg; 2] = counts.map(BlockArg::from);
        let (lo, hi) = (emit.scalar(lo, Level::Row), emit.scalar(hi, Level::Row));
        let x = emit.arg(types::I64, arg::X);
        let first = emit.b.ins().fcvt_from_sint(types::F64, x);
        let last = emit.b.ins().iadd(x, width);
        let last = emit.b.ins().iadd_imm_s(last, -1);
        let last = emit.b.ins().fcvt_from_sint(types::F64, last);

        let ordered = emit.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        emit.go_on_if(ordered, next, &counts);
        let inside = emit.b.ins().fcmp(FloatCC::GreaterThan, lo, first);
        let lo = emit.b.ins().select(inside, lo, first);
        let inside = emit.b.ins().fcmp(FloatCC::LessThan, hi, last);
        let hi = emit.b.ins().select(inside, hi, last);
        let ordered = emit.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        emit.go_on_if(ordered, next, &counts);

        let distance = emit.b.ins().fsub(lo, first);
        let start = emit.b.ins().fcvt_to_sint_sat(types::I64, distance);
        let floor = emit.b.ins().fcvt_from_sint(types::F64, start);
        let above = emit.b.ins().fcmp(FloatCC::LessThan, floor, distance);
        let above = emit.b.ins().uextend(types::I64, above);
        let start = emit.b.ins().iadd(start, above);
        let distance = emit.b.ins().fsub(hi, first);
        let end = emit.b.ins().fcvt_to_sint_sat(types::I64, distance);
        let any = emit.b.ins().icmp(IntCC::SignedLessThanOrEqual, start, end);
        emit.go_on_if(any, next, &counts);
        (start, end)
    }
}

fn with(first: ir::Value, rest: &[BlockArg]) -> Vec<BlockArg> {
    std::iter::once(BlockArg::from(first)).chain(rest.iter().copied()).collect()
}
