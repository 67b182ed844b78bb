//! `Plan`: assigns every value of a program to a register or a slot while the loop runs.
//!
//! A plan is the order of the pixel instructions, the layout of the *record* (one stack slot) and the few vectors that stay
//! in registers. Values that one level computes and another reads go through the record, so that only the loop's own
//! vectors are live across the loop: register allocation stays short and linear, and x64 reads a memory operand for free.

use crate::nest::order::{FUNCTION_REGISTERS, busy_registers, is_masked, order, scalar_reads, sinks};
use crate::options::VectorWidth;
use isophote_symbolic::{Instruction, Level, Opcode, Program, Sink, Value};

/// A part of the record.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Area {
    /// Values of a pass.
    Pass,
    /// Values of two rows, each slot twice. There are two such areas: two rows are prepared while the previous two are
    /// processed.
    Rows,
}

/// A slot of the record: its byte offset in its area, and its size.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Slot {
    pub area: Area,
    pub offset: i32,
    pub bytes: i32,
}

/// Slots of the inner coordinate plus a row value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ColumnOffset {
    /// The `Opcode::Offset`.
    pub value: Value,
    /// The row value added.
    pub term: Value,
    /// The vector of the row's first group.
    pub first: Slot,
    /// The vector added to it.
    pub fraction: Slot,
}

/// A vector that the loop reads or accumulates into.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Home {
    /// Its slot in the record.
    pub slot: Slot,
    /// Whether a register holds it during a row's loop.
    pub register: bool,
}

/// The plan of one program.
pub(crate) struct Plan<'a> {
    pub program: &'a Program,
    /// The live pixel instructions, those of the pixel set first.
    pub pixels: Vec<Value>,
    /// Slots of pass and row values that another level reads as f64, by value.
    pub scalars: Vec<Option<Slot>>,
    /// Slots of pass values that rows read, for two rows at once, by value.
    pub pairs: Vec<Option<Slot>>,
    /// Vectors of pass and row values that pixel instructions read, by value.
    pub splats: Vec<Option<Home>>,
    /// The vector of each accumulator.
    pub accumulators: Vec<Home>,
    /// For each accumulator: the factors of a fused multiply-add.
    pub contractions: Vec<Option<(Value, Value)>>,
    /// Whether a value is such a product, which is not computed separately; by value.
    pub is_contracted: Vec<bool>,
    /// The f64 of each total.
    pub totals: Vec<Slot>,
    /// The offsets, in the order of `pixels`.
    pub offsets: Vec<ColumnOffset>,
    /// The first and the last pixel of a row, relative to the window; 64-bit integers.
    pub range: [Slot; 2],
    /// Address of a row's first pixel: of each plane that is read, by channel; of the output plane.
    pub rows: Vec<Option<Slot>>,
    pub target: Slot,
    /// The latest start of a row's last group, relative to the window; a 64-bit integer.
    pub furthest: Slot,
    /// The window's first and last column, as two f64 each.
    pub columns: [Slot; 2],
    /// Two vectors that pass lanes to elementary functions.
    pub operands: [Slot; 2],
    /// Bytes of each area.
    pub pass_bytes: u32,
    pub rows_bytes: u32,
}

struct Record {
    width: VectorWidth,
    pass_bytes: u32,
    rows_bytes: u32,
}

impl Record {
    fn take(&mut self, area: Area, bytes: u32) -> Slot {
        let (end, count) = match area {
            Area::Pass => (&mut self.pass_bytes, 1),
            Area::Rows => (&mut self.rows_bytes, 2),
        };
        let at = end.next_multiple_of(count * bytes);
        *end = at + count * bytes;
        Slot { area, offset: at as i32, bytes: bytes as i32 }
    }
    fn scalar(&mut self, area: Area) -> Slot {
        self.take(area, 8)
    }
    fn vector(&mut self, area: Area) -> Slot {
        self.take(area, self.width.bytes() as u32)
    }
}

/// The area of a pass or row value.
fn area(level: Level) -> Area {
    match level {
        Level::Row => Area::Rows,
        _ => Area::Pass,
    }
}

impl<'a> Plan<'a> {
    /// Plans for the registers of `width`. Sums get the registers that a group leaves free, then operands, the most read
    /// first: within 1 % of the fastest of a dozen splits, on each of four kernels of thesis-spot.
    pub fn new(program: &'a Program, width: VectorWidth) -> Plan<'a> {
        let count = program.instructions().len();
        let pixels = order(program);
        let mut record = Record { width, pass_bytes: 0, rows_bytes: 0 };

        let mut scalars = vec![None; count];
        let mut pairs = vec![None; count];
        for (reader, value) in scalar_reads(program) {
            let Instruction { level, op, .. } = *program.instruction(value);
            let constant = op.constant().is_some();
            if reader == Level::Row {
                if level == Level::Pass && !constant && pairs[value.index()].is_none() {
                    pairs[value.index()] = Some(record.vector(Area::Pass));
                }
            } else if level != reader && !constant && scalars[value.index()].is_none() {
                scalars[value.index()] = Some(record.scalar(area(level)));
            }
        }

        let mut reads = vec![0_usize; count];
        let instructions = pixels.iter().map(|v| program.instruction(*v));
        let operands = instructions.filter(|i| i.op.code != Opcode::Offset).flat_map(|i| i.op.operands());
        for value in operands.chain(sinks(program)) {
            if program.instruction(value).level != Level::Pixel {
                reads[value.index()] += 1;
            }
        }

        let sums = match program.sink() {
            Sink::Sums { accumulators, .. } => accumulators.len(),
            Sink::Plane(_) => 0,
        };
        let contractions = program.contractions();
        let mut is_contracted = vec![false; count];
        if let Sink::Sums { accumulators, .. } = program.sink() {
            let products = accumulators.iter().zip(&contractions).filter(|(_, factors)| factors.is_some());
            products.for_each(|(v, _)| is_contracted[v.index()] = true);
        }
        let calls = pixels.iter().any(|v| program.instruction(*v).op.is_call());
        let busy = busy_registers(program, &pixels) + if calls { FUNCTION_REGISTERS } else { 0 };
        let mut free = width.registers().saturating_sub(busy);
        let mut settle = |record: &mut Record, area: Area| {
            let register = free > 0;
            free = free.saturating_sub(1);
            Home { slot: record.vector(area), register }
        };
        let accumulators: Vec<Home> = (0..sums).map(|_| settle(&mut record, Area::Pass)).collect();
        let mut splats = vec![None; count];
        let mut by_reads: Vec<usize> = (0..count).filter(|i| reads[*i] > 0).collect();
        by_reads.sort_by_key(|i| std::cmp::Reverse(reads[*i]));
        for i in by_reads {
            splats[i] = Some(settle(&mut record, area(program.instructions()[i].level)));
        }

        let totals = match program.sink() {
            Sink::Sums { totals, .. } => totals.iter().map(|_| record.scalar(Area::Pass)).collect(),
            Sink::Plane(_) => Vec::new(),
        };
        let mut offsets = Vec::new();
        let mut rows = vec![None; program.channels()];
        for value in &pixels {
            match program.instruction(*value).op.parts() {
                (Opcode::Offset, &[term]) => {
                    let [first, fraction] = [record.vector(Area::Rows), record.vector(Area::Rows)];
                    offsets.push(ColumnOffset { value: *value, term, first, fraction });
                }
                (Opcode::Channel(channel), _) => rows[channel.index()] = Some(record.scalar(Area::Rows)),
                _ => {}
            }
        }
        let range = [record.scalar(Area::Rows), record.scalar(Area::Rows)];
        let target = record.scalar(Area::Rows);
        let furthest = record.scalar(Area::Pass);
        let columns = [record.vector(Area::Pass), record.vector(Area::Pass)];
        let operands = [record.vector(Area::Pass), record.vector(Area::Pass)];
        let [pass_bytes, rows_bytes] = [record.pass_bytes, record.rows_bytes].map(|bytes| bytes.next_multiple_of(32));
        Plan {
            program,
            pixels,
            scalars,
            pairs,
            splats,
            accumulators,
            contractions,
            is_contracted,
            totals,
            offsets,
            range,
            rows,
            target,
            furthest,
            columns,
            operands,
            pass_bytes,
            rows_bytes,
        }
    }

    /// Whether the program tests each pixel.
    pub fn is_masked(&self) -> bool {
        is_masked(self.program)
    }
}
