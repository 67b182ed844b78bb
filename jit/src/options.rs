//! `KernelOptions`: compilation options of a kernel.

use isophote_symbolic::{Lanes, Precision, Summation};

use crate::plane::PixelFormat;

/// The vector width of the pixel loop, bits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub enum VectorWidth {
    /// 4 × f32 or 2 × f64, on every processor.
    #[default]
    Bits128,
    /// 8 × f32 or 4 × f64.
    Bits256,
    /// 16 × f32 or 8 × f64.
    Bits512,
}

impl VectorWidth {
    /// Every width, narrowest first.
    pub const ALL: [VectorWidth; 3] = [VectorWidth::Bits128, VectorWidth::Bits256, VectorWidth::Bits512];

    /// Bytes of a vector.
    pub const fn bytes(self) -> usize {
        16 << self as usize
    }

    /// Vector registers that code may use.
    pub(crate) const fn registers(self) -> usize {
        match self {
            VectorWidth::Bits128 | VectorWidth::Bits256 => 16,
            VectorWidth::Bits512 => 32,
        }
    }

    /// Rows of a block, which are prepared at once, an f64 lane each.
    pub(crate) fn rows(self) -> usize {
        match self {
            VectorWidth::Bits128 => 2,
            VectorWidth::Bits256 | VectorWidth::Bits512 => ROWS,
        }
    }

    /// Pixels per group.
    pub fn lanes(self, precision: Precision) -> Lanes {
        use VectorWidth::{Bits128, Bits256, Bits512};
        match (self, precision) {
            (Bits128, Precision::F64) => Lanes::Two,
            (Bits128, Precision::F32) | (Bits256, Precision::F64) => Lanes::Four,
            (Bits256, Precision::F32) | (Bits512, Precision::F64) => Lanes::Eight,
            (Bits512, Precision::F32) => Lanes::Sixteen,
        }
    }
}

/// Rows that are prepared and finished together.
pub(crate) const ROWS: usize = 8;

/// Compilation options of a kernel.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct KernelOptions {
    /// The arithmetic of the pixel loop.
    pub precision: Precision,
    /// The vectors of the pixel loop. They determine which pixels are summed together, so that sums of different widths
    /// differ in their last bits.
    pub width: VectorWidth,
    /// How the pixels of each channel are stored; may be empty for a program that renders.
    pub formats: Vec<PixelFormat>,
    /// In every plane, the pixels of a row are contiguous.
    pub packed: bool,
}

impl KernelOptions {
    /// Pixels per group.
    pub fn lanes(&self) -> Lanes {
        self.width.lanes(self.precision)
    }

    /// The summation order of a kernel, for the interpreter.
    pub fn summation(&self) -> Summation {
        let (lanes, rows) = (self.lanes(), self.width.rows());
        let has_narrow = self.precision == Precision::F32 && self.packed;
        let narrow = if has_narrow { Lanes::of(lanes.count() / ROWS) } else { None };
        Summation { lanes, rows, narrow }
    }
}
