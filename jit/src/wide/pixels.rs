//! Loads pixels of raw planes, and accumulates into the output plane.
//!
//! A group starts at its pixel, or far enough left to end inside the window; a comparison before its first access proves it
//! to [`crate::verify`].

use std::mem::offset_of;

use iced_x86::{Code, Instruction, Register};

use super::assembler::{Anchor, Instructions, Label, MemoryPlace};
use super::block::{Block, Id};
use super::calls::arg;
use super::operation::{Element, Operation, Portion, comparison};
use super::places::{Homes, ROW, RowAddress};
use crate::abi::{Args, PlaneArgs};
use crate::options::KernelOptions;
use crate::plane::PixelFormat;

/// The register with the pixel at which a group starts or would start, from the window's first column.
pub(super) const PIXEL: Register = Register::R12;
/// The register with the start of a partial group.
pub(super) const BEGIN: Register = Register::R13;
/// The register with the latest start of a group.
pub(super) const FURTHEST: Register = Register::R15;

/// A field of a plane in the list at `planes`.
pub(super) fn plane(planes: Register, channel: usize, offset: usize) -> MemoryPlace {
    MemoryPlace::new(Anchor::At(planes), (channel * size_of::<PlaneArgs>() + offset) as i32)
}

/// Computes the start of a partial group.
pub(super) fn begin(i: &mut Instructions) {
    i.mov(BEGIN, PIXEL);
    i.at_most(BEGIN, FURTHEST);
}

/// A full group starts at its pixel, which never exceeds the latest start; the comparison proves it to the verifier.
pub(super) fn begin_full(i: &mut Instructions, otherwise: Label) {
    i.compare(PIXEL, FURTHEST);
    i.jump(Code::Ja_rel32_64, otherwise);
}

/// The number of the current row in the window.
fn row_number(i: &mut Instructions, to: Register, places: &Homes) {
    i.mov(to, places.counters.row);
    i.plus(to, ROW);
}

impl Block<'_> {
    /// The lanes of a raw plane, for a group that starts at the pixel in `begin`.
    pub fn channel(&mut self, channel: usize, places: &Homes, options: &KernelOptions, begin: Register) -> Id {
        use Register::{RAX, RCX, RDX};
        let Some(row) = places.rows[channel] else { unreachable!("every channel that is read has a place") };
        let format = options.formats[channel];
        let bytes = format.bytes_per_pixel();
        if options.packed {
            let base = match row {
                RowAddress::Register(register) => register,
                RowAddress::Memory(place) => {
                    self.scalar(|i| i.mov(RAX, place));
                    RAX
                }
            };
            let memory = MemoryPlace::new(Anchor::At(base), 0).indexed(begin, bytes as u32);
            return self.converted(format, memory, options);
        }
        let gathered = places.gathered;
        self.scalar(|i| {
            i.mov(RCX, begin);
            i.mov(RDX, arg(offset_of!(Args, planes)));
            i.times(RCX, plane(RDX, channel, offset_of!(PlaneArgs, pixel_stride)));
            match row {
                RowAddress::Register(register) => i.mov(RAX, register),
                RowAddress::Memory(place) => i.mov(RAX, place),
            }
            i.plus(RAX, RCX);
            i.mov(RDX, plane(RDX, channel, offset_of!(PlaneArgs, pixel_stride)));
            for lane in 0..options.lanes().count() {
                copy_pixel(i, gathered.plus(lane * bytes), bytes);
                i.plus(RAX, RDX);
            }
        });
        self.converted(format, gathered, options)
    }
    /// Converts contiguous pixels to lanes.
    pub fn converted(&mut self, format: PixelFormat, memory: MemoryPlace, options: &KernelOptions) -> Id {
        use Element::{Double, Single};
        let (element, half) = (super::places::element(options.precision), memory.plus(self.width.bytes()));
        let pixels = self.fleeting(memory);
        match (format, element) {
            (PixelFormat::U8, _) => {
                let integers = self.compute(Operation::FromBytes, element, [pixels]);
                self.compute(Operation::FromIntegers, element, [integers])
            }
            (PixelFormat::U16, _) => {
                let integers = self.compute(Operation::FromWords, element, [pixels]);
                self.compute(Operation::FromIntegers, element, [integers])
            }
            (PixelFormat::F32, Single) | (PixelFormat::F64, Double) => self.compute(Operation::Load, element, [pixels]),
            (PixelFormat::F32, Double) => self.compute(Operation::Widen, Double, [pixels]),
            (PixelFormat::F64, Single) => {
                let high = self.fleeting(half);
                let [low, high] = [pixels, high].map(|part| self.compute(Operation::Narrow, Double, [part]));
                self.compute(Operation::Join, Single, [low, high])
            }
        }
    }

    /// Adds the lanes of a group, as f32, to the output plane where `used` holds.
    pub fn write(&mut self, value: Id, used: Option<Id>, places: &Homes, element: Element, begin: Register) {
        let (load, extent) = match element {
            Element::Single => (Operation::Load, Portion::Whole),
            Element::Double => (Operation::LoadHalf, Portion::Half),
        };
        let [value, used] = match element {
            Element::Single => [Some(value), used],
            Element::Double => {
                let one = self.number(Element::Double, 1.0);
                let used = used.map(|used| {
                    let ones = self.compute(Operation::And, Element::Double, [used, one]);
                    let ones = self.compute(Operation::Narrow, Element::Double, [ones]);
                    let zero = self.number(Element::Single, 0.0);
                    self.compute(Operation::Compare(comparison::DIFFERENT), Element::Single, [ones, zero])
                });
                [Some(self.compute(Operation::Narrow, Element::Double, [value])), used]
            }
        };
        let Some(value) = value else { return };
        self.scalar(|i| i.mov(Register::RAX, places.target));
        let memory = MemoryPlace::new(Anchor::At(Register::RAX), 0).indexed(begin, 4);
        let old = self.fleeting(memory);
        let old = self.compute(load, Element::Single, [old]);
        let mut new = self.compute(Operation::Add, Element::Single, [old, value]);
        if let Some(used) = used {
            new = self.compute(Operation::Select, Element::Single, [used, new, old]);
        }
        self.store(Element::Single, extent, new, memory);
    }
}

/// Copies the pixel at rax.
fn copy_pixel(i: &mut Instructions, to: MemoryPlace, bytes: usize) {
    let (load, store, wide, low) = match bytes {
        1 => (Code::Movzx_r32_rm8, Code::Mov_rm8_r8, Register::ECX, Register::CL),
        2 => (Code::Movzx_r32_rm16, Code::Mov_rm16_r16, Register::ECX, Register::CX),
        4 => (Code::Mov_r32_rm32, Code::Mov_rm32_r32, Register::ECX, Register::ECX),
        _ => (Code::Mov_r64_rm64, Code::Mov_rm64_r64, Register::RCX, Register::RCX),
    };
    i.add_at(MemoryPlace::new(Anchor::At(Register::RAX), 0), |from| Instruction::with2(load, wide, from));
    i.add_at(to, |to| Instruction::with2(store, to, low));
}

/// Computes the address of the current row in each plane that is read.
pub(super) fn open_row(i: &mut Instructions, places: &Homes, outer: usize) {
    use Register::{RAX, RCX, RDX, RSI};
    let strides =
        [offset_of!(PlaneArgs, row_stride), offset_of!(PlaneArgs, slice_stride), offset_of!(PlaneArgs, volume_stride)];
    if places.rows.iter().any(Option::is_some) {
        i.mov(RDX, arg(offset_of!(Args, planes)));
    }
    for (channel, row) in places.rows.iter().enumerate() {
        let Some(row) = row else { continue };
        let address = match row {
            RowAddress::Register(register) => *register,
            RowAddress::Memory(_) => RSI,
        };
        i.mov(address, plane(RDX, channel, offset_of!(PlaneArgs, first)));
        for (axis, stride) in strides.into_iter().enumerate().take(outer) {
            match outer {
                1 => row_number(i, RAX, places),
                _ => i.mov(RAX, places.inside[axis].indexed(ROW, 8)),
            }
            i.mov(RCX, arg(offset_of!(Args, last) + axis * size_of::<i64>()));
            i.at_most(RAX, RCX);
            i.times(RAX, plane(RDX, channel, stride));
            i.plus(address, RAX);
        }
        if let RowAddress::Memory(place) = row {
            i.store(*place, address);
        }
    }
}

/// Computes the address of the current row in the output plane.
pub(super) fn open_target_row(i: &mut Instructions, places: &Homes) {
    use Register::{RAX, RCX, RSI};
    i.mov(RSI, arg(offset_of!(Args, target)));
    row_number(i, RAX, places);
    i.mov(RCX, arg(offset_of!(Args, last_row)));
    i.at_most(RAX, RCX);
    i.times(RAX, arg(offset_of!(Args, target_stride)));
    i.plus(RSI, RAX);
    i.store(places.target, RSI);
}
