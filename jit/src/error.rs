//! Errors of compiling and of running a kernel.

use thiserror::Error;

use crate::limits::LIMITS;
use crate::plane::{PixelFormat, Window};

/// Why compilation failed. All but `NoFma`, `CodeTooLarge`, `FrameTooLarge` and `NoCodeMemory` indicate a bug or an
/// unsupported machine.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum CompileError {
    /// The program uses fused multiply-add, which this processor lacks.
    #[error("this processor has no fused multiply-add; lower the program without")]
    NoFma,
    /// This processor, or the code generator, does not support vectors of that width.
    #[error("this processor has no vectors of {bits} bits")]
    NoVectors {
        /// Bits of a vector.
        bits: usize,
    },
    /// The number of formats differs from the number of channels.
    #[error("the program has {channels} channels, {formats} pixel formats were given")]
    Formats {
        /// Channels of the program.
        channels: usize,
        /// Formats in the options.
        formats: usize,
    },
    /// The instructions are no valid program.
    #[error("malformed program: {0}")]
    Malformed(#[from] isophote_symbolic::Malformed),
    /// A program that renders reads a channel.
    #[error("a program that renders reads a channel")]
    RendersPixels,
    /// The processor or operating system is not supported.
    #[error("no native code on this machine: {0}")]
    Host(String),
    /// The audit or the verifier rejected the code.
    #[error("refused by the audit: {0}")]
    Audit(String),
    /// The compiler failed.
    #[error("the compiler failed: {0}")]
    Compiler(String),
    /// The program is too large: more than [`KernelLimits::code_bytes`](crate::KernelLimits::code_bytes).
    #[error("{bytes} bytes of machine code, {} are allowed", LIMITS.code_bytes)]
    CodeTooLarge {
        /// Bytes of machine code.
        bytes: usize,
    },
    /// The program is too large: more than [`KernelLimits::frame_bytes`](crate::KernelLimits::frame_bytes).
    #[error("{bytes} bytes of stack for a call, {} are allowed", LIMITS.frame_bytes)]
    FrameTooLarge {
        /// Bytes of stack.
        bytes: usize,
    },
    /// The operating system provided no executable memory.
    #[error("no memory for code: {0}")]
    NoCodeMemory(String),
}

/// Why a kernel did not run. Nothing was written.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum RunError {
    /// The number of planes differs from the number of channels.
    #[error("the kernel reads {channels} planes, {planes} were given")]
    Planes {
        /// Channels of the program.
        channels: usize,
        /// Planes given.
        planes: usize,
    },
    /// The kernel was compiled for another pixel format.
    #[error("channel {channel} holds {given:?} pixels, the kernel was compiled for {expected:?}")]
    Format {
        /// Index of the plane.
        channel: usize,
        /// Format of the kernel.
        expected: PixelFormat,
        /// Format of the plane.
        given: PixelFormat,
    },
    /// The kernel was compiled for pixels without gaps.
    #[error("channel {channel} has {stride} bytes from pixel to pixel, the kernel was compiled for packed pixels")]
    Packing {
        /// Index of the plane.
        channel: usize,
        /// Pixel stride of the plane, bytes.
        stride: usize,
    },
    /// The window is empty or leaves a plane.
    #[error("the window {window:?} is empty or leaves the plane of {size:?} px")]
    Window {
        /// The window given.
        window: Window,
        /// Size of the plane, px.
        size: [usize; 4],
    },
    /// The window has several slices along a coordinate that the program lacks.
    #[error("the window {window:?} has several slices, the program {coordinates} coordinates")]
    Slices {
        /// Coordinates of the program.
        coordinates: usize,
        /// The window given.
        window: Window,
    },
    /// The output plane has another size than the window.
    #[error("the output plane holds {given} px, the window has {expected}")]
    Target {
        /// Pixels of the window.
        expected: usize,
        /// Pixels given.
        given: usize,
    },
    /// Sums were requested of a kernel that renders, or rendering of one that sums.
    #[error("the kernel {}", if *.renders { "renders a plane, it has no sums" } else { "sums, it does not render" })]
    Sink {
        /// Whether the kernel renders.
        renders: bool,
    },
}
