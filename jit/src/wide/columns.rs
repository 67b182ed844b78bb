//! The loop over the columns of narrow windows: from eight prepared rows to their sums, an f64 per row.
//!
//! ```text
//! first and last columns ─► rows' addresses ─► tile ⟲ ─► column ⟲ ─► sums
//!                                              8 × 8 pixels turned, 8 × 16 at 512 bits; full or partial columns
//! ```
//! At 512 bits, programs that test each pixel have only partial columns.

use std::mem::offset_of;

use iced_x86::{Code, Instruction, Register};
use isophote_symbolic::Summation;

use super::acts::allocate;
use super::assembler::{Anchor, Instructions, Label, MemoryPlace};
use super::block::{Block, Resident};
use super::calls::arg;
use super::group::{Fullness, LaneUse};
use super::narrow::{NarrowPlaces, SINGLE, STEP, STEPS_IN_COLUMN};
use super::nest::{FREE, Nest};
use super::operation::Portion;
use super::pixels::{BEGIN, FURTHEST, plane};
use super::places::{BLOCK, Homes, ROWS};
use super::sums;
use crate::abi::{Args, PlaneArgs};
use crate::plan;

/// Bytes of a cache line, and lines to prefetch per row: the hardware prefetches those behind.
const LINE_BYTES: usize = 64;
const LINES: usize = 2;
const STEP_LOW: Register = Register::R14D;
/// The register with the first column of a tile, while tiles are transposed.
const PIXEL: Register = Register::RDI;
const PIXEL_LOW: Register = Register::EDI;

/// Stores the row addresses of each plane that is read.
fn open_rows(i: &mut Instructions, places: &Homes, narrow: &NarrowPlaces, outer: usize) {
    use Register::{RAX, RCX, RDI, RDX, RSI};
    let ways =
        [offset_of!(PlaneArgs, row_stride), offset_of!(PlaneArgs, slice_stride), offset_of!(PlaneArgs, volume_stride)];
    i.mov(RDX, arg(offset_of!(Args, planes)));
    for (channel, addresses) in narrow.addresses.iter().enumerate() {
        let Some(addresses) = addresses else { continue };
        let last = |axis: usize| arg(offset_of!(Args, last) + axis * size_of::<i64>());
        if outer == 1 {
            i.mov(RDI, places.counters.row);
            i.plus(RDI, BLOCK);
            i.mov(RCX, last(0));
        }
        for row in 0..ROWS {
            i.mov(RSI, plane(RDX, channel, offset_of!(PlaneArgs, first)));
            for (axis, way) in ways.into_iter().enumerate().take(outer) {
                if outer == 1 {
                    i.mov(RAX, RDI);
                } else {
                    i.mov(RAX, places.inside[axis].plus(8 * row).indexed(BLOCK, 8));
                    i.mov(RCX, last(axis));
                }
                i.at_most(RAX, RCX);
                i.times(RAX, plane(RDX, channel, way));
                i.plus(RSI, RAX);
            }
            i.store(addresses.plus(8 * row), RSI);
            if outer == 1 {
                // The same row of the next block, which the hardware prefetcher cannot predict.
                i.mov(RAX, plane(RDX, channel, offset_of!(PlaneArgs, row_stride)));
                let next = MemoryPlace::new(Anchor::At(RSI), 0).indexed(RAX, ROWS as u32);
                (0..LINES).for_each(|line| i.fetch(next.plus(line * LINE_BYTES)));
            }
            if outer == 1 && row + 1 < ROWS {
                i.plus(RDI, 1);
            }
        }
    }
}

impl Nest<'_> {
    /// Stores how many rows are prepared together: several blocks for a narrow window, if it has enough rows.
    pub fn together(&mut self) {
        use Register::RAX;
        let [wide, fewer] = std::array::from_fn(|_| self.assembler.new_label());
        self.unless_narrow(wide);
        let (counters, most) = (self.places.counters, self.places.blocks * ROWS);
        self.assembler.write(|i| {
            i.mov(RAX, counters.rows);
            i.minus(RAX, counters.row);
            i.compare(RAX, most as i32);
            i.jump(Code::Jle_rel32_64, fewer);
            i.mov(RAX, most as i32);
            i.label(fewer);
            i.store(counters.together, RAX);
            i.label(wide);
        });
    }

    /// Jumps to `wide` unless the window is narrow.
    pub fn unless_narrow(&mut self, wide: Label) {
        let rows = self.places.counters.rows;
        let columns = self.places.narrow.as_ref().map_or(0, NarrowPlaces::columns);
        self.assembler.write(|i| {
            i.mov(Register::RAX, arg(offset_of!(Args, width)));
            i.compare(Register::RAX, columns as i32);
            i.jump(Code::Jg_rel32_64, wide);
            i.mov(Register::RAX, rows);
            i.compare(Register::RAX, Summation::NARROW_ROWS_MIN as i32);
            i.jump(Code::Jl_rel32_64, wide);
        });
    }

    /// Processes a block of rows, column by column, and its sums.
    pub fn narrow(&mut self) {
        let Some(narrow) = self.places.narrow.clone() else { return };
        let [tile, turned, full, partial, done] = std::array::from_fn(|_| self.assembler.new_label());
        self.across(|block| narrow.prepare(block));
        self.assembler.write(|i| open_rows(i, &self.places, &narrow, self.outer));
        let pixels = ROWS * narrow.lanes;
        let [first, last] = [0, 4].map(|at| narrow.edges.plus(at));
        let end = (narrow.columns() * STEPS_IN_COLUMN) as i32;
        let [begun, ended, all_from, all_until] = [0, 4, 8, 12].map(|at| narrow.limits.plus(at));
        self.assembler.write(|i| {
            i.mov_low(PIXEL_LOW, first);
            i.label(tile);
            i.compare_low(PIXEL_LOW, last);
            i.jump(Code::Jge_rel32_64, turned);
            i.mov(BEGIN, PIXEL);
            i.at_most(BEGIN, FURTHEST);
            i.add(Instruction::with2(Code::Mov_r32_rm32, STEP_LOW, Register::R13D));
            i.scaled(STEP, STEP, STEPS_IN_COLUMN as i32);
            // A tile always starts before the last column; the comparison proves it to the verifier.
            i.compare(STEP, end);
            i.jump(Code::Jae_rel32_64, turned);
        });
        let options = self.options;
        self.across(|block| narrow.turn(block, options, BEGIN));
        self.assembler.write(|i| {
            i.plus(PIXEL, pixels as i32);
            i.jump(Code::Jmp_rel32_64, tile);
            i.label(turned);
        });
        self.fetch_rows(&narrow);
        let has_full = self.pixels.has_full_groups();
        self.assembler.write(|i| {
            i.mov_low(STEP_LOW, begun);
            // Likewise for a step.
            i.compare(STEP, end);
            i.jump(Code::Jae_rel32_64, done);
            if has_full {
                i.compare_low(STEP_LOW, all_from);
                i.jump(Code::Jb_rel32_64, partial);
                i.compare_low(STEP_LOW, all_until);
                i.jump(Code::Jae_rel32_64, partial);
                i.label(full);
            }
        });
        if has_full {
            self.step(&narrow, Fullness::Full { otherwise: partial });
            self.assembler.write(|i| {
                i.compare(STEP, end);
                i.jump(Code::Jae_rel32_64, done);
                i.compare_low(STEP_LOW, all_until);
                i.jump(Code::Jb_rel32_64, full);
                i.compare_low(STEP_LOW, ended);
                i.jump(Code::Jae_rel32_64, done);
            });
        }
        self.assembler.write(|i| i.label(partial));
        self.step(&narrow, Fullness::Partial);
        self.assembler.write(|i| {
            i.compare(STEP, end);
            i.jump(Code::Jae_rel32_64, done);
            i.compare_low(STEP_LOW, ended);
            i.jump(Code::Jae_rel32_64, done);
            if has_full {
                i.compare_low(STEP_LOW, all_from);
                i.jump(Code::Jb_rel32_64, partial);
                i.compare_low(STEP_LOW, all_until);
                i.jump(Code::Jb_rel32_64, full);
            }
            i.jump(Code::Jmp_rel32_64, partial);
            i.label(done);
        });
        self.leave_sums(&narrow);
    }

    /// Writes a step, and the advance to the next.
    fn step(&mut self, narrow: &NarrowPlaces, fullness: Fullness) {
        self.pixels.write(LaneUse::Across, fullness, &mut self.places, &mut self.assembler);
        self.pixels.advance(&[(None, narrow.along)], narrow.lanes, &mut self.places, &mut self.assembler);
        self.assembler.write(|i| i.plus(STEP, (narrow.lanes * STEPS_IN_COLUMN) as i32));
    }

    /// Writes vector code between the loops.
    fn across(&mut self, write: impl FnOnce(&mut Block<'_>)) {
        let mut block = Block::new(&mut self.assembler, self.options.width);
        write(&mut block);
        allocate(block, &mut self.places.frame, 0);
    }

    /// Loads the registers of the loop, and zeroes its sums.
    fn fetch_rows(&mut self, narrow: &NarrowPlaces) {
        let fractions: Vec<Resident> = self.places.columns.iter().map(|column| narrow.fraction(column)).collect();
        for held in narrow.shown.iter().copied().flatten().chain(fractions).chain([narrow.along]) {
            if let Some(register) = held.register {
                self.read_register(register, held.memory, SINGLE);
            }
        }
        self.zero(FREE);
        if plan::is_masked(self.program) {
            self.write_register(FREE, Portion::Whole, narrow.unused);
        }
        for sum in 0..narrow.sums.len() {
            let held = narrow.accumulator(&self.places, sum);
            match held.register {
                Some(register) => self.zero(register),
                None => self.write_register(FREE, Portion::Whole, held.memory),
            }
        }
    }

    /// Stores the sums of the rows, and their counts.
    fn leave_sums(&mut self, narrow: &NarrowPlaces) {
        for sum in 0..narrow.sums.len() {
            let held = narrow.accumulator(&self.places, sum);
            if let Some(register) = held.register {
                self.write_register(register, Portion::Whole, held.memory);
            }
        }
        sums::of_lanes(self.options, &mut self.places, &mut self.assembler);
        if plan::is_masked(self.program) {
            let (counts, pixels) = (self.places.counts, self.places.counters.pixels);
            self.across(|block| narrow.count(block, counts.indexed(BLOCK, size_of::<i32>() as u32)));
            self.assembler.write(|i| {
                i.mov(Register::RCX, pixels);
                for row in 0..ROWS {
                    i.mov_low(
                        Register::EAX,
                        counts.plus(size_of::<i32>() * row).indexed(BLOCK, size_of::<i32>() as u32),
                    );
                    i.plus(Register::RCX, Register::RAX);
                }
                i.store(pixels, Register::RCX);
            });
        }
    }
}
