//! The loop over the columns of narrow windows: from eight prepared rows to their sums, an f64 per row.
//!
//! ```text
//! first and last columns ─► rows' addresses ─► tile ⟲ ─► column ⟲ ─► sums
//!                                              8 × 8 pixels turned, 8 × 16 at 512 bits; full or partial columns
//! ```
//! At 512 bits, programs that test each pixel have only partial columns.

use std::mem::offset_of;

use isophote_symbolic::Summation;

use super::group::{Fullness, LaneUse};
use super::narrow::{NarrowPlaces, SINGLE, STEP, STEPS_IN_COLUMN};
use super::pixels::plane;
use super::places::Homes;
use super::{Nest, order, sums};
use crate::abi::{Args, PlaneArgs};
use crate::options::ROWS;
use crate::vector::{Anchor, Condition, Integer, Integers, Label, MemoryPlace, Portion, arg};

/// Bytes of a cache line, and lines to prefetch per row: the hardware prefetches those behind.
const LINE_BYTES: usize = 64;
const LINES: usize = 2;
/// The first column of a tile, while tiles are transposed.
const PIXEL: Integer = Integer::E;

/// Stores the row addresses of each plane that is read.
fn open_rows(i: &mut Integers, places: &Homes, narrow: &NarrowPlaces, outer: usize) {
    use Integer::{A, B, C, D, E};
    let ways =
        [offset_of!(PlaneArgs, row_stride), offset_of!(PlaneArgs, slice_stride), offset_of!(PlaneArgs, volume_stride)];
    i.mov(C, arg(offset_of!(Args, planes)));
    for (channel, addresses) in narrow.addresses.iter().enumerate() {
        let Some(addresses) = addresses else { continue };
        let last = |axis: usize| arg(offset_of!(Args, last) + axis * size_of::<i64>());
        if outer == 1 {
            i.mov(E, places.counters.row);
            i.plus(E, Integer::Block);
            i.mov(B, last(0));
        }
        for row in 0..ROWS {
            i.mov(D, plane(C, channel, offset_of!(PlaneArgs, first)));
            for (axis, way) in ways.into_iter().enumerate().take(outer) {
                if outer == 1 {
                    i.mov(A, E);
                } else {
                    i.mov(A, places.inside[axis].plus(8 * row).indexed(Integer::Block, 8));
                    i.mov(B, last(axis));
                }
                i.at_most(A, B);
                i.times(A, plane(C, channel, way));
                i.plus(D, A);
            }
            i.store(addresses.plus(8 * row), D);
            if outer == 1 {
                // The same row of the next block, which the hardware prefetcher cannot predict.
                i.mov(A, plane(C, channel, offset_of!(PlaneArgs, row_stride)));
                let next = MemoryPlace::new(Anchor::At(D), 0).indexed(A, ROWS as u32);
                (0..LINES).for_each(|line| i.fetch(next.plus(line * LINE_BYTES)));
            }
            if outer == 1 && row + 1 < ROWS {
                i.plus(E, 1);
            }
        }
    }
}

impl Nest<'_> {
    /// Stores how many rows are prepared together: several blocks for a narrow window, if it has enough rows.
    pub fn together(&mut self) {
        use Integer::A;
        let [wide, fewer] = std::array::from_fn(|_| self.code.new_label());
        self.unless_narrow(wide);
        let (counters, most) = (self.places.counters, self.places.blocks * ROWS);
        self.code.write(|i| {
            i.mov(A, counters.rows);
            i.minus(A, counters.row);
            i.jump_if(A, Condition::AtMost, most as i32, fewer);
            i.mov(A, most as i32);
            i.label(fewer);
            i.store(counters.together, A);
            i.label(wide);
        });
    }

    /// Jumps to `wide` unless the window is narrow.
    pub fn unless_narrow(&mut self, wide: Label) {
        let rows = self.places.counters.rows;
        let columns = self.places.narrow.as_ref().map_or(0, NarrowPlaces::columns);
        self.code.write(|i| {
            i.mov(Integer::A, arg(offset_of!(Args, width)));
            i.jump_if(Integer::A, Condition::More, columns as i32, wide);
            i.mov(Integer::A, rows);
            i.jump_if(Integer::A, Condition::Less, Summation::NARROW_ROWS_MIN as i32, wide);
        });
    }

    /// Processes a block of rows, column by column, and its sums.
    pub fn narrow(&mut self) {
        let Some(narrow) = self.places.narrow.clone() else { return };
        let [tile, turned, full, partial, done] = std::array::from_fn(|_| self.code.new_label());
        self.block(0, |block, _| narrow.prepare(block));
        self.code.write(|i| open_rows(i, &self.places, &narrow, self.outer));
        let pixels = ROWS * narrow.lanes;
        let [first, last] = [0, 4].map(|at| narrow.edges.plus(at));
        let end = (narrow.columns() * STEPS_IN_COLUMN) as i32;
        let [begun, ended, all_from, all_until] = [0, 4, 8, 12].map(|at| narrow.limits.plus(at));
        self.code.write(|i| {
            i.mov_low(PIXEL, first);
            i.label(tile);
            i.jump_if_low(PIXEL, Condition::AtLeast, last, turned);
            i.mov(Integer::Begin, PIXEL);
            i.at_most(Integer::Begin, Integer::Furthest);
            i.mov(STEP, Integer::Begin);
            i.scaled(STEP, STEP, STEPS_IN_COLUMN as i32);
            // A tile always starts before the last column; the comparison proves it to the verifier.
            i.jump_if(STEP, Condition::NotBelow, end, turned);
        });
        let options = self.options;
        self.block(0, |block, _| narrow.turn(block, options, Integer::Begin));
        self.code.write(|i| {
            i.plus(PIXEL, pixels as i32);
            i.jump(tile);
            i.label(turned);
        });
        self.fetch_rows(&narrow);
        let has_full = self.pixels.has_full_groups();
        self.code.write(|i| {
            i.mov_low(STEP, begun);
            // Likewise for a step.
            i.jump_if(STEP, Condition::NotBelow, end, done);
            if has_full {
                i.jump_if_low(STEP, Condition::Below, all_from, partial);
                i.jump_if_low(STEP, Condition::NotBelow, all_until, partial);
                i.label(full);
            }
        });
        if has_full {
            self.step(&narrow, Fullness::Full { otherwise: partial });
            self.code.write(|i| {
                i.jump_if(STEP, Condition::NotBelow, end, done);
                i.jump_if_low(STEP, Condition::Below, all_until, full);
                i.jump_if_low(STEP, Condition::NotBelow, ended, done);
            });
        }
        self.code.write(|i| i.label(partial));
        self.step(&narrow, Fullness::Partial);
        self.code.write(|i| {
            i.jump_if(STEP, Condition::NotBelow, end, done);
            i.jump_if_low(STEP, Condition::NotBelow, ended, done);
            if has_full {
                i.jump_if_low(STEP, Condition::Below, all_from, partial);
                i.jump_if_low(STEP, Condition::Below, all_until, full);
            }
            i.jump(partial);
            i.label(done);
        });
        self.leave_narrow_sums(&narrow);
    }

    /// Writes a step, and the advance to the next.
    fn step(&mut self, narrow: &NarrowPlaces, fullness: Fullness) {
        self.pixels.write(LaneUse::Across, fullness, &self.places, &mut self.code);
        self.pixels.advance(&[(None, narrow.along)], narrow.lanes, &self.places, &mut self.code);
        self.code.write(|i| i.plus(STEP, (narrow.lanes * STEPS_IN_COLUMN) as i32));
    }

    /// Loads the residents of the loop, and zeroes its sums.
    fn fetch_rows(&mut self, narrow: &NarrowPlaces) {
        self.block(self.places.reserved, |block, places| {
            let fractions = places.columns.iter().map(|column| narrow.fraction(column));
            for held in narrow.shown.iter().copied().flatten().chain(fractions).chain([narrow.along]) {
                if held.register.is_some() {
                    let value = block.kept(held.memory);
                    block.set(SINGLE, held, value);
                }
            }
            let zero = block.number(SINGLE, 0.0);
            block.store(SINGLE, Portion::Whole, zero, narrow.unused);
            (0..narrow.sums.len()).for_each(|sum| block.set(SINGLE, narrow.accumulator(places, sum), zero));
        });
    }

    /// Stores the sums of the rows, and their counts.
    fn leave_narrow_sums(&mut self, narrow: &NarrowPlaces) {
        self.block(self.places.reserved, |block, places| {
            for held in (0..narrow.sums.len()).map(|sum| narrow.accumulator(places, sum)) {
                if held.register.is_some() {
                    let sum = block.held(held);
                    block.store(SINGLE, Portion::Whole, sum, held.memory);
                }
            }
        });
        sums::of_lanes(self.options, &self.places, &mut self.code);
        if order::is_masked(self.program) {
            let (counts, pixels) = (self.places.counts, self.places.counters.pixels);
            self.block(0, |block, _| narrow.count(block, counts.indexed(Integer::Block, size_of::<i32>() as u32)));
            self.code.write(|i| {
                i.mov(Integer::B, pixels);
                for row in 0..ROWS {
                    i.mov_low(
                        Integer::A,
                        counts.plus(size_of::<i32>() * row).indexed(Integer::Block, size_of::<i32>() as u32),
                    );
                    i.plus(Integer::B, Integer::A);
                }
                i.store(pixels, Integer::B);
            });
        }
    }
}
