//! The one table of bounds of native code; those on a document are in [`isophote_symbolic::LIMITS`].

/// Bounds of one kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KernelLimits {
    /// Bytes of machine code, constants included.
    pub code_bytes: usize,
    /// Bytes of stack that a call takes. A thread has 2 MiB by default, and the caller's own frames and what elementary functions
    /// need come on top.
    pub frame_bytes: usize,
}

/// The bounds.
pub const LIMITS: KernelLimits = KernelLimits { code_bytes: 1 << 20, frame_bytes: 512 << 10 };
