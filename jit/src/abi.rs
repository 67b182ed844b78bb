//! The ABI of native code: the argument block and the table of elementary functions.
//!
//! Native code takes one argument, a pointer to [`Args`]. It imports nothing by name: it calls elementary functions through
//! [`Functions`], whose slots are numbered as `Function1` and `Function2` are.

use isophote_elementary::{Accuracy, Function1, Function2, Plain};
use isophote_symbolic::Precision;

/// A plane passed to native code.
#[repr(C)]
pub(crate) struct PlaneArgs {
    /// The window's first pixel.
    pub first: *const u8,
    /// Bytes from a row to the next.
    pub row_stride: i64,
    /// Bytes from a pixel to the next.
    pub pixel_stride: i64,
    /// Bytes from a slice to the next.
    pub slice_stride: i64,
    /// Bytes from a volume to the next.
    pub volume_stride: i64,
}

/// The argument block of a kernel.
#[repr(C)]
pub(crate) struct Args {
    /// The numbers of `Program::inputs`.
    pub inputs: *const f64,
    /// Written at the end of the pass.
    pub outputs: *mut f64,
    /// [`FUNCTIONS`].
    pub functions: *const Functions,
    /// One per channel.
    pub planes: *const PlaneArgs,
    /// The numbers of `Program::tables`.
    pub tables: *const f64,
    /// `Sink::Plane`: the output plane, packed, as large as the window.
    pub target: *mut f32,
    /// The window's first column.
    pub x: i64,
    /// The window's first row.
    pub y: i64,
    /// The window's width, px.
    pub width: i64,
    /// The window's height, px.
    pub height: i64,
    /// The window's first slice.
    pub z: i64,
    /// The window's first volume.
    pub w: i64,
    /// The window's slices.
    pub depth: i64,
    /// The window's volumes.
    pub length: i64,
    /// The latest start of a group that ends inside the window, px from its first column.
    pub furthest: i64,
    /// The last row of a slice, slice of a volume, and volume, relative to the window's first.
    pub last: [i64; 3],
    /// The last row, counted over all slices and volumes.
    pub last_row: i64,
    /// `Sink::Plane`: bytes from a row of the output plane to the next.
    pub target_stride: i64,
    /// Written: pixels used.
    pub pixels: i64,
    /// Written: pixels left out for saturation.
    pub saturated: i64,
}

type Lanes1<T, const L: usize> = extern "C" fn(&mut [T; L]);
type Lanes2<T, const L: usize> = extern "C" fn(&mut [T; L], &[T; L]);

/// Code addresses of the elementary functions. Lane forms overwrite their first operand with the result; each exists
/// in two variants: unfused (index 0) and with fused multiply-add (index 1).
#[repr(C)]
pub(crate) struct Functions {
    single1: [[Lanes1<f32, 4>; Function1::EVERY.len()]; 2],
    single2: [[Lanes2<f32, 4>; 2]; 2],
    double1: [[Lanes1<f64, 2>; Function1::EVERY.len()]; 2],
    double2: [[Lanes2<f64, 2>; 2]; 2],
}

impl Functions {
    const SLOT: usize = size_of::<Lanes1<f32, 4>>();

    /// The byte offset of a unary function's lane form.
    pub fn lanes1(precision: Precision, machine: Plain, function: Function1) -> i32 {
        let table = match precision {
            Precision::F32 => std::mem::offset_of!(Functions, single1),
            Precision::F64 => std::mem::offset_of!(Functions, double1),
        };
        let at = usize::from(machine.fused) * Function1::EVERY.len() + function as usize;
        (table + at * Self::SLOT) as i32
    }
    /// Vector operands in memory of the function at a byte offset; `None` if no function starts there.
    #[cfg(all(target_arch = "x86_64", unix))]
    pub fn vectors(offset: usize) -> Option<usize> {
        let within =
            |start: usize, bytes: usize| (start..start + bytes).contains(&offset) && offset.is_multiple_of(Self::SLOT);
        let (first, second) = (std::mem::offset_of!(Functions, single1), std::mem::offset_of!(Functions, single2));
        let (third, fourth) = (std::mem::offset_of!(Functions, double1), std::mem::offset_of!(Functions, double2));
        let [ones, twos] = [2 * Function1::EVERY.len() * Self::SLOT, 2 * Function2::ALL.len() * Self::SLOT];
        if within(first, ones) || within(third, ones) {
            return Some(1);
        }
        (within(second, twos) || within(fourth, twos)).then_some(2)
    }
    /// The byte offset of a binary function's lane form.
    pub fn lanes2(precision: Precision, machine: Plain, function: Function2) -> i32 {
        let table = match precision {
            Precision::F32 => std::mem::offset_of!(Functions, single2),
            Precision::F64 => std::mem::offset_of!(Functions, double2),
        };
        let at = usize::from(machine.fused) * Function2::ALL.len() + function as usize;
        (table + at * Self::SLOT) as i32
    }
}

extern "C" fn single1<const F: usize, const FUSED: bool>(lanes: &mut [f32; 4]) {
    let machine = Plain { fused: FUSED };
    *lanes = lanes.map(|x| Function1::EVERY[F].value_with(machine, Accuracy::Single, f64::from(x)) as f32);
}
extern "C" fn single2<const F: usize, const FUSED: bool>(lanes: &mut [f32; 4], others: &[f32; 4]) {
    let machine = Plain { fused: FUSED };
    for (x, y) in lanes.iter_mut().zip(others) {
        *x = Function2::ALL[F].value_with(machine, Accuracy::Single, f64::from(*x), f64::from(*y)) as f32;
    }
}
extern "C" fn double1<const F: usize, const FUSED: bool>(lanes: &mut [f64; 2]) {
    let machine = Plain { fused: FUSED };
    *lanes = lanes.map(|x| Function1::EVERY[F].value_with(machine, Accuracy::Double, x));
}
extern "C" fn double2<const F: usize, const FUSED: bool>(lanes: &mut [f64; 2], others: &[f64; 2]) {
    let machine = Plain { fused: FUSED };
    for (x, y) in lanes.iter_mut().zip(others) {
        *x = Function2::ALL[F].value_with(machine, Accuracy::Double, *x, *y);
    }
}

macro_rules! every {
    ($f:ident, $fused:literal) => {
        [
            $f::<0, $fused>,
            $f::<1, $fused>,
            $f::<2, $fused>,
            $f::<3, $fused>,
            $f::<4, $fused>,
            $f::<5, $fused>,
            $f::<6, $fused>,
            $f::<7, $fused>,
            $f::<8, $fused>,
            $f::<9, $fused>,
            $f::<10, $fused>,
            $f::<11, $fused>,
            $f::<12, $fused>,
            $f::<13, $fused>,
            $f::<14, $fused>,
            $f::<15, $fused>,
            $f::<16, $fused>,
            $f::<17, $fused>,
            $f::<18, $fused>,
            $f::<19, $fused>,
            $f::<20, $fused>,
            $f::<21, $fused>,
            $f::<22, $fused>,
        ]
    };
}

/// The table passed to every kernel.
pub(crate) static FUNCTIONS: Functions = Functions {
    single1: [every!(single1, false), every!(single1, true)],
    single2: [[single2::<0, false>, single2::<1, false>], [single2::<0, true>, single2::<1, true>]],
    double1: [every!(double1, false), every!(double1, true)],
    double2: [[double2::<0, false>, double2::<1, false>], [double2::<0, true>, double2::<1, true>]],
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn function_discriminants_are_table_indices() {
        assert!(Function1::EVERY.iter().enumerate().all(|(i, f)| *f as usize == i));
        assert!(Function2::ALL.iter().enumerate().all(|(i, f)| *f as usize == i));
    }
}
