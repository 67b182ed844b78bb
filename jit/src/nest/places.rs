//! Assigns every value of a program to the frame, and some values of the pixel loop to registers.
//!
//! Rows are prepared in an f64 lane each; the pixel loop reads a row's values from arrays with an element per row.

use isophote_symbolic::{Level, Opcode, Precision, Program, Sink, Value};

use super::functions::Evaluation;
use super::narrow::{AlongRows, NarrowPlaces};
use super::order;
use crate::options::{KernelOptions, ROWS, VectorWidth};
use crate::vector::{Element, Integer, MemoryPlace, Resident, StackFrame};

/// Blocks of rows prepared and finished together in narrow windows, so that none waits for the other.
const BLOCKS: usize = 4;
/// Maximum bytes of a frame for which that pays, since it stays in cache. Larger programs prepare one block at a time.
const FRAME_FOR_BLOCKS_MAX: usize = 48 << 10;

/// A pass or row value as the pixel loop reads it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Broadcast {
    /// The location that the pixel loop reads.
    pub held: Resident,
    /// Row values only: an element per prepared row, and the stride in bytes.
    pub array: Option<(MemoryPlace, u32)>,
}

/// The inner coordinate plus a row value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    /// The `Opcode::Offset`.
    pub value: Value,
    /// The row value added.
    pub term: Value,
    /// An element per row: the offset of the first pixel, rounded down.
    pub first: MemoryPlace,
    /// The fraction added to it.
    pub fraction: Broadcast,
    /// The variable that runs along the row.
    pub running: Resident,
}

/// Vectors of f64 that hold a number of each row of a block.
pub(super) fn parts(width: VectorWidth) -> usize {
    width.rows() * Element::Double.bytes() / width.bytes()
}

/// Location of a plane's row address during the row's loop.
#[derive(Clone, Copy, Debug)]
pub(super) enum RowAddress {
    Variable(Integer),
    Memory(MemoryPlace),
}

/// Maximum row addresses in variables.
const ADDRESSES_MAX: u8 = 4;

/// Values of the window, each an f64 in all lanes.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowPlaces {
    /// Its first and last column.
    pub first: MemoryPlace,
    pub last: MemoryPlace,
    /// Its first row, and its number of rows.
    pub y: MemoryPlace,
    pub rows: MemoryPlace,
    /// The latest start of a group, from the first column.
    pub furthest: MemoryPlace,
}

/// 64-bit counters of the loops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counters {
    /// Rows before the prepared ones, all rows.
    pub row: MemoryPlace,
    pub rows: MemoryPlace,
    /// Rows before the current block; rows prepared together.
    pub at: MemoryPlace,
    pub together: MemoryPlace,
    /// Position of the next row: y, z, w relative to the window. For three coordinates or more.
    pub next: [MemoryPlace; 3],
    /// The start of the row's last full group, if it has one.
    pub last_full: MemoryPlace,
    /// The row's pixels, and those left out, if the program tests each pixel.
    pub wanted: MemoryPlace,
    pub unused: MemoryPlace,
    /// Of the pass.
    pub pixels: MemoryPlace,
    pub saturated: MemoryPlace,
    /// Two 32-bit integers of a group, if the program tests each pixel: the pixels by which it starts early, and where the row
    /// ends.
    pub before: MemoryPlace,
    pub until: MemoryPlace,
}

/// The storage of one program.
pub(super) struct Homes {
    pub frame: StackFrame,
    /// Values that another level outside the pixel loop reads: vectors of f64.
    pub doubles: Vec<Option<MemoryPlace>>,
    /// Values that the pixel loop reads.
    pub shown: Vec<Option<Broadcast>>,
    pub columns: Vec<Column>,
    pub accumulators: Vec<Resident>,
    /// The sums of each accumulator: a vector per row. Those of a row are contiguous, so that sums added to in turn lie in
    /// different sets of the cache.
    pub sums: Vec<MemoryPlace>,
    /// Whether integer variables survive a row's loop.
    pub keeps_integers: bool,
    /// The sums as f64, with the lanes of each row added: an f64 per row.
    pub row_sums: Vec<MemoryPlace>,
    /// Totals of the pass: an f64 for each row of a block.
    pub totals: Vec<MemoryPlace>,
    /// Final totals of the pass: one f64 each, in whole vectors.
    pub pass_totals: Vec<MemoryPlace>,
    /// Of each prepared row: first and last pixel, and the first beyond the full groups (64 bits each).
    pub starts: MemoryPlace,
    pub ends: MemoryPlace,
    pub rests: MemoryPlace,
    /// Their used pixels: 32 bits if the program tests each pixel, else f64.
    pub counts: MemoryPlace,
    /// The pixels by which their last group starts early, and where it ends: elements of the pixel loop, unless the program
    /// tests each pixel.
    pub before: MemoryPlace,
    pub until: MemoryPlace,
    /// For three coordinates or more: their position in the window (64 bits), and in the image (32 bits).
    pub inside: [MemoryPlace; 3],
    pub coordinates: [MemoryPlace; 3],
    pub window: WindowPlaces,
    /// Pixels used so far, a 64-bit number for each row of a block, unless the program tests each pixel.
    pub taken: MemoryPlace,
    pub counters: Counters,
    /// The row address of each plane that is read, and of the output plane.
    pub rows: Vec<Option<RowAddress>>,
    pub target: MemoryPlace,
    /// A buffer for gathered pixels.
    pub gathered: MemoryPlace,
    /// Maximum blocks prepared together.
    pub blocks: usize,
    /// Storage of the loop over the columns of narrow windows, if there is one.
    pub narrow: Option<NarrowPlaces>,
    /// Registers in use throughout a row's loop, as bits.
    pub reserved: u32,
}

/// Minimum registers for acts.
const FREE_MIN: usize = 7;
/// Maximum offsets that run in registers.
const RUNNING_MAX: usize = 4;

/// Allocates registers for the loop, from the last one down.
struct Pins {
    left: usize,
    next: u8,
    reserved: u32,
}

impl Pins {
    fn take(&mut self) -> Option<u8> {
        self.left = self.left.checked_sub(1)?;
        self.next -= 1;
        self.reserved |= 1 << self.next;
        Some(self.next)
    }
}

impl Homes {
    pub fn new(program: &Program, options: &KernelOptions, pixels: &[Value], functions: Evaluation) -> Homes {
        let places = |blocks| Homes::of_blocks(blocks, program, options, pixels, functions);
        match NarrowPlaces::are_for(program, options) {
            true => Some(places(BLOCKS))
                .filter(|all| all.frame.bytes() <= FRAME_FOR_BLOCKS_MAX)
                .unwrap_or_else(|| places(1)),
            false => places(ROWS / options.width.rows()),
        }
    }

    fn of_blocks(
        blocks: usize,
        program: &Program,
        options: &KernelOptions,
        pixels: &[Value],
        functions: Evaluation,
    ) -> Homes {
        let (count, width) = (program.instructions().len(), options.width);
        let (vector, element) = (width.bytes(), element(options.precision));
        let has_narrow = NarrowPlaces::are_for(program, options);
        // Elements of the pixel loop; a loop over columns needs a whole vector per block.
        let row_bytes = if has_narrow { blocks * vector } else { ROWS * element.bytes() };
        let mut frame = StackFrame::default();
        let mut doubles = vec![None; count];
        for (reader, value) in order::scalar_reads(program) {
            let instruction = program.instruction(value);
            if instruction.level != reader && instruction.op.constant().is_none() {
                let parts = if instruction.level == Level::Row { blocks * parts(width) } else { 1 };
                doubles[value.index()].get_or_insert_with(|| frame.take(parts * vector, vector));
            }
        }

        let is_call = |v: &Value| program.instruction(*v).op.is_call();
        let calls = functions.is_inlined && pixels.iter().any(is_call);
        let working = if calls { order::FUNCTION_REGISTERS } else { 0 };
        let busy = (order::busy_registers(program, pixels) + working).max(FREE_MIN);
        let registers = width.registers();
        let mut pins = Pins { left: registers.saturating_sub(busy), next: registers as u8, reserved: 0 };

        let is_offset = |v: &&Value| program.instruction(**v).op.code == Opcode::Offset;
        let offsets = pixels.iter().filter(is_offset).count();
        // `busy` includes them.
        pins.left += if offsets <= RUNNING_MAX { offsets } else { 0 };
        let mut columns = Vec::new();
        for value in pixels.iter().filter(is_offset) {
            let &[term] = program.instruction(*value).op.parts().1 else { continue };
            let [first, array] = [(); 2].map(|()| frame.take(row_bytes, vector));
            let register = if offsets <= RUNNING_MAX { pins.take() } else { None };
            let running = Resident { register, memory: frame.take(vector, vector) };
            let held = Resident { register: None, memory: Homes::of_row(&mut frame, array, element.bytes(), width) };
            let fraction = Broadcast { held, array: Some((array, element.bytes() as u32)) };
            columns.push(Column { value: *value, term, first, fraction, running });
        }

        let (sums, totals) = match program.sink() {
            Sink::Sums { accumulators, totals, .. } => (accumulators.len(), totals.len()),
            Sink::Plane(_) => (0, 0),
        };
        // Calls change general registers.
        let keeps_integers = width == VectorWidth::Bits128 || !pixels.iter().any(is_call);
        let all_sums = frame.take(sums * ROWS * vector, vector);
        let sums: Vec<MemoryPlace> = (0..sums).map(|sum| all_sums.plus(sum * vector)).collect();
        let accumulators = sums
            .iter()
            .map(|sums| {
                // Its place at the row's end, if the register with the index survives; at 128 bits, a place without an index is
                // an operand of more instructions.
                let is_there = keeps_integers && width != VectorWidth::Bits128;
                let memory = if is_there { sums.indexed(Integer::Sum, 8) } else { frame.take(vector, vector) };
                Resident { register: pins.take(), memory }
            })
            .collect();
        for column in &mut columns {
            column.fraction.held.register = pins.take();
        }
        let mut reads = vec![0_usize; count];
        let instructions = pixels.iter().map(|v| program.instruction(*v));
        let operands = instructions.filter(|i| i.op.code != Opcode::Offset).flat_map(|i| i.op.operands());
        operands.chain(order::sinks(program)).for_each(|v| reads[v.index()] += 1);
        let outer = |i: &usize| {
            let instruction = program.instructions()[*i];
            reads[*i] > 0 && instruction.level != Level::Pixel && instruction.op.constant().is_none()
        };
        let mut by_reads: Vec<usize> = (0..count).filter(outer).collect();
        by_reads.sort_by_key(|i| std::cmp::Reverse(reads[*i]));
        let mut shown = vec![None; count];
        for i in by_reads {
            let is_truth = program.is_truth(Value(i as u32));
            let register = pins.take();
            shown[i] = Some(match program.instructions()[i].level {
                Level::Row => {
                    // Truth values of rows stay as wide as f64.
                    let stride = if is_truth { Element::Double.bytes() } else { element.bytes() };
                    let array = frame.take(row_bytes.max(blocks * width.rows() * stride), vector);
                    let memory = Homes::of_row(&mut frame, array, stride, width);
                    Broadcast { held: Resident { register, memory }, array: Some((array, stride as u32)) }
                }
                _ if width == VectorWidth::Bits512 => {
                    let memory = frame.take(element.bytes(), element.bytes()).spread();
                    Broadcast { held: Resident { register, memory }, array: None }
                }
                _ => Broadcast { held: Resident { register, memory: frame.take(vector, vector) }, array: None },
            });
        }

        let mut addresses = (0..ADDRESSES_MAX).map(Integer::Address);
        let mut channels = vec![None; program.channels()];
        for value in pixels {
            if let Opcode::Channel(channel) = program.instruction(*value).op.code {
                let variable = if keeps_integers { addresses.next() } else { None };
                let address = |frame: &mut StackFrame| match variable {
                    Some(variable) => RowAddress::Variable(variable),
                    None => RowAddress::Memory(frame.scalar()),
                };
                channels[channel.index()].get_or_insert_with(|| address(&mut frame));
            }
        }
        let [of_64, of_32] =
            [8, 4].map(|bytes| move |frame: &mut StackFrame| frame.take(blocks * width.rows() * bytes, vector));
        let lanes = vector / Element::Double.bytes();
        let row_sums = sums.iter().map(|_| of_64(&mut frame)).collect();
        let of_rows = (0..totals).map(|_| of_64(&mut frame)).collect();
        let pass_totals: Vec<MemoryPlace> = (0..totals.div_ceil(lanes))
            .map(|_| frame.take(vector, vector))
            .flat_map(|place| (0..lanes).map(move |lane| place.plus(lane * Element::Double.bytes())))
            .collect();
        let along = AlongRows { shown: &shown, columns: &columns, sums: &sums, rows: &channels };
        let narrow = has_narrow.then(|| NarrowPlaces::new(program, &mut frame, (width, blocks), along));
        let mut scalar = || frame.scalar();
        let counters = Counters {
            row: scalar(),
            rows: scalar(),
            at: scalar(),
            together: scalar(),
            next: std::array::from_fn(|_| scalar()),
            last_full: scalar(),
            wanted: scalar(),
            unused: scalar(),
            pixels: scalar(),
            saturated: scalar(),
            before: scalar(),
            until: scalar(),
        };
        Homes {
            doubles,
            shown,
            columns,
            accumulators,
            sums,
            keeps_integers,
            row_sums,
            totals: of_rows,
            pass_totals,
            starts: of_64(&mut frame),
            ends: of_64(&mut frame),
            rests: of_64(&mut frame),
            counts: of_64(&mut frame),
            before: frame.take(row_bytes, vector),
            until: frame.take(row_bytes, vector),
            inside: std::array::from_fn(|_| of_64(&mut frame)),
            coordinates: std::array::from_fn(|_| of_32(&mut frame)),
            window: WindowPlaces {
                first: frame.take(vector, vector),
                last: frame.take(vector, vector),
                y: frame.take(vector, vector),
                rows: frame.take(vector, vector),
                furthest: frame.take(vector, vector),
            },
            taken: of_64(&mut frame),
            counters,
            rows: channels,
            target: frame.scalar(),
            gathered: frame.take(2 * vector, vector),
            blocks,
            narrow,
            reserved: pins.reserved,
            frame,
        }
    }

    /// The location of a row value for the pixel loop: at 512 bits the array's element, else a copy in all lanes.
    fn of_row(frame: &mut StackFrame, array: MemoryPlace, stride: usize, width: VectorWidth) -> MemoryPlace {
        match width {
            VectorWidth::Bits512 => array.indexed(Integer::Row, stride as u32).spread(),
            _ => frame.take(width.bytes(), width.bytes()),
        }
    }
}

/// The lane type of the pixel loop.
pub(super) fn element(precision: Precision) -> Element {
    match precision {
        Precision::F32 => Element::Single,
        Precision::F64 => Element::Double,
    }
}
