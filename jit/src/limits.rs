//! Limits of native code; those of a document are in [`isophote_symbolic::LIMITS`].

/// Limits of one kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KernelLimits {
    /// Bytes of machine code, constants included.
    pub code_bytes: usize,
    /// Bytes of stack per call. A thread has 2 MiB by default, which the caller's frames and the elementary functions share.
    pub frame_bytes: usize,
}

/// The limits in force.
pub const LIMITS: KernelLimits = KernelLimits { code_bytes: 1 << 20, frame_bytes: 512 << 10 };
