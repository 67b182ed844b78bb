//! The loop nest: blocks of rows, each row with its groups; prologue and epilogue.
//!
//! ```text
//! entry ─► pass ─► block ─► rows' places ⟲ ─► row level ─► row ─► full ⟲ ─► partial ─► sums ─► next row …
//!                    ▲                                       │       └──────◄──┘                  │
//!                    │                                       └── no pixels ──────────►────────────┤
//!                    └────────────────────────── row ends, totals ◄───────────────────────────────┘
//! ```
//! A block has eight rows; those past the last row are prepared as well, and have no pixels.

use std::mem::offset_of;

use iced_x86::{Code, Instruction, Register};
use isophote_symbolic::{Level, Program, Sink};

use super::assembler::{Anchor, Assembled, Assembler, Label, MemoryPlace, Section};
use super::calls::{ARGS, arg};
use super::group::{Fullness, LaneUse, PixelLoop};
use super::operation::{self, Element, Operation, Portion};
use super::outer;
use super::pixels::{FURTHEST, PIXEL, open_row, open_target_row};
use super::places::{BLOCK, Broadcast, Homes, ROW, ROWS, SUM, element, parts};
use super::sums;
use crate::abi::Args;
use crate::error::CompileError;
use crate::options::KernelOptions;
use crate::plan;

/// Callee-saved registers.
const SAVED: [Register; 6] = [Register::RBX, Register::RBP, Register::R12, Register::R13, Register::R14, Register::R15];
/// A page of stack; each is touched before the next.
const PAGE_BYTES: usize = 4096;
/// Frame alignment, so that vectors do not cross a cache line.
const FRAME_ALIGNMENT: usize = 64;
/// A scratch vector register, which no variable has.
pub(super) const FREE: u8 = 0;

/// Fields of the argument block with the window's start, by outer coordinate.
const FIRST: [usize; 3] = [offset_of!(Args, y), offset_of!(Args, z), offset_of!(Args, w)];
/// Fields of the argument block with the window's extent, by outer coordinate.
const COUNT: [usize; 3] = [offset_of!(Args, height), offset_of!(Args, depth), offset_of!(Args, length)];

/// The code of a program, and the stack that it takes.
///
/// # Errors
/// If an instruction cannot be encoded.
pub(super) fn nest(program: &Program, options: &KernelOptions) -> Result<(Assembled, usize), CompileError> {
    let pixels = PixelLoop::new(program, options);
    let places = Homes::new(program, options, &pixels.order, pixels.evaluation);
    let outer = program.coordinates().clamp(2, 4) - 1;
    let mut nest = Nest { program, options, pixels, places, assembler: Assembler::new(), outer };
    nest.body();
    let frame_bytes = nest.entry();
    let saved = (SAVED.len() + 1) * size_of::<usize>() + FRAME_ALIGNMENT;
    Ok((nest.assembler.assemble()?, frame_bytes + saved))
}

pub(super) struct Nest<'p> {
    pub program: &'p Program,
    pub options: &'p KernelOptions,
    pub pixels: PixelLoop<'p>,
    pub places: Homes,
    pub assembler: Assembler,
    /// Coordinates outside of the row.
    pub outer: usize,
}

impl Nest<'_> {
    /// Writes the prologue, now that the frame's size is known.
    fn entry(&mut self) -> usize {
        let bytes = self.places.frame.bytes().next_multiple_of(FRAME_ALIGNMENT);
        self.assembler.switch_to(Section::Entry);
        self.assembler.write(|i| {
            SAVED.iter().for_each(|register| i.add(Instruction::with1(Code::Push_r64, *register)));
            i.mov(Register::RBP, Register::RSP);
            i.and(Register::RSP, -(FRAME_ALIGNMENT as i32));
            i.minus(Register::RSP, bytes as i32);
            for page in 1..=bytes / PAGE_BYTES {
                i.store(MemoryPlace::new(Anchor::Frame, (bytes - page * PAGE_BYTES) as i32), Register::RAX);
            }
            i.mov(ARGS, Register::RDI);
            i.mov(FURTHEST, arg(offset_of!(Args, furthest)));
        });
        bytes
    }

    fn leave(&mut self) {
        self.assembler.write(|i| {
            i.add(Ok(Instruction::with(Code::VEX_Vzeroupper)));
            i.mov(Register::RSP, Register::RBP);
            SAVED.iter().rev().for_each(|register| i.add(Instruction::with1(Code::Pop_r64, *register)));
            i.add(Ok(Instruction::with(Code::Retnq)));
        });
    }

    fn level(&mut self, level: Level) {
        outer::write(level, self.program, self.options, &mut self.places, &mut self.assembler);
    }

    fn body(&mut self) {
        use Register::{RAX, RCX};
        let counters = self.places.counters;
        let is_masked = plan::is_masked(self.program);
        let [block, pass_end, row, rows_end, next] = std::array::from_fn(|_| self.assembler.new_label());
        let outer = self.outer;
        self.assembler.write(|i| {
            i.mov(RAX, arg(COUNT[0]));
            COUNT[1..outer].iter().for_each(|count| i.times(RAX, arg(*count)));
            i.store(counters.rows, RAX);
            i.mov(RAX, 0);
            let zeros = [counters.row, counters.pixels, counters.saturated];
            zeros.iter().chain(&counters.next).for_each(|place| i.store(*place, RAX));
        });
        self.zero(FREE);
        let bytes = self.options.width.bytes();
        let of_rows = self.places.totals.iter().chain([&self.places.taken]);
        let all = of_rows.flat_map(|place| (0..parts(self.options.width)).map(move |part| place.plus(part * bytes)));
        for place in all.collect::<Vec<_>>() {
            self.write_register(FREE, Portion::Whole, place);
        }
        self.level(Level::Pass);

        let [ended, wide] = std::array::from_fn(|_| self.assembler.new_label());
        self.assembler.write(|i| {
            i.label(block);
            i.mov(RAX, counters.row);
            i.compare(RAX, counters.rows);
            i.jump(Code::Jge_rel32_64, pass_end);
            i.mov(RAX, ROWS as i32);
            i.store(counters.together, RAX);
        });
        if self.places.narrow.is_some() {
            self.together();
        }
        if outer > 1 {
            self.rows_places();
        }
        self.each_block(|nest| {
            let has_blocks = nest.places.blocks > 1;
            nest.assembler.write(|i| {
                i.mov(RAX, counters.row);
                if has_blocks {
                    i.plus(RAX, BLOCK);
                }
                i.store(counters.at, RAX);
            });
            nest.level(Level::Row);
        });
        if self.places.narrow.is_some() {
            self.unless_narrow(wide);
            self.each_block(Nest::narrow);
            self.assembler.write(|i| {
                i.jump(Code::Jmp_rel32_64, ended);
                i.label(wide);
                i.mov(BLOCK, 0);
            });
            outer::write_groups(self.program, self.options, &mut self.places, &mut self.assembler);
        }
        if is_masked {
            self.zero(FREE);
            // 32 bits per row.
            let extent = if parts(self.options.width) == 1 { Portion::Half } else { Portion::Whole };
            self.write_register(FREE, extent, self.places.counts);
        }
        self.assembler.write(|i| {
            i.mov(ROW, 0);
            i.label(row);
            i.compare(ROW, ROWS as i32);
            i.jump(Code::Jae_rel32_64, rows_end);
        });
        self.row(next);
        self.assembler.write(|i| {
            i.label(next);
            i.plus(ROW, 1);
            i.jump(Code::Jmp_rel32_64, row);
            i.label(rows_end);
        });
        sums::of_vectors(self.options, &mut self.places, &mut self.assembler);
        self.assembler.write(|i| i.label(ended));
        self.each_block(|nest| nest.level(Level::RowEnd));
        let taken = self.places.taken;
        self.assembler.write(|i| {
            i.mov(RAX, counters.together);
            i.plus_at(counters.row, RAX);
            i.jump(Code::Jmp_rel32_64, block);
            i.label(pass_end);
            i.mov(RCX, counters.pixels);
            (0..ROWS).for_each(|row| i.plus(RCX, taken.plus(row * 8)));
            i.store(arg(offset_of!(Args, pixels)), RCX);
            i.mov(RAX, counters.saturated);
            i.store(arg(offset_of!(Args, saturated)), RAX);
            // The count is an f64 from here on.
            let count = Register::XMM0;
            i.add(Instruction::with3(Code::VEX_Vcvtsi2sd_xmm_xmm_rm64, count, count, RCX));
            i.add_at(counters.pixels, |to| Instruction::with2(Code::VEX_Vmovsd_m64_xmm, to, count));
        });
        sums::of_pass(self.options, &mut self.places, &mut self.assembler);
        self.level(Level::PassEnd);
        self.leave();
    }

    /// Runs the code that `write` writes for each block of the prepared rows.
    fn each_block(&mut self, write: impl FnOnce(&mut Self)) {
        if self.places.blocks == 1 {
            self.assembler.write(|i| i.mov(BLOCK, 0));
            return write(self);
        }
        let [again, behind] = std::array::from_fn(|_| self.assembler.new_label());
        let (rows, together) = (self.places.blocks * ROWS, self.places.counters.together);
        self.assembler.write(|i| {
            i.mov(BLOCK, 0);
            i.label(again);
            // There never are more; the comparison proves it to the verifier.
            i.compare(BLOCK, rows as i32);
            i.jump(Code::Jae_rel32_64, behind);
        });
        write(self);
        self.assembler.write(|i| {
            i.plus(BLOCK, ROWS as i32);
            i.compare(BLOCK, together);
            i.jump(Code::Jl_rel32_64, again);
            i.label(behind);
        });
    }

    /// Stores the positions of the prepared rows in the frame and advances past them; for three coordinates or more.
    fn rows_places(&mut self) {
        use Register::{EAX, RAX, RCX};
        let [fill, filled, moved] = std::array::from_fn(|_| self.assembler.new_label());
        let Homes { counters, inside, coordinates, blocks, .. } = self.places;
        let outer = self.outer;
        self.assembler.write(|i| {
            i.mov(ROW, 0);
            i.label(fill);
            i.compare(ROW, (blocks * ROWS) as i32);
            i.jump(Code::Jae_rel32_64, filled);
            for (axis, first) in FIRST.into_iter().enumerate().take(outer) {
                i.mov(RAX, counters.next[axis]);
                i.store(inside[axis].indexed(ROW, 8), RAX);
                i.plus(RAX, arg(first));
                i.store_low(coordinates[axis].indexed(ROW, 4), EAX);
            }
            // y counts up; a coordinate that reaches its end restarts and carries into the next.
            i.mov(RCX, 0);
            for (axis, count) in COUNT.into_iter().enumerate().take(outer) {
                i.mov(RAX, counters.next[axis]);
                i.plus(RAX, 1);
                i.store(counters.next[axis], RAX);
                if axis + 1 < outer {
                    i.compare(RAX, arg(count));
                    i.jump(Code::Jl_rel32_64, moved);
                    i.store(counters.next[axis], RCX);
                }
            }
            i.label(moved);
            i.plus(ROW, 1);
            i.compare(ROW, counters.together);
            i.jump(Code::Jl_rel32_64, fill);
            i.label(filled);
        });
    }

    /// Processes a prepared row; jumps to `next` if it has no pixels.
    fn row(&mut self, next: Label) {
        use Register::{EAX, RAX, RCX};
        let lanes = self.pixels.lanes() as i32;
        let [full, partial, row_end] = std::array::from_fn(|_| self.assembler.new_label());
        let (places, outer) = (&self.places, self.outer);
        let Homes { counters, counts, .. } = *places;
        let [start, end, rest] = [places.starts, places.ends, places.rests].map(|array| array.indexed(ROW, 8));
        let is_masked = plan::is_masked(self.program);
        let renders = matches!(self.program.sink(), Sink::Plane(_));
        self.assembler.write(|i| {
            i.mov(PIXEL, start);
            i.mov(RAX, end);
            i.compare(PIXEL, RAX);
            i.jump(Code::Jg_rel32_64, next);
            if is_masked {
                i.minus(RAX, PIXEL);
                i.plus(RAX, 1);
                i.store(counters.wanted, RAX);
                i.mov(RAX, 0);
                i.store(counters.unused, RAX);
            }
            open_row(i, places, outer);
            if renders {
                open_target_row(i, places);
            }
        });
        self.prepare();
        let has_full = self.pixels.has_full_groups();
        if has_full {
            self.assembler.write(|i| {
                i.compare(PIXEL, rest);
                i.jump(Code::Jge_rel32_64, partial);
                i.label(full);
            });
            let full_groups = Fullness::Full { otherwise: partial };
            self.pixels.write(LaneUse::Along, full_groups, &mut self.places, &mut self.assembler);
            self.assembler.write(|i| {
                i.plus(PIXEL, lanes);
                i.compare(PIXEL, rest);
                i.jump(Code::Jl_rel32_64, full);
            });
        }
        self.assembler.write(|i| {
            i.label(partial);
            i.compare(PIXEL, end);
            i.jump(Code::Jg_rel32_64, row_end);
        });
        self.pixels.write(LaneUse::Along, Fullness::Partial, &mut self.places, &mut self.assembler);
        self.assembler.write(|i| {
            if is_masked {
                i.plus(PIXEL, lanes);
                if has_full {
                    i.compare(PIXEL, rest);
                    i.jump(Code::Jl_rel32_64, full);
                }
                i.jump(Code::Jmp_rel32_64, partial);
            }
            i.label(row_end);
            if is_masked {
                i.mov(RCX, counters.wanted);
                i.minus(RCX, counters.unused);
                i.plus_at(counters.pixels, RCX);
                i.mov(RAX, RCX);
                i.store_low(counts.indexed(ROW, 4), EAX);
            }
        });
        self.sums();
    }

    /// Loads the registers of a row's loop, broadcasts the row values that it reads, and zeroes its sums.
    fn prepare(&mut self) {
        let element = element(self.options.precision);
        let shown: Vec<Broadcast> = self.places.shown.iter().copied().flatten().collect();
        let columns = self.places.columns.clone();
        let fractions = columns.iter().map(|column| column.fraction);
        for shown in shown.into_iter().chain(fractions) {
            self.fetch(shown, element);
        }
        let steps = self.steps(element);
        for column in columns {
            let register = column.running.register.unwrap_or(FREE);
            self.read_register(register, column.first.indexed(ROW, element.bytes() as u32).spread(), element);
            let add = Operation::Add.code(element, self.options.width);
            let name = operation::register(register, Portion::Whole, self.options.width);
            self.assembler.write(|i| i.add_at(steps, |steps| Instruction::with3(add, name, name, steps)));
            if column.running.register.is_none() {
                self.write_register(FREE, Portion::Whole, column.running.memory);
            }
        }
        if self.places.calls_nothing {
            self.place_of_sums();
        }
        let accumulators = self.places.accumulators.clone();
        if accumulators.iter().any(|held| held.register.is_none()) {
            self.zero(FREE);
        }
        for held in accumulators {
            match held.register {
                Some(register) => self.zero(register),
                None => self.write_register(FREE, Portion::Whole, held.memory),
            }
        }
    }

    /// Moves a value to where a row's loop reads it, unless it is there.
    pub fn fetch(&mut self, Broadcast { held, array }: Broadcast, element: Element) {
        let from = array.map_or(held.memory, |(array, stride)| array.indexed(ROW, stride).spread());
        match held.register {
            Some(register) => self.read_register(register, from, element),
            None if from != held.memory => {
                self.read_register(FREE, from, element);
                self.write_register(FREE, Portion::Whole, held.memory);
            }
            None => {}
        }
    }

    /// 0, 1, 2 …
    fn steps(&mut self, element: Element) -> MemoryPlace {
        let lanes = 0..self.pixels.lanes();
        let bytes: Vec<u8> = match element {
            Element::Single => lanes.flat_map(|lane| (lane as f32).to_le_bytes()).collect(),
            Element::Double => lanes.flat_map(|lane| (lane as f64).to_le_bytes()).collect(),
        };
        self.assembler.constant(&bytes)
    }

    /// Stores the lanes of each sum for the row's end.
    fn sums(&mut self) {
        if !self.places.calls_nothing {
            self.place_of_sums();
        }
        for i in 0..self.places.sums.len() {
            let (held, place) = (self.places.accumulators[i], self.places.sums[i].indexed(SUM, 8));
            if held.register.is_none() && held.memory == place {
                continue;
            }
            if held.register.is_none() {
                self.read_register(FREE, held.memory, Element::Single);
            }
            self.write_register(held.register.unwrap_or(FREE), Portion::Whole, place);
        }
    }

    /// Sets [`SUM`] to the offset of the row's sums.
    fn place_of_sums(&mut self) {
        let eighth = self.places.sums.len() * self.options.width.bytes() / 8;
        self.assembler.write(|i| i.scaled(SUM, ROW, eighth as i32));
    }

    pub fn zero(&mut self, register: u8) {
        let code = Operation::Xor.code(Element::Single, self.options.width);
        let name = operation::register(register, Portion::Whole, self.options.width);
        self.assembler.write(|i| i.add(Instruction::with3(code, name, name, name)));
    }

    pub fn read_register(&mut self, register: u8, from: MemoryPlace, element: Element) {
        let operation = if from.is_spread { Operation::Spread } else { Operation::Load };
        let code = operation.code(element, self.options.width);
        let name = operation::register(register, Portion::Whole, self.options.width);
        // The instruction itself spreads.
        let from = MemoryPlace { is_spread: false, ..from };
        self.assembler.write(|i| i.add_at(from, |from| Instruction::with2(code, name, from)));
    }

    pub fn write_register(&mut self, register: u8, extent: Portion, to: MemoryPlace) {
        let code = operation::store(extent, Element::Single, self.options.width);
        let name = operation::register(register, extent, self.options.width);
        self.assembler.write(|i| i.add_at(to, |to| Instruction::with2(code, to, name)));
    }
}
