//! From a program to the compiler's own form: the loop nest.
//!
//! What comes in: a [`Plan`] and how the pixels are stored. What goes out: one function of one argument, the address of
//! [`Args`]. Blocks, in the order of execution:
//! ```text
//! entry ─► row_head ─► row ─► full ⟲ ─► partial ─► row_end ─► row_head … ─► pass_end
//!                       │       └──────◄──┘ (where a pixel was left out)   │
//!                       └── outside the domain ────────────────────────────┘
//! ```
//! `full` takes groups all of whose pixels take part. `partial` takes the others: the last group of a row, always, and
//! those where the pixel set leaves a pixel out, after which the loop goes on. The last group ends at the window's
//! edge at the latest, so that every group reads its pixels at once and inside of the window.

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

/// A row while it is worked on; numbers of pixels, relative to the window.
#[derive(Clone, Copy)]
struct Row {
    /// The last pixel.
    end: ir::Value,
    /// The first pixel of the last group.
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
        let zero = self.emit.constant(0.0);
        for slot in &self.emit.plan.totals {
            self.emit.store(zero, *slot);
        }
        self.emit.level(Level::Pass);
        self.columns();
        let outer = self.emit.plan.program.coordinates().clamp(2, 4) - 1;
        // A picture's y counts its rows as well; a stack needs a counter beside y, z, w.
        let counters = if outer == 1 { 1 } else { outer + 1 };
        let [first, second] = self.emit.row_areas();
        // The row before the first one has no pixels.
        self.emit.areas = Some([second, first]);
        self.empty_row();
        let zero = self.emit.integer(0);
        let start = [vec![zero.into(); counters + 2], vec![first.into(), second.into()]].concat();
        self.emit.b.ins().jump(head, &start);

        let state: Vec<ir::Value> =
            (0..counters + 4).map(|_| self.emit.b.append_block_param(head, types::I64)).collect();
        let [pixels, saturated, current, ahead] = std::array::from_fn(|i| state[counters + i]);
        let place = Place { at: state[..outer].to_vec(), row: state[counters - 1] };
        self.emit.b.switch_to_block(head);
        let rows = self.rows(outer);
        let more = self.emit.b.ins().icmp(IntCC::SignedLessThanOrEqual, place.row, rows);
        self.emit.b.ins().brif(more, row, &[], pass_end, &[]);

        self.emit.b.switch_to_block(row);
        self.emit.areas = Some([current, ahead]);
        self.prepare(&place);
        let next = self.emit.b.create_block();
        let counts = self.emit.parameters(next, [types::I64; 2]);
        self.row(next, [pixels, saturated]);

        self.emit.b.switch_to_block(next);
        let after = self.after(&place);
        let state: Vec<BlockArg> =
            after.into_iter().chain(counts).chain([ahead, current]).map(BlockArg::from).collect();
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

    /// How many rows the window has in all its slices.
    fn rows(&mut self, outer: usize) -> ir::Value {
        let mut rows = self.emit.arg(types::I64, COUNT[0]);
        for count in &COUNT[1..outer] {
            let count = self.emit.arg(types::I64, *count);
            rows = self.emit.b.ins().imul(rows, count);
        }
        rows
    }

    /// Prepares a row: computes its values, its range, its offsets and addresses, and leaves them in the record. It is
    /// done before the row above is worked on, so that the processor has both to do at once. Behind the last row a row that does not
    /// exist is prepared; nothing reads it.
    fn prepare(&mut self, place: &Place) {
        for (axis, at) in place.at.iter().enumerate() {
            let first = self.emit.arg(types::I64, FIRST[axis]);
            let absolute = self.emit.b.ins().iadd(first, *at);
            self.emit.outer[axis + 1] = Some(self.emit.b.ins().fcvt_from_sint(types::F64, absolute));
        }
        self.emit.level(Level::Row);
        let start = self.range();
        running::prepare(&mut self.emit, start);
        self.emit.prepare_row(&place.at, place.row);
    }

    fn empty_row(&mut self) {
        let range = [0, -1].map(|number| self.emit.integer(number));
        self.set_range(range);
    }

    fn set_range(&mut self, range: [ir::Value; 2]) {
        for (pixel, slot) in range.into_iter().zip(self.emit.plan.range) {
            self.emit.store(pixel, slot);
        }
    }

    /// Puts the first and the last column of the window into the record, as f64.
    fn columns(&mut self) {
        if self.emit.plan.program.pixel_set().bounds.is_none() {
            return;
        }
        let first = self.emit.arg(types::I64, arg::X);
        let width = self.emit.arg(types::I64, arg::WIDTH);
        let last = self.emit.b.ins().iadd(first, width);
        let last = self.emit.b.ins().iadd_imm_s(last, -1);
        for (column, slot) in [first, last].into_iter().zip(self.emit.plan.columns) {
            let column = self.emit.b.ins().fcvt_from_sint(types::F64, column);
            self.emit.store(column, slot);
        }
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

    /// One row, which was prepared before; ends in a jump to `next` with the pass' pixel counts.
    fn row(&mut self, next: Block, [pixels, saturated]: [ir::Value; 2]) {
        let [start, end] = self.emit.plan.range.map(|slot| self.emit.load(types::I64, slot));
        let any = self.emit.b.ins().icmp(IntCC::SignedLessThanOrEqual, start, end);
        self.emit.go_on_if(any, next, &[pixels.into(), saturated.into()]);
        let lanes = self.emit.lanes() as i64;
        let distance = self.emit.b.ins().isub(end, start);
        let full = self.emit.b.ins().band_imm_s(distance, -lanes);
        let rest = self.emit.b.ins().iadd(start, full);
        let row = Row { end, rest };

        self.emit.hold();
        self.emit.open_row();
        let before = Running::start(&mut self.emit);
        let [body, partial, row_end] = std::array::from_fn(|_| self.emit.b.create_block());
        self.groups(row, start, &before, [body, partial]);

        let i = self.emit.b.append_block_param(body, types::I64);
        let state = before.parameters(&mut self.emit, body);
        self.emit.b.switch_to_block(body);
        let state = Group::full(&mut self.emit, i, partial).run(state);
        let i = self.emit.b.ins().iadd_imm_s(i, lanes);
        self.groups(row, i, &state, [body, partial]);

        let i = self.emit.b.append_block_param(partial, types::I64);
        let state = before.parameters(&mut self.emit, partial);
        let done = before.parameters(&mut self.emit, row_end);
        self.emit.b.switch_to_block(partial);
        let goes_on = self.emit.plan.is_masked();
        let state = Group::partial(&mut self.emit, i, row).run(state);
        if goes_on {
            let again = self.emit.b.create_block();
            let last = self.emit.b.ins().icmp(IntCC::SignedGreaterThanOrEqual, i, rest);
            self.emit.b.ins().brif(last, row_end, &state.values(), again, &[]);
            self.emit.b.switch_to_block(again);
            let i = self.emit.b.ins().iadd_imm_s(i, lanes);
            self.groups(row, i, &state, [body, partial]);
        } else {
            self.emit.b.ins().jump(row_end, &state.values());
        }

        self.emit.b.switch_to_block(row_end);
        let count = self.emit.b.ins().iadd_imm_s(distance, 1);
        let used = match done.unused {
            Some(unused) => self.emit.b.ins().isub(count, unused),
            None => count,
        };
        self.emit.count = Some(used);
        self.emit.sums = done.sums.clone();
        self.emit.level(Level::RowEnd);
        let pixels = self.emit.b.ins().iadd(pixels, used);
        let saturated = match done.saturated {
            Some(dropped) => self.emit.b.ins().iadd(saturated, dropped),
            None => saturated,
        };
        self.emit.b.ins().jump(next, &[pixels.into(), saturated.into()]);
    }

    /// Goes on with the group at pixel `i`: as a full one where it is not the row's last.
    fn groups(&mut self, row: Row, i: ir::Value, state: &Running, [full, partial]: [Block; 2]) {
        let more = self.emit.b.ins().icmp(IntCC::SignedLessThan, i, row.rest);
        let values = with(i, &state.values());
        self.emit.b.ins().brif(more, full, &values, partial, &values);
    }

    /// Leaves the first and the last pixel of the row in the record, and hands back the first; the last is before it
    /// where there is none. The order of comparisons is the interpreter's, so that NaN and infinities end the same way.
    fn range(&mut self) -> ir::Value {
        let emit = &mut self.emit;
        let Some((lo, hi)) = emit.plan.program.pixel_set().bounds else {
            let width = emit.arg(types::I64, arg::WIDTH);
            let zero = emit.integer(0);
            let last = emit.b.ins().iadd_imm_s(width, -1);
            self.set_range([zero, last]);
            return zero;
        };
        let (lo, hi) = (emit.scalar(lo, Level::Row), emit.scalar(hi, Level::Row));
        let [first, last] = emit.plan.columns.map(|slot| emit.load(types::F64, slot));
        let ordered = emit.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        let inside = emit.b.ins().fcmp(FloatCC::LessThan, first, lo);
        let lo = emit.b.ins().select(inside, lo, first);
        let inside = emit.b.ins().fcmp(FloatCC::LessThan, hi, last);
        let hi = emit.b.ins().select(inside, hi, last);
        let still = emit.b.ins().fcmp(FloatCC::LessThanOrEqual, lo, hi);
        let any = emit.b.ins().band(ordered, still);

        // Where there are pixels, both are inside of the window: distances below 2³¹, which the addition of 1.5 · 2⁵²
        // rounds to integers.
        let distance = emit.b.ins().fsub(lo, first);
        let (near, start) = emit.nearest(distance);
        let short = emit.b.ins().fcmp(FloatCC::LessThan, near, distance);
        let short = emit.b.ins().uextend(types::I64, short);
        let start = emit.b.ins().iadd(start, short);
        let distance = emit.b.ins().fsub(hi, first);
        let (near, end) = emit.nearest(distance);
        let over = emit.b.ins().fcmp(FloatCC::LessThan, distance, near);
        let over = emit.b.ins().uextend(types::I64, over);
        let end = emit.b.ins().isub(end, over);
        let [none_start, none_end] = [0, -1].map(|number| emit.integer(number));
        let start = emit.b.ins().select(any, start, none_start);
        let end = emit.b.ins().select(any, end, none_end);
        self.set_range([start, end]);
        start
    }
}

fn with(first: ir::Value, rest: &[BlockArg]) -> Vec<BlockArg> {
    std::iter::once(BlockArg::from(first)).chain(rest.iter().copied()).collect()
}
