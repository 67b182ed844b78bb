//! Narrow windows, with rows in lanes: building blocks of the loop over their columns ([`super::columns`]).
//!
//! A short row costs more in overhead than in pixels; here eight rows share the overhead: their values are vectors as they
//! are, and their sums have lanes of their own.
//! A step is a column of all rows, at 512 bits two. It is full if all rows with pixels have it. In a full step, lanes of rows
//! without pixels compute values that the end of rows discards.

use isophote_symbolic::{Program, Sink, Summation, Value};

use super::places::{Broadcast, Column, Homes, RowAddress};
use crate::options::{KernelOptions, ROWS, VectorWidth};
use crate::vector::{
    Anchor, Block, Element, Id, Integer, MemoryPlace, Operation, Portion, Resident, StackFrame, comparison, pieces,
};

pub(super) const SINGLE: Element = Element::Single;
/// The byte offset of the current column, divided by eight.
pub(super) const STEP: Integer = Integer::Row;
pub(super) const STEPS_IN_COLUMN: usize = COLUMN_BYTES / 8;
/// Bytes of a column of a block.
const COLUMN_BYTES: usize = ROWS * size_of::<f32>();
/// Beyond the columns of any narrow window.
const FAR: f64 = (1 << 20) as f64;
/// Added to an f32 integer below 2²², it leaves the integer in the low bits.
const MAGIC: f32 = 12_582_912.0;

/// Storage of the loop over columns that the loop along rows lacks.
#[derive(Clone, Debug)]
pub(super) struct NarrowPlaces {
    /// First column of each row, and its number of columns, 0 and 0 if it has none: f32.
    pub starts: MemoryPlace,
    pub lengths: MemoryPlace,
    /// The current column, from each row's first.
    pub along: Resident,
    /// Four 32-bit integers, in columns: least start, greatest end, greatest start and least end of the rows.
    pub edges: MemoryPlace,
    /// The same as limits of all steps and of the full ones, in the unit of [`STEP`].
    pub limits: MemoryPlace,
    /// Negated counts of the pixels left out of each row.
    pub unused: MemoryPlace,
    /// By channel: addresses of the rows, and their transposed pixels as f32, column by column.
    pub addresses: Vec<Option<MemoryPlace>>,
    turned: Vec<Option<MemoryPlace>>,
    /// Pass and row values.
    pub shown: Vec<Option<Resident>>,
    /// Arrays of truth values, and the vectors made of them.
    truths: Vec<(MemoryPlace, MemoryPlace)>,
    pub sums: Vec<MemoryPlace>,
    /// Lanes per row.
    pub lanes: usize,
    /// Scale of [`Integer::Block`] in an array of vectors: a vector per eight rows.
    pitch: u32,
}

/// Storage of the loop along rows, whose registers are reused here.
pub(super) struct AlongRows<'h> {
    pub shown: &'h [Option<Broadcast>],
    pub columns: &'h [Column],
    pub sums: &'h [MemoryPlace],
    /// By channel.
    pub rows: &'h [Option<RowAddress>],
}

impl NarrowPlaces {
    /// Whether a kernel has the loop over columns.
    pub fn are_for(program: &Program, options: &KernelOptions) -> bool {
        options.summation().narrow.is_some() && matches!(program.sink(), Sink::Sums { .. })
    }

    pub fn new(
        program: &Program,
        frame: &mut StackFrame,
        (width, blocks): (VectorWidth, usize),
        along: AlongRows<'_>,
    ) -> NarrowPlaces {
        let AlongRows { shown, columns, sums, rows } = along;
        let vector = width.bytes();
        let pitch = vector as u32 / 8;
        let lanes = vector / SINGLE.bytes() / ROWS;
        let px_max = Summation::NARROW_PX_MAX * lanes;
        let [starts, lengths] = [(); 2].map(|()| frame.take(blocks * vector, vector));
        let mut take = || frame.take(vector, vector);
        let mut truths = Vec::new();
        let shown = shown
            .iter()
            .enumerate()
            .map(|(value, shown)| {
                let Broadcast { held, array } = (*shown)?;
                let Some((array, _)) = array else { return Some(held) };
                if !program.is_truth(Value(value as u32)) {
                    return Some(Resident { memory: array.indexed(Integer::Block, pitch), ..held });
                }
                let memory = take();
                truths.push((array, memory));
                Some(Resident { memory, ..held })
            })
            .collect();
        let register = columns.first().and_then(|column| column.running.register);
        NarrowPlaces {
            starts,
            lengths,
            along: Resident { register, memory: take() },
            edges: take(),
            limits: take(),
            unused: take(),
            shown,
            truths,
            sums: sums.to_vec(),
            lanes,
            addresses: rows.iter().map(|row| row.map(|_| frame.take(8 * ROWS, vector))).collect(),
            // The verifier cannot prove that columns are multiples of four units: slack after the last tile.
            turned: rows
                .iter()
                .map(|row| row.map(|_| frame.take(px_max * COLUMN_BYTES + ROWS * vector, vector)))
                .collect(),
            pitch,
        }
    }

    /// Maximum columns of a narrow window.
    pub fn columns(&self) -> usize {
        Summation::NARROW_PX_MAX * self.lanes
    }

    /// The vector of the current block.
    fn of_block(&self, array: MemoryPlace) -> MemoryPlace {
        array.indexed(Integer::Block, self.pitch)
    }

    /// Which lanes have a pixel at the current step.
    pub fn live(&self, block: &mut Block<'_>) -> Id {
        let along = block.variable(self.along);
        let from = block.number(SINGLE, 0.0);
        let lengths = block.kept(self.of_block(self.lengths));
        let begun = block.compute(Operation::Compare(comparison::AT_MOST), SINGLE, [from, along]);
        let not_ended = block.compute(Operation::Compare(comparison::LESS), SINGLE, [along, lengths]);
        block.compute(Operation::And, SINGLE, [begun, not_ended])
    }

    /// The pixels of the current step.
    pub fn pixels(&self, block: &mut Block<'_>, channel: usize) -> Id {
        let Some(turned) = self.turned[channel] else { unreachable!("every channel that is read has a place") };
        block.kept(turned.indexed(STEP, 8))
    }

    /// The inner coordinate plus a row value.
    pub fn offset(&self, block: &mut Block<'_>, column: &Column) -> Id {
        let first = block.kept(self.of_block(column.first));
        let along = block.variable(self.along);
        let here = block.compute(Operation::Add, SINGLE, [along, first]);
        let fraction = block.held(self.fraction(column));
        block.compute(Operation::Add, SINGLE, [here, fraction])
    }

    pub fn fraction(&self, column: &Column) -> Resident {
        let Some((array, _)) = column.fraction.array else { return column.fraction.held };
        Resident { memory: self.of_block(array), ..column.fraction.held }
    }

    /// Counts true lanes as left out.
    pub fn leave_out(&self, block: &mut Block<'_>, truth: Id) {
        // As an integer, true is −1.
        let before = block.fleeting(self.unused);
        let after = block.compute(Operation::AddBits, SINGLE, [truth, before]);
        block.store(SINGLE, Portion::Whole, after, self.unused);
    }

    /// The location of a sum. One processor takes a sixth longer to add to memory at a constant offset from rsp.
    pub fn accumulator(&self, places: &Homes, accumulator: usize) -> Resident {
        Resident { memory: self.sums[accumulator].indexed(Integer::Block, 8), ..places.accumulators[accumulator] }
    }

    /// Stores the columns at which rows start and end, see [`NarrowPlaces::edges`], and truth values as wide as pixels.
    pub fn prepare(&self, block: &mut Block<'_>) {
        use Operation::{Add, AddBits, And, AndNot, Compare, Firsts, FromIntegers, Highs, Lows, Max, Or};
        use Operation::{Pieces, Seconds, ShiftLeft, SpreadFirst, Sub, Xor};
        let b = &mut *block;
        let [starts, lengths] = [self.starts, self.lengths].map(|place| b.kept(self.of_block(place)));
        let [zero, far] = [0.0, FAR].map(|number| b.number(SINGLE, number));
        let sign = b.sign(SINGLE);
        let empty = b.compute(Compare(comparison::AT_MOST), SINGLE, [lengths, zero]);
        let far = b.compute(And, SINGLE, [empty, far]);
        let ends = b.compute(Add, SINGLE, [starts, lengths]);
        // Maxima of: −start, end, start, −end.
        let [first, last] = [starts, ends].map(|edge| {
            let edge = b.compute(Or, SINGLE, [edge, far]);
            b.compute(Xor, SINGLE, [edge, sign])
        });
        let [outer, inner] = [[first, ends], [starts, last]].map(|pair| {
            let [low, high] = [Lows, Highs].map(|half| b.compute(half, SINGLE, pair));
            b.compute(Max, SINGLE, [low, high])
        });
        let [low, high] = [Firsts, Seconds].map(|half| b.compute(half, Element::Double, [outer, inner]));
        let most = b.compute(Max, SINGLE, [low, high]);
        let second = if b.width == VectorWidth::Bits512 { pieces::EVERY_OTHER[1] } else { pieces::OF_TWO[1] };
        let rest = b.compute(Pieces(second), Element::Double, [most, most]);
        let most = b.compute(Max, SINGLE, [most, rest]);
        let signs = b.constant_lanes(SINGLE, |lane| if matches!(lane % 4, 0 | 3) { -0.0 } else { 0.0 });
        let edges = b.compute(Xor, SINGLE, [most, signs]);
        let edges = integers(b, edges);
        b.store(SINGLE, Portion::Half, edges, self.edges);
        let mut limits = edges;
        if self.lanes > 1 {
            // A step starts at an even column; a full one has both.
            let bits = |bits: [u32; 4]| move |lane: usize| f64::from(f32::from_bits(bits[lane % 4]));
            let up = b.constant_lanes(SINGLE, bits([0, 0, 1, 0]));
            limits = b.compute(AddBits, SINGLE, [limits, up]);
            let odd = b.constant_lanes(SINGLE, bits([1, 0, 1, 1]));
            limits = b.compute(AndNot, SINGLE, [odd, limits]);
        }
        let first = b.compute(SpreadFirst, SINGLE, [limits]);
        let first = b.compute(FromIntegers, SINGLE, [first]);
        let mut along = b.compute(Sub, SINGLE, [first, starts]);
        if self.lanes > 1 {
            let lanes = b.constant_lanes(SINGLE, |lane| (lane / ROWS) as f64);
            along = b.compute(Add, SINGLE, [along, lanes]);
        }
        b.store(SINGLE, Portion::Whole, along, self.along.memory);
        // Shifts two at a time, which are small.
        let limits = b.compute(ShiftLeft(STEPS_IN_COLUMN.ilog2() as u8), Element::Double, [limits]);
        b.store(SINGLE, Portion::Half, limits, self.limits);

        for (array, vector) in &self.truths {
            let of_width = b.width.bytes();
            let one = b.number(Element::Double, 1.0);
            let mut halves = (0..2).map(|part| {
                // At 512 bits eight rows are one vector, and their truth values are duplicated.
                let part = if of_width == VectorWidth::Bits512.bytes() { 0 } else { part };
                let truth = b.kept(array.plus(part * of_width).indexed(Integer::Block, 8));
                let ones = b.compute(And, Element::Double, [truth, one]);
                b.compute(Operation::Narrow, Element::Double, [ones])
            });
            let (Some(low), Some(high)) = (halves.next(), halves.next()) else { unreachable!("there are two") };
            drop(halves);
            let ones = b.compute(Operation::Join, SINGLE, [low, high]);
            let truth = b.compute(Compare(comparison::DIFFERENT), SINGLE, [ones, zero]);
            b.store(SINGLE, Portion::Whole, truth, *vector);
        }
    }

    /// Transposes the pixels of a tile, which starts at the column in a variable, and stores them.
    pub fn turn(&self, block: &mut Block<'_>, options: &KernelOptions, begin: Integer) {
        for (channel, (addresses, turned)) in self.addresses.iter().zip(&self.turned).enumerate() {
            let (Some(addresses), Some(turned)) = (addresses, turned) else { continue };
            let format = options.formats[channel];
            let bytes = format.bytes_per_pixel() as u32;
            let rows = std::array::from_fn(|row| {
                block.integers(|i| i.mov(Integer::A, addresses.plus(8 * row)));
                let memory = MemoryPlace::new(Anchor::At(Integer::A), 0).indexed(begin, bytes);
                block.converted(format, memory, options)
            });
            for (step, pixels) in block.columns_of(&rows).into_iter().enumerate() {
                let place = turned.plus(step * block.width.bytes()).indexed(STEP, 8);
                block.store(SINGLE, Portion::Whole, pixels, place);
            }
        }
    }

    /// Stores the used pixels of each row, if the program tests each pixel: 32 bits each.
    pub fn count(&self, block: &mut Block<'_>, counts: MemoryPlace) {
        let lengths = block.kept(self.of_block(self.lengths));
        let mut counted = integers(block, lengths);
        let unused = block.kept(self.unused);
        counted = block.compute(Operation::AddBits, SINGLE, [counted, unused]);
        let mut extent = Portion::Whole;
        if self.lanes > 1 {
            let upper = block.fleeting(self.unused.plus(block.width.bytes() / 2));
            let upper = block.compute(Operation::LoadHalf, SINGLE, [upper]);
            counted = block.compute(Operation::AddBits, SINGLE, [counted, upper]);
            extent = Portion::Half;
        }
        block.store(SINGLE, extent, counted, counts);
    }
}

/// Converts whole f32 numbers to 32-bit integers.
fn integers(block: &mut Block<'_>, numbers: Id) -> Id {
    let magic = block.number(SINGLE, MAGIC.into());
    let shifted = block.compute(Operation::Add, SINGLE, [numbers, magic]);
    let bits = block.constant_bytes(&0_u32.wrapping_sub(MAGIC.to_bits()).to_le_bytes());
    block.compute(Operation::AddBits, SINGLE, [shifted, bits])
}
