//! Options of lowering: the treatment of saturated pixels, and why a kernel cannot be compiled.

use std::sync::Arc;

use isophote_jit::{CompileError, has_fma};
use isophote_symbolic::{Diagnostics, Lowering};

/// Why a model cannot be compiled.
#[derive(Clone, Debug, thiserror::Error)]
pub enum CompileFailure {
    /// The document asks for something that this build cannot do, or exceeds a limit.
    #[error("{}", messages(.0))]
    Model(Diagnostics),
    /// A kernel failed to compile; not the document's fault.
    #[error("a kernel could not be compiled: {0}")]
    Kernel(Arc<CompileError>),
}

fn messages(diagnostics: &Diagnostics) -> String {
    diagnostics.iter().map(|diagnostic| diagnostic.message.as_str()).collect::<Vec<_>>().join("; ")
}

/// How a kernel treats saturated pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PixelHandling {
    /// Ignores saturation; for frames without saturated pixels.
    All,
    /// Skips and counts saturated pixels; where they are censored, separate kernels sum them.
    SkipSaturated,
    /// Also skips NaN pixels; for pictures with masked parts.
    SkipInvalid,
}

/// The lowering options for this machine.
pub(crate) fn lowering(handling: PixelHandling) -> Lowering {
    Lowering { fma: has_fma(), drop_saturated: handling != PixelHandling::All }
}
