//! Lowers a program to CLIF: the loop nest.
//!
//! The function takes one argument, the address of [`Args`](crate::abi::Args). Blocks, in the order of execution:
//! ```text
//! entry ─► head ─► pair ─► row ─► full ⟲ ─► partial ─► row end ─► next ─► row (the second of two), head …, pass end
//!                          │        └──────◄──┘        │           │
//!                          └── no pixels ──────────────┴───────────┘
//! ```
//! `pair` prepares the two rows after those processed next, so that the processor overlaps both. `full` runs groups all of
//! whose pixels take part. `partial` runs the others: always the last group of a row, and those where the pixel set
//! excludes a pixel, after which the loop continues. The last group ends no later than the window's edge, so that every
//! group reads all its pixels at once, inside the window.

mod elementary;
mod emit;
mod gather;
mod group;
mod load;
mod rows;
mod running;
mod scalar;

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{self, Block, BlockArg, Function, InstBuilder, Signature, UserFuncName, types};
use cranelift_codegen::isa::TargetIsa;
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext};
use isophote_symbolic::{Level, Program};

use self::emit::{Areas, Emitter, arg};
use self::group::Group;
use self::running::Running;
use crate::options::{KernelOptions, VectorWidth};
use crate::plan::Plan;

/// The loop nest of `program`, for `isa`'s calling convention.
pub(crate) fn lower(program: &Program, options: &KernelOptions, isa: &dyn TargetIsa) -> Function {
    let plan = Plan::new(program, VectorWidth::Bits128);
    let mut signature = Signature::new(isa.default_call_conv());
    signature.params.push(ir::AbiParam::new(types::I64));
    let mut function = Function::with_name_signature(UserFuncName::default(), signature);
    let mut context = FunctionBuilderContext::new();
    let builder = FunctionBuilder::new(&mut function, &mut context);
    Nest { emit: Emitter::new(builder, &plan, options, isa) }.build();
    function
}

/// Position of a row in the window: its indices along the outer coordinates of the program, at least y.
#[derive(Clone)]
struct RowPlace {
    /// y; y, z; or y, z, w.
    at: Vec<ir::Value>,
    /// Rows before it.
    row: ir::Value,
}

/// Fields of the argument block with the window's start, by outer coordinate.
const FIRST: [i32; 3] = [arg::Y, arg::Z, arg::W];
/// Fields of the argument block with the window's extent, by outer coordinate.
const COUNT: [i32; 3] = [arg::HEIGHT, arg::DEPTH, arg::LENGTH];

/// Bounds of the row being processed; pixel indices relative to the window.
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
        let [head, pair, row, pass_end] = std::array::from_fn(|_| self.emit.b.create_block());
        self.emit.enter();
        let zero = self.emit.constant(0.0);
        for slot in &self.emit.plan.totals {
            self.emit.store(zero, *slot);
        }
        self.emit.level(Level::Pass);
        self.columns();
        let outer = self.emit.plan.program.coordinates().clamp(2, 4) - 1;
        // In 2-D, y is also the row counter; a stack needs one beside y, z, w.
        let counters = if outer == 1 { 1 } else { outer + 1 };
        let [first, second] = self.emit.row_areas();
        // The two rows before the first ones have no pixels.
        for ahead in [first, second] {
            self.emit.areas = Some(Areas { scalars: first, vectors: first, ahead });
            self.emit.prepare_empty();
        }
        let zero = self.emit.integer(0);
        let start = [vec![zero.into(); counters + 2], vec![first.into(), second.into()]].concat();
        self.emit.b.ins().jump(head, &start);

        // `place` is the first of the two rows being prepared; the row being processed is two before it.
        let state: Vec<ir::Value> =
            (0..counters + 4).map(|_| self.emit.b.append_block_param(head, types::I64)).collect();
        let [pixels, saturated, current, ahead] = std::array::from_fn(|i| state[counters + i]);
        let totals = [pixels, saturated];
        let place = RowPlace { at: state[..outer].to_vec(), row: state[counters - 1] };
        self.emit.b.switch_to_block(head);
        let rows = self.rows(outer);
        let last = self.emit.b.ins().iadd_imm_s(rows, 2);
        let more = self.emit.b.ins().icmp(IntCC::SignedLessThan, place.row, last);
        self.emit.b.ins().brif(more, pair, &[], pass_end, &[]);

        self.emit.b.switch_to_block(pair);
        self.emit.areas = Some(Areas { scalars: current, vectors: current, ahead });
        let second = self.after(&place);
        self.prepare([&place, &second]);
        let zero = self.emit.integer(0);
        self.emit.b.ins().jump(row, &[zero.into(), pixels.into(), saturated.into()]);

        let [which, pixels, saturated] = self.emit.parameters(row, [types::I64; 3]);
        self.emit.b.switch_to_block(row);
        let [scalars, vectors] = [3, 4].map(|bits| {
            let across = self.emit.b.ins().ishl_imm_s(which, bits);
            self.emit.b.ins().iadd(current, across)
        });
        self.emit.areas = Some(Areas { scalars, vectors, ahead });
        let next = self.emit.b.create_block();
        let counts = self.emit.parameters(next, [types::I64; 2]);
        self.row(next, [pixels, saturated]);

        self.emit.b.switch_to_block(next);
        let [again, done] = std::array::from_fn(|_| self.emit.b.create_block());
        // The second of the two, if there is one.
        let row_after = self.emit.b.ins().iadd_imm_s(place.row, -1);
        let rows = self.rows(outer);
        let exists = self.emit.b.ins().icmp(IntCC::SignedLessThan, row_after, rows);
        let is_first = self.emit.b.ins().icmp_imm_s(IntCC::Equal, which, 0);
        let more = self.emit.b.ins().band(is_first, exists);
        self.emit.b.ins().brif(more, again, &[], done, &[]);
        self.emit.b.switch_to_block(again);
        let one = self.emit.integer(1);
        self.emit.b.ins().jump(row, &[one.into(), counts[0].into(), counts[1].into()]);
        self.emit.b.switch_to_block(done);
        let RowPlace { mut at, row } = self.after(&second);
        if outer > 1 {
            at.push(row);
        }
        let state: Vec<BlockArg> = at.into_iter().chain(counts).chain([ahead, current]).map(BlockArg::from).collect();
        self.emit.b.ins().jump(head, &state);

        let [pixels, saturated] = totals;
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

    /// Rows of the window over all slices and volumes.
    fn rows(&mut self, outer: usize) -> ir::Value {
        let mut rows = self.emit.arg(types::I64, COUNT[0]);
        for count in &COUNT[1..outer] {
            let count = self.emit.arg(types::I64, *count);
            rows = self.emit.b.ins().imul(rows, count);
        }
        rows
    }

    /// Prepares two rows: stores their values, ranges, offsets and addresses in the record. This runs before the previous two
    /// rows are processed, so that the processor overlaps both. Past the last row, it prepares nonexistent rows, which nothing
    /// reads.
    fn prepare(&mut self, places: [&RowPlace; 2]) {
        let mut outer = Vec::new();
        for (axis, field) in FIRST.iter().enumerate().take(places[0].at.len()) {
            let first = self.emit.arg(types::I64, *field);
            let numbers = places.map(|place| self.emit.b.ins().iadd(first, place.at[axis]));
            outer.push(self.emit.outer_pair(numbers));
        }
        self.emit.prepare(&outer);
        for (which, place) in places.into_iter().enumerate() {
            self.emit.prepare_row(&place.at, place.row, which as i32);
        }
    }

    /// Stores the window's first and last column and the latest start of a row's last group in the record.
    fn columns(&mut self) {
        let first = self.emit.arg(types::I64, arg::X);
        let width = self.emit.arg(types::I64, arg::WIDTH);
        let last = self.emit.b.ins().iadd(first, width);
        let last = self.emit.b.ins().iadd_imm_s(last, -1);
        for (column, slot) in [first, last].into_iter().zip(self.emit.plan.columns) {
            let column = self.emit.b.ins().fcvt_from_sint(types::F64, column);
            let column = self.emit.b.ins().splat(types::F64X2, column);
            self.emit.store(column, slot);
        }
        let furthest = self.emit.arg(types::I64, arg::FURTHEST);
        self.emit.store(furthest, self.emit.plan.furthest);
    }

    /// The position of the next row: y counts up; a coordinate that reaches its end restarts and carries into the next.
    fn after(&mut self, place: &RowPlace) -> RowPlace {
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
        let row = if outer > 1 { emit.b.ins().iadd_imm_s(place.row, 1) } else { numbers[0] };
        RowPlace { at: numbers, row }
    }

    /// Processes a prepared row; ends in a jump to `next` with the pass's pixel counts.
    fn row(&mut self, next: Block, [pixels, saturated]: [ir::Value; 2]) {
        let [start, end] = self.emit.plan.range.map(|slot| self.emit.load(types::I64, slot));
        let any = self.emit.b.ins().icmp(IntCC::SignedLessThanOrEqual, start, end);
        self.emit.go_on_if(any, next, &[pixels.into(), saturated.into()]);
        let lanes = self.emit.lanes() as i64;
        let distance = self.emit.b.ins().isub(end, start);
        let full = self.emit.b.ins().band_imm_s(distance, -lanes);
        let rest = self.emit.b.ins().iadd(start, full);
        // Full groups start before the furthest one anyway; stating it once per row lets the verifier prove it.
        let furthest = self.emit.load(types::I64, self.emit.plan.furthest);
        let rest = self.emit.b.ins().umin(rest, furthest);
        let row = Row { end, rest };

        self.emit.load_pinned();
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
        let saturated = match done.saturated {
            Some(dropped) => self.emit.b.ins().iadd(saturated, dropped),
            None => saturated,
        };
        if self.emit.plan.is_masked() {
            // Values of a row without pixels may be NaN, which no product with an empty sum turns into 0.
            self.emit.go_on_if(used, next, &[pixels.into(), saturated.into()]);
        }
        self.emit.count = Some(used);
        self.emit.sums = done.sums.clone();
        self.emit.level(Level::RowEnd);
        let pixels = self.emit.b.ins().iadd(pixels, used);
        self.emit.b.ins().jump(next, &[pixels.into(), saturated.into()]);
    }

    /// Continues with the group at pixel `i`, as a full one unless it is the row's last.
    fn groups(&mut self, row: Row, i: ir::Value, state: &Running, [full, partial]: [Block; 2]) {
        let more = self.emit.b.ins().icmp(IntCC::UnsignedLessThan, i, row.rest);
        let values = with(i, &state.values());
        self.emit.b.ins().brif(more, full, &values, partial, &values);
    }
}

fn with(first: ir::Value, rest: &[BlockArg]) -> Vec<BlockArg> {
    std::iter::once(BlockArg::from(first)).chain(rest.iter().copied()).collect()
}
