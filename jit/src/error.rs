//! The two doors' errors: a program that gets no kernel, and a kernel that does not run.

use thiserror::Error;

use crate::limits::LIMITS;
use crate::plane::{PixelFormat, Window};

/// Why there is no kernel. All but `NoFma`, the two that say `TooLarge` and `NoCodeMemory` are bugs or a machine that is not
/// supported.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum CompileError {
    /// The program multiplies and adds with one rounding, which this processor does not offer.
    #[error("this processor has no fused multiply-add; lower the program without")]
    NoFma,
    /// This processor has no vectors that wide, or none that we write code for.
    #[error("this processor has no vectors of {bits} bits")]
    NoVectors {
        /// Of a vector.
        bits: usize,
    },
    /// As many formats as channels are needed.
    #[error("the program has {channels} channels, {formats} pixel formats were given")]
    Formats {
        /// Of the program.
        channels: usize,
        /// In the options.
        formats: usize,
    },
    /// The instructions are not a program.
    #[error("malformed program: {0}")]
    Malformed(#[from] isophote_symbolic::Malformed),
    /// A program that renders has no planes to read.
    #[error("a program that renders reads a channel")]
    RendersPixels,
    /// The processor or operating system is not supported.
    #[error("no native code on this machine: {0}")]
    Host(String),
    /// The function holds what it must not hold.
    #[error("refused by the audit: {0}")]
    Audit(String),
    /// The compiler refused it.
    #[error("the compiler failed: {0}")]
    Compiler(String),
    /// The program is too large: more than [`KernelLimits::code_bytes`](crate::KernelLimits::code_bytes).
    #[error("{bytes} bytes of machine code, {} are allowed", LIMITS.code_bytes)]
    CodeTooLarge {
        /// Of machine code.
        bytes: usize,
    },
    /// The program is too large: more than [`KernelLimits::frame_bytes`](crate::KernelLimits::frame_bytes).
    #[error("{bytes} bytes of stack for a call, {} are allowed", LIMITS.frame_bytes)]
    FrameTooLarge {
        /// Of stack.
        bytes: usize,
    },
    /// The operating system gave no executable memory.
    #[error("no memory for code: {0}")]
    NoCodeMemory(String),
}

/// Why a kernel did not run. Nothing was written.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum RunError {
    /// As many planes as channels are needed.
    #[error("the kernel reads {channels} planes, {planes} were given")]
    Planes {
        /// Of the program.
        channels: usize,
        /// Given.
        planes: usize,
    },
    /// The kernel was compiled for another pixel format.
    #[error("channel {channel} holds {given:?} pixels, the kernel was compiled for {expected:?}")]
    Format {
        /// Number of the plane.
        channel: usize,
        /// Of the kernel.
        expected: PixelFormat,
        /// Of the plane.
        given: PixelFormat,
    },
    /// The kernel was compiled for pixels without gaps.
    #[error("channel {channel} has {stride} bytes from pixel to pixel, the kernel was compiled for packed pixels")]
    Packing {
        /// Number of the plane.
        channel: usize,
        /// Of the plane.
        stride: usize,
    },
    /// The window is empty or leaves a plane.
    #[error("the window {window:?} is empty or leaves the plane of {size:?} px")]
    Window {
        /// As given.
        window: Window,
        /// Of the plane.
        size: [usize; 4],
    },
    /// The window has slices that the program has no coordinate for.
    #[error("the window {window:?} has several slices, the program {coordinates} coordinates")]
    Slices {
        /// Of the program.
        coordinates: usize,
        /// As given.
        window: Window,
    },
    /// The output plane has another size than the window.
    #[error("the output plane holds {given} px, the window has {expected}")]
    Target {
        /// Of the window.
        expected: usize,
        /// Given.
        given: usize,
    },
    /// Sums were asked of a kernel that renders, or the other way round.
    #[error("the kernel {}", if *.renders { "renders a plane, it has no sums" } else { "sums, it does not render" })]
    Sink {
        /// What the kernel does.
        renders: bool,
    },
}
