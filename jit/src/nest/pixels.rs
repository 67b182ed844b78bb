//! Loads pixels of raw planes, and accumulates into the output plane.
//!
//! A group starts at its pixel, or far enough left to end inside the window; a comparison before its first access proves it
//! to [`crate::verify`].

use std::mem::offset_of;

use super::places::{Homes, RowAddress};
use crate::abi::{Args, PlaneArgs};
use crate::options::KernelOptions;
use crate::plane::PixelFormat;
use crate::vector::{Anchor, Block, Element, Id, Integer, Integers, MemoryPlace, Operation, Portion, arg, comparison};

/// A field of a plane in the list at `planes`.
pub(super) fn plane(planes: Integer, channel: usize, offset: usize) -> MemoryPlace {
    MemoryPlace::new(Anchor::At(planes), (channel * size_of::<PlaneArgs>() + offset) as i32)
}

/// Computes the start of a partial group.
pub(super) fn begin(i: &mut Integers) {
    i.mov(Integer::Begin, Integer::Pixel);
    i.at_most(Integer::Begin, Integer::Furthest);
}

/// The number of the current row in the window.
fn row_number(i: &mut Integers, to: Integer, places: &Homes) {
    i.mov(to, places.counters.row);
    i.plus(to, Integer::Row);
}

impl Block<'_> {
    /// The lanes of a raw plane, for a group that starts at the pixel in `begin`.
    pub(super) fn channel(&mut self, channel: usize, places: &Homes, options: &KernelOptions, begin: Integer) -> Id {
        use Integer::{A, B, C};
        let Some(row) = places.rows[channel] else { unreachable!("every channel that is read has a place") };
        let format = options.formats[channel];
        let bytes = format.bytes_per_pixel();
        if options.packed {
            let base = match row {
                RowAddress::Variable(register) => register,
                RowAddress::Memory(place) => {
                    self.integers(|i| i.mov(A, place));
                    A
                }
            };
            let memory = MemoryPlace::new(Anchor::At(base), 0).indexed(begin, bytes as u32);
            return self.converted(format, memory, options);
        }
        let gathered = places.gathered;
        self.integers(|i| {
            i.mov(B, begin);
            i.mov(C, arg(offset_of!(Args, planes)));
            i.times(B, plane(C, channel, offset_of!(PlaneArgs, pixel_stride)));
            match row {
                RowAddress::Variable(register) => i.mov(A, register),
                RowAddress::Memory(place) => i.mov(A, place),
            }
            i.plus(A, B);
            i.mov(C, plane(C, channel, offset_of!(PlaneArgs, pixel_stride)));
            for lane in 0..options.lanes().count() {
                i.copy(gathered.plus(lane * bytes), MemoryPlace::new(Anchor::At(A), 0), B, bytes);
                i.plus(A, C);
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
    pub(super) fn write(&mut self, value: Id, used: Option<Id>, places: &Homes, element: Element, begin: Integer) {
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
        self.integers(|i| i.mov(Integer::A, places.target));
        let memory = MemoryPlace::new(Anchor::At(Integer::A), 0).indexed(begin, 4);
        let old = self.fleeting(memory);
        let old = self.compute(load, Element::Single, [old]);
        let mut new = self.compute(Operation::Add, Element::Single, [old, value]);
        if let Some(used) = used {
            new = self.compute(Operation::Select, Element::Single, [used, new, old]);
        }
        self.store(Element::Single, extent, new, memory);
    }
}

/// Computes the address of the current row in each plane that is read.
pub(super) fn open_row(i: &mut Integers, places: &Homes, outer: usize) {
    use Integer::{A, B, C, D};
    let strides =
        [offset_of!(PlaneArgs, row_stride), offset_of!(PlaneArgs, slice_stride), offset_of!(PlaneArgs, volume_stride)];
    if places.rows.iter().any(Option::is_some) {
        i.mov(C, arg(offset_of!(Args, planes)));
    }
    for (channel, row) in places.rows.iter().enumerate() {
        let Some(row) = row else { continue };
        let address = match row {
            RowAddress::Variable(register) => *register,
            RowAddress::Memory(_) => D,
        };
        i.mov(address, plane(C, channel, offset_of!(PlaneArgs, first)));
        for (axis, stride) in strides.into_iter().enumerate().take(outer) {
            match outer {
                1 => row_number(i, A, places),
                _ => i.mov(A, places.inside[axis].indexed(Integer::Row, 8)),
            }
            i.mov(B, arg(offset_of!(Args, last) + axis * size_of::<i64>()));
            i.at_most(A, B);
            i.times(A, plane(C, channel, stride));
            i.plus(address, A);
        }
        if let RowAddress::Memory(place) = row {
            i.store(*place, address);
        }
    }
}

/// Computes the address of the current row in the output plane.
pub(super) fn open_target_row(i: &mut Integers, places: &Homes) {
    use Integer::{A, B, D};
    i.mov(D, arg(offset_of!(Args, target)));
    row_number(i, A, places);
    i.mov(B, arg(offset_of!(Args, last_row)));
    i.at_most(A, B);
    i.times(A, arg(offset_of!(Args, target_stride)));
    i.plus(D, A);
    i.store(places.target, D);
}
