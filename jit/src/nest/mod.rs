//! The loop nest of a program, as vector code for any processor: from a [`Program`] to [`VectorCode`].
//!
//! ```text
//! entry ─► pass ─► rows' places ⟲ ─► row level ⟲ ─► row ─► full ⟲ ─► partial ─► sums ─► next row …
//!           ▲                                        │       └──────◄──┘                  │
//!           │                                        └── no pixels ──────────►────────────┤
//!           └───────────────────────── row ends, totals ⟲ ◄───────────────────────────────┘
//! ```
//! Eight rows are prepared together, by blocks of as many rows as the loops over rows take at once. Rows past the last one are
//! prepared as well, and have no pixels.
//!
//! Every level is vector code, with a pixel per lane in the pixel loop and a row per lane elsewhere, so that one selection of
//! operations serves them all.

mod across;
mod columns;
mod functions;
mod group;
mod narrow;
mod order;
mod outer;
mod pixels;
mod places;
mod select;
mod sums;
mod tables;

use std::mem::offset_of;

use isophote_symbolic::{Level, Program, Sink};

use self::group::{Fullness, LaneUse, PixelLoop};
use self::pixels::{open_row, open_target_row};
use self::places::{Broadcast, Homes, element, parts};
use crate::abi::Args;
use crate::options::{KernelOptions, ROWS, VectorWidth};
use crate::vector::{
    Block, Condition, Element, Integer, Label, MemoryPlace, Operation, Portion, StackFrame, VectorCode, arg,
};

/// Fields of the argument block with the window's start, by outer coordinate.
const FIRST: [usize; 3] = [offset_of!(Args, y), offset_of!(Args, z), offset_of!(Args, w)];
/// Fields of the argument block with the window's extent, by outer coordinate.
const COUNT: [usize; 3] = [offset_of!(Args, height), offset_of!(Args, depth), offset_of!(Args, length)];

/// The code of a program, and the stack frame that it uses.
pub(crate) fn code(program: &Program, options: &KernelOptions) -> (VectorCode, StackFrame) {
    let pixels = PixelLoop::new(program, options);
    let places = Homes::new(program, options, &pixels.order, pixels.evaluation);
    let outer = program.coordinates().clamp(2, 4) - 1;
    let mut nest = Nest { program, options, pixels, places, code: VectorCode::default(), outer };
    nest.body();
    (nest.code, nest.places.frame)
}

struct Nest<'p> {
    program: &'p Program,
    options: &'p KernelOptions,
    pixels: PixelLoop<'p>,
    places: Homes,
    code: VectorCode,
    /// Coordinates outside of the row.
    outer: usize,
}

impl Nest<'_> {
    fn level(&mut self, level: Level) {
        outer::write(level, self.program, self.options, &self.places, &mut self.code);
    }

    /// Writes a block that touches the vectors in `reserved` (bits) only as its residents.
    fn block(&mut self, reserved: u32, write: impl FnOnce(&mut Block<'_>, &Homes)) {
        let mut block = Block::new(&mut self.code.constants, self.options.width);
        write(&mut block, &self.places);
        let parts = block.into_parts();
        self.code.append(parts, reserved);
    }

    fn body(&mut self) {
        use Integer::{A, B};
        let counters = self.places.counters;
        let is_masked = order::is_masked(self.program);
        let [block, pass_end, row, rows_end, next] = std::array::from_fn(|_| self.code.new_label());
        let (outer, width) = (self.outer, self.options.width);
        self.code.write(|i| {
            i.mov(Integer::Furthest, arg(offset_of!(Args, furthest)));
            i.mov(A, arg(COUNT[0]));
            COUNT[1..outer].iter().for_each(|count| i.times(A, arg(*count)));
            i.store(counters.rows, A);
            i.mov(A, 0);
            let zeros = [counters.row, counters.pixels, counters.saturated];
            zeros.iter().chain(&counters.next).for_each(|place| i.store(*place, A));
        });
        self.block(0, |block, places| {
            let zero = block.number(Element::Double, 0.0);
            for place in places.totals.iter().chain([&places.taken]) {
                for part in 0..parts(width) {
                    block.store(Element::Double, Portion::Whole, zero, place.plus(part * width.bytes()));
                }
            }
        });
        self.level(Level::Pass);

        let [fewer, ended, wide] = std::array::from_fn(|_| self.code.new_label());
        self.code.write(|i| {
            i.label(block);
            i.mov(A, counters.row);
            i.jump_if(A, Condition::AtLeast, counters.rows, pass_end);
            i.mov(A, counters.rows);
            i.minus(A, counters.row);
            i.jump_if(A, Condition::AtMost, ROWS as i32, fewer);
            i.mov(A, ROWS as i32);
            i.label(fewer);
            i.store(counters.together, A);
        });
        if self.places.narrow.is_some() {
            self.together();
        }
        if outer > 1 {
            self.rows_places();
        }
        self.each_block(|nest| {
            let has_blocks = nest.places.blocks > 1;
            nest.code.write(|i| {
                i.mov(A, counters.row);
                if has_blocks {
                    i.plus(A, Integer::Block);
                }
                i.store(counters.at, A);
            });
            nest.level(Level::Row);
        });
        if self.places.narrow.is_some() {
            self.unless_narrow(wide);
            self.each_block(Nest::narrow);
            self.code.write(|i| {
                i.jump(ended);
                i.label(wide);
                i.mov(Integer::Block, 0);
            });
            outer::write_groups(self.program, self.options, &self.places, &mut self.code);
        }
        if is_masked {
            self.block(0, |block, places| {
                let zero = block.number(Element::Single, 0.0);
                // 32 bits per row.
                let extent = if parts(width) == 1 && width.rows() == ROWS { Portion::Half } else { Portion::Whole };
                for first in (0..ROWS * size_of::<u32>()).step_by(width.bytes()) {
                    block.store(Element::Single, extent, zero, places.counts.plus(first));
                }
            });
        }
        self.code.write(|i| {
            i.mov(Integer::Row, 0);
            i.label(row);
            i.jump_if(Integer::Row, Condition::NotBelow, ROWS as i32, rows_end);
            i.jump_if(Integer::Row, Condition::AtLeast, counters.together, rows_end);
        });
        self.row(next);
        self.code.write(|i| {
            i.label(next);
            i.plus(Integer::Row, 1);
            i.jump(row);
            i.label(rows_end);
        });
        if width != VectorWidth::Bits128 {
            sums::of_vectors(self.options, &self.places, &mut self.code);
        }
        self.code.write(|i| i.label(ended));
        if matches!(self.program.sink(), Sink::Sums { .. }) {
            self.each_block(|nest| nest.level(Level::RowEnd));
        }
        let taken = self.places.taken;
        self.code.write(|i| {
            i.mov(A, counters.together);
            i.plus_at(counters.row, A);
            i.jump(block);
            i.label(pass_end);
            i.mov(B, counters.pixels);
            (0..width.rows()).for_each(|row| i.plus(B, taken.plus(row * 8)));
            i.store(counters.pixels, B);
            i.store(arg(offset_of!(Args, pixels)), B);
            i.mov(A, counters.saturated);
            i.store(arg(offset_of!(Args, saturated)), A);
        });
        if width != VectorWidth::Bits128 {
            sums::of_pass(self.options, &self.places, &mut self.code);
        }
        self.level(Level::PassEnd);
    }

    /// Runs the code that `write` writes for each block of the prepared rows.
    fn each_block(&mut self, write: impl FnOnce(&mut Self)) {
        if self.places.blocks == 1 {
            self.code.write(|i| i.mov(Integer::Block, 0));
            return write(self);
        }
        let [again, behind] = std::array::from_fn(|_| self.code.new_label());
        let rows = self.options.width.rows() as i32;
        let (all, together) = (self.places.blocks as i32 * rows, self.places.counters.together);
        self.code.write(|i| {
            i.mov(Integer::Block, 0);
            i.label(again);
            // There never are more; the comparison proves it to the verifier.
            i.jump_if(Integer::Block, Condition::NotBelow, all, behind);
        });
        write(self);
        self.code.write(|i| {
            i.plus(Integer::Block, rows);
            i.jump_if(Integer::Block, Condition::Less, together, again);
            i.label(behind);
        });
    }

    /// Stores the positions of the prepared rows in the frame and advances past them; for three coordinates or more.
    fn rows_places(&mut self) {
        use Integer::{A, B};
        let [fill, filled, moved] = std::array::from_fn(|_| self.code.new_label());
        let Homes { counters, inside, coordinates, blocks, .. } = self.places;
        let (outer, rows) = (self.outer, blocks * self.options.width.rows());
        self.code.write(|i| {
            i.mov(Integer::Row, 0);
            i.label(fill);
            i.jump_if(Integer::Row, Condition::NotBelow, rows as i32, filled);
            for (axis, first) in FIRST.into_iter().enumerate().take(outer) {
                i.mov(A, counters.next[axis]);
                i.store(inside[axis].indexed(Integer::Row, 8), A);
                i.plus(A, arg(first));
                i.store_low(coordinates[axis].indexed(Integer::Row, 4), A);
            }
            // y counts up; a coordinate that reaches its end restarts and carries into the next.
            i.mov(B, 0);
            for (axis, count) in COUNT.into_iter().enumerate().take(outer) {
                i.mov(A, counters.next[axis]);
                i.plus(A, 1);
                i.store(counters.next[axis], A);
                if axis + 1 < outer {
                    i.jump_if(A, Condition::Less, arg(count), moved);
                    i.store(counters.next[axis], B);
                }
            }
            i.label(moved);
            i.plus(Integer::Row, 1);
            i.jump_if(Integer::Row, Condition::Less, counters.together, fill);
            i.label(filled);
        });
    }

    /// Processes a prepared row; jumps to `next` if it has no pixels.
    fn row(&mut self, next: Label) {
        use Integer::{A, B, Pixel, Row};
        let lanes = self.pixels.lanes() as i32;
        let [full, partial, group, row_end] = std::array::from_fn(|_| self.code.new_label());
        let (places, outer) = (&self.places, self.outer);
        let Homes { counters, counts, .. } = *places;
        let [start, end, rest] = [places.starts, places.ends, places.rests].map(|array| array.indexed(Row, 8));
        let is_masked = order::is_masked(self.program);
        let renders = matches!(self.program.sink(), Sink::Plane(_));
        self.code.write(|i| {
            i.mov(Pixel, start);
            i.mov(A, end);
            i.jump_if(Pixel, Condition::More, A, next);
            if is_masked {
                i.minus(A, Pixel);
                i.plus(A, 1);
                i.store(counters.wanted, A);
                i.mov(A, 0);
                i.store(counters.unused, A);
            }
            open_row(i, places, outer);
            if renders {
                open_target_row(i, places);
            }
        });
        let has_full = self.pixels.has_full_groups();
        if has_full {
            self.code.write(|i| {
                i.mov(A, rest);
                i.minus(A, lanes);
                // The latest start is no less; stating it proves to the verifier that full groups end inside the window.
                i.at_most(A, Integer::Furthest);
                i.store(counters.last_full, A);
            });
        }
        self.prepare();
        if has_full {
            self.code.write(|i| {
                i.mov(A, Pixel);
                i.plus(A, lanes - 1);
                i.jump_if(A, Condition::More, end, group);
                i.jump_if(Pixel, Condition::Above, counters.last_full, group);
                i.label(full);
            });
            let full_groups = Fullness::Full { otherwise: partial };
            self.pixels.write(LaneUse::Along, full_groups, &self.places, &mut self.code);
            self.code.write(|i| {
                i.plus(Pixel, lanes);
                i.jump_if(Pixel, Condition::NotAbove, counters.last_full, full);
                i.label(partial);
                i.jump_if(Pixel, Condition::More, end, row_end);
            });
        }
        self.code.write(|i| i.label(group));
        self.pixels.write(LaneUse::Along, Fullness::Partial, &self.places, &mut self.code);
        self.code.write(|i| {
            if is_masked {
                i.plus(Pixel, lanes);
                i.jump_if(Pixel, Condition::More, end, row_end);
                if has_full {
                    i.jump_if(Pixel, Condition::NotAbove, counters.last_full, full);
                }
                i.jump(group);
            }
            i.label(row_end);
            if is_masked {
                i.mov(B, counters.wanted);
                i.minus(B, counters.unused);
                i.plus_at(counters.pixels, B);
                i.store_low(counts.indexed(Row, 4), B);
                // A row without pixels adds nothing to the totals.
                i.jump_if(B, Condition::Equal, 0, next);
            }
        });
        self.leave_sums();
    }

    /// Loads the residents of a row's loop, broadcasts the row values that it reads, and zeroes its sums.
    fn prepare(&mut self) {
        if self.places.keeps_integers && self.options.width != VectorWidth::Bits128 {
            self.place_of_sums();
        }
        let element = element(self.options.precision);
        self.block(self.places.reserved, |block, places| {
            let fractions = places.columns.iter().map(|column| column.fraction);
            for Broadcast { held, array } in places.shown.iter().copied().flatten().chain(fractions) {
                let from = array.map_or(held.memory, |(array, stride)| array.indexed(Integer::Row, stride).spread());
                if held.register.is_some() || from != held.memory {
                    let value = block.kept(from);
                    block.set(element, held, value);
                }
            }
            for column in &places.columns {
                let first = column.first.indexed(Integer::Row, element.bytes() as u32).spread();
                let (first, steps) = (block.kept(first), block.constant_lanes(element, |lane| lane as f64));
                let lanes = block.compute(Operation::Add, element, [first, steps]);
                block.set(element, column.running, lanes);
            }
            let zero = block.number(element, 0.0);
            places.accumulators.iter().for_each(|held| block.set(element, *held, zero));
        });
    }

    /// Stores each sum for the row's end: at 128 bits the sum of its lanes, else the lanes.
    fn leave_sums(&mut self) {
        if self.options.width == VectorWidth::Bits128 {
            let (precision, element) = (self.options.precision, element(self.options.precision));
            let Sink::Sums { accumulators, .. } = self.program.sink() else { return };
            return self.block(self.places.reserved, |block, places| {
                let sums = places.accumulators.iter().zip(&places.row_sums);
                for ((held, row_sums), value) in sums.zip(accumulators) {
                    block.set_source(Some(*value));
                    let sum = match held.register {
                        Some(_) => block.held(*held),
                        None => {
                            let lanes = block.fleeting(held.memory);
                            block.compute(Operation::Load, element, [lanes])
                        }
                    };
                    let sum = sums::of_vector(block, precision, sum);
                    let place = row_sums.indexed(Integer::Row, Element::Double.bytes() as u32);
                    block.store(Element::Double, Portion::Least, sum, place);
                }
            });
        }
        if !self.places.keeps_integers {
            self.place_of_sums();
        }
        let element = element(self.options.precision);
        self.block(self.places.reserved, |block, places| {
            for (held, sums) in places.accumulators.iter().zip(&places.sums) {
                let place: MemoryPlace = sums.indexed(Integer::Sum, 8);
                if held.register.is_some() || held.memory != place {
                    let sum = block.held(*held);
                    block.store(element, Portion::Whole, sum, place);
                }
            }
        });
    }

    /// Sets [`Integer::Sum`] to the offset of the row's sums.
    fn place_of_sums(&mut self) {
        let eighth = self.places.sums.len() * self.options.width.bytes() / 8;
        self.code.write(|i| i.scaled(Integer::Sum, Integer::Row, eighth as i32));
    }
}
