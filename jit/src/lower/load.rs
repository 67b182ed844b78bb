//! Loads pixels of raw planes, and accumulates into the output plane.

use cranelift_codegen::ir::{self, InstBuilder, types};
use isophote_symbolic::{Precision, Sink};
use std::mem::offset_of;

use super::emit::{Emitter, PIXELS, arg};
use crate::abi::PlaneArgs;
use crate::plane::PixelFormat;

impl Emitter<'_, '_> {
    /// Stores the addresses of a row being prepared in the record: of the first pixel in each plane that is read, and of the
    /// output plane's row. `at` is y, z, w as far as the program has them, relative to the window; `row` counts the rows
    /// before; `which` selects one of the two rows.
    pub fn prepare_row(&mut self, at: &[ir::Value], row: ir::Value, which: i32) {
        for (channel, slot) in self.plan.rows.iter().enumerate() {
            let Some(slot) = slot else { continue };
            let planes = self.arg(types::I64, arg::PLANES);
            let mut row = self.plane_field(planes, channel, offset_of!(PlaneArgs, first));
            let strides = [
                offset_of!(PlaneArgs, row_stride),
                offset_of!(PlaneArgs, slice_stride),
                offset_of!(PlaneArgs, volume_stride),
            ];
            for (axis, (at, stride)) in at.iter().zip(strides).enumerate() {
                let last = self.arg(types::I64, arg::LAST + (axis * size_of::<i64>()) as i32);
                let at = self.b.ins().umin(*at, last);
                let stride = self.plane_field(planes, channel, stride);
                let down = self.b.ins().imul(at, stride);
                row = self.b.ins().iadd(row, down);
            }
            self.store_of(row, *slot, which);
        }
        if let Sink::Plane(_) = self.plan.program.sink() {
            let target = self.arg(types::I64, arg::TARGET);
            let last = self.arg(types::I64, arg::LAST_ROW);
            let row = self.b.ins().umin(row, last);
            let stride = self.arg(types::I64, arg::TARGET_STRIDE);
            let down = self.b.ins().imul(row, stride);
            let row = self.b.ins().iadd(target, down);
            self.store_of(row, self.plan.target, which);
        }
    }

    /// Points rows that are not prepared yet to the window's start, so that the record always holds an address.
    pub fn prepare_no_row(&mut self, which: i32) {
        for (channel, slot) in self.plan.rows.iter().enumerate() {
            let Some(slot) = slot else { continue };
            let planes = self.arg(types::I64, arg::PLANES);
            let first = self.plane_field(planes, channel, offset_of!(PlaneArgs, first));
            self.store_of(first, *slot, which);
        }
        if let Sink::Plane(_) = self.plan.program.sink() {
            let target = self.arg(types::I64, arg::TARGET);
            self.store_of(target, self.plan.target, which);
        }
    }

    fn plane_field(&mut self, planes: ir::Value, channel: usize, offset: usize) -> ir::Value {
        self.b.ins().load(types::I64, PIXELS, planes, (channel * size_of::<PlaneArgs>() + offset) as i32)
    }

    /// Loads the addresses that [`Self::prepare_row`] stored.
    pub fn open_row(&mut self) {
        for (channel, slot) in self.plan.rows.iter().enumerate() {
            let Some(slot) = slot else { continue };
            let row = self.load(types::I64, *slot);
            let stride = (!self.options.packed).then(|| {
                let planes = self.arg(types::I64, arg::PLANES);
                self.plane_field(planes, channel, offset_of!(PlaneArgs, pixel_stride))
            });
            self.rows[channel] = Some((row, stride));
        }
        if let Sink::Plane(_) = self.plan.program.sink() {
            self.target = Some(self.load(types::I64, self.plan.target));
        }
    }

    /// Loads the lanes of a raw plane as the lane type, from pixel `first` of the row on.
    pub fn channel(&mut self, channel: usize, first: ir::Value) -> ir::Value {
        let Some((row, stride)) = self.rows[channel] else { unreachable!("open_row comes first") };
        let format = self.options.formats[channel];
        let Some(stride) = stride else {
            let bytes = format.bytes_per_pixel();
            let across = self.b.ins().ishl_imm_s(first, i64::from(bytes.trailing_zeros()));
            let address = self.b.ins().iadd(row, across);
            return self.packed(format, address);
        };
        let across = self.b.ins().imul(first, stride);
        let mut address = self.b.ins().iadd(row, across);
        let mut addresses = vec![address];
        for _ in 1..self.lanes() {
            address = self.b.ins().iadd(address, stride);
            addresses.push(address);
        }
        self.gathered(format, &addresses)
    }

    /// Loads adjacent pixels.
    fn packed(&mut self, format: PixelFormat, at: ir::Value) -> ir::Value {
        let single = self.options.precision == Precision::F32;
        match (format, single) {
            (PixelFormat::F32, true) => self.b.ins().load(types::F32X4, PIXELS, at, 0),
            (PixelFormat::F64, false) => self.b.ins().load(types::F64X2, PIXELS, at, 0),
            (PixelFormat::F64, true) => {
                let low = self.b.ins().load(types::F64X2, PIXELS, at, 0);
                let high = self.b.ins().load(types::F64X2, PIXELS, at, 16);
                let low = self.b.ins().fvdemote(low);
                let high = self.b.ins().fvdemote(high);
                self.low_halves(low, high)
            }
            (PixelFormat::F32, false) => {
                let pair = self.b.ins().load(types::I64, PIXELS, at, 0);
                let pair = self.b.ins().scalar_to_vector(types::I64X2, pair);
                let pair = self.cast(types::F32X4, pair);
                self.b.ins().fvpromote_low(pair)
            }
            (PixelFormat::U8, _) => {
                let bytes = if single {
                    self.b.ins().load(types::I32, PIXELS, at, 0)
                } else {
                    self.b.ins().uload16(types::I32, PIXELS, at, 0)
                };
                let bytes = self.b.ins().scalar_to_vector(types::I32X4, bytes);
                let bytes = self.cast(types::I8X16, bytes);
                let words = self.b.ins().uwiden_low(bytes);
                let integers = self.b.ins().uwiden_low(words);
                self.converted(integers)
            }
            (PixelFormat::U16, true) => {
                let integers = self.b.ins().uload16x4(PIXELS, at, 0);
                self.converted(integers)
            }
            (PixelFormat::U16, false) => {
                let words = self.b.ins().load(types::I32, PIXELS, at, 0);
                let words = self.b.ins().scalar_to_vector(types::I32X4, words);
                let words = self.cast(types::I16X8, words);
                let integers = self.b.ins().uwiden_low(words);
                self.converted(integers)
            }
        }
    }

    /// Loads pixels at arbitrary addresses, one load per lane.
    fn gathered(&mut self, format: PixelFormat, at: &[ir::Value]) -> ir::Value {
        match format {
            PixelFormat::U8 | PixelFormat::U16 => {
                let load = |emit: &mut Self, at: ir::Value| match format {
                    PixelFormat::U8 => emit.b.ins().uload8(types::I32, PIXELS, at, 0),
                    _ => emit.b.ins().uload16(types::I32, PIXELS, at, 0),
                };
                let first = load(self, at[0]);
                let mut integers = self.b.ins().scalar_to_vector(types::I32X4, first);
                for (lane, at) in at.iter().enumerate().skip(1) {
                    let pixel = load(self, *at);
                    integers = self.b.ins().insertlane(integers, pixel, lane as u8);
                }
                self.converted(integers)
            }
            PixelFormat::F32 | PixelFormat::F64 => {
                let load = |emit: &mut Self, at: ir::Value| match (format, emit.options.precision) {
                    (PixelFormat::F32, Precision::F32) => emit.b.ins().load(types::F32, PIXELS, at, 0),
                    (PixelFormat::F32, Precision::F64) => {
                        let pixel = emit.b.ins().load(types::F32, PIXELS, at, 0);
                        emit.b.ins().fpromote(types::F64, pixel)
                    }
                    _ => {
                        let pixel = emit.b.ins().load(types::F64, PIXELS, at, 0);
                        emit.rounded(pixel)
                    }
                };
                let first = load(self, at[0]);
                let mut lanes = self.b.ins().scalar_to_vector(self.number, first);
                for (lane, at) in at.iter().enumerate().skip(1) {
                    let pixel = load(self, *at);
                    lanes = self.b.ins().insertlane(lanes, pixel, lane as u8);
                }
                lanes
            }
        }
    }

    /// Converts 4 × i32 to the lane type; for f64 the low two.
    fn converted(&mut self, integers: ir::Value) -> ir::Value {
        match self.options.precision {
            Precision::F32 => self.b.ins().fcvt_from_sint(types::F32X4, integers),
            Precision::F64 => {
                let wide = self.b.ins().swiden_low(integers);
                self.b.ins().fcvt_from_sint(types::F64X2, wide)
            }
        }
    }

    /// Joins the low two f32 of each.
    pub fn low_halves(&mut self, low: ir::Value, high: ir::Value) -> ir::Value {
        let bytes: Vec<u8> = (0..8).chain(16..24).collect();
        self.shuffled(low, high, bytes)
    }

    /// Copies the high two f32 over the low ones.
    pub fn upper(&mut self, lanes: ir::Value) -> ir::Value {
        self.shuffled(lanes, lanes, (8..16).chain(8..16).collect())
    }

    pub fn shuffled(&mut self, low: ir::Value, high: ir::Value, bytes: Vec<u8>) -> ir::Value {
        let mask = self.b.func.dfg.immediates.push(bytes.into());
        let low = self.cast(types::I8X16, low);
        let high = self.cast(types::I8X16, high);
        let both = self.b.ins().shuffle(low, high, mask);
        self.cast(types::F32X4, both)
    }

    /// Adds the values of the group at pixel `first`, as f32, to the output plane where `used` holds.
    pub fn write(&mut self, value: ir::Value, used: Option<ir::Value>, first: ir::Value) {
        let Some(target) = self.target else { unreachable!("open_row comes first") };
        let across = self.b.ins().ishl_imm_s(first, 2);
        let at = self.b.ins().iadd(target, across);
        if self.options.precision == Precision::F32 {
            let old = self.b.ins().load(types::F32X4, PIXELS, at, 0);
            let mut new = self.b.ins().fadd(old, value);
            if let Some(used) = used {
                new = self.b.ins().bitselect(used, new, old);
            }
            self.b.ins().store(PIXELS, new, at, 0);
            return;
        }
        let used = used.map(|used| self.cast(self.truth, used));
        for lane in 0..self.lanes() {
            let place = 4 * lane as i32;
            let term = self.b.ins().extractlane(value, lane as u8);
            let term = self.b.ins().fdemote(types::F32, term);
            let old = self.b.ins().load(types::F32, PIXELS, at, place);
            let mut new = self.b.ins().fadd(old, term);
            if let Some(used) = used {
                let holds = self.b.ins().extractlane(used, lane as u8);
                new = self.b.ins().select(holds, new, old);
            }
            self.b.ins().store(PIXELS, new, at, place);
        }
    }
}
