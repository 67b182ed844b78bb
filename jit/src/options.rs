//! `KernelOptions`: what a kernel is compiled for besides its program.

use isophote_symbolic::Precision;

use crate::plane::PixelFormat;

/// What a kernel is compiled for besides its program.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct KernelOptions {
    /// The arithmetic of the pixel loop.
    pub precision: Precision,
    /// How the pixels of each channel are stored; may be empty for a program that renders.
    pub formats: Vec<PixelFormat>,
    /// The pixels of a row follow each other without gaps, in every plane.
    pub packed: bool,
}
