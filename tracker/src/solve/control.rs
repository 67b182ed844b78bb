//! How kernels are made: what they do with saturated pixels, and why one may not be made.
//!
//! What comes in: what a caller wants of saturated pixels. What goes out: options of a lowering. It never knows a model.

use std::sync::Arc;

use isophote_jit::{CompileError, has_fma};
use isophote_symbolic::{Diagnostics, Lowering};

/// Why a model cannot run here.
#[derive(Clone, Debug, thiserror::Error)]
pub enum CompileFailure {
    /// The document asks for something that this build cannot do, or for too much.
    #[error("{}", messages(.0))]
    Model(Diagnostics),
    /// A kernel could not be made; not the document's fault.
    #[error("a kernel could not be compiled: {0}")]
    Kernel(Arc<CompileError>),
}

fn messages(diagnostics: &Diagnostics) -> String {
    diagnostics.iter().map(|diagnostic| diagnostic.message.as_str()).collect::<Vec<_>>().join("; ")
}

/// Whether a kernel looks for saturated pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Control {
    /// It does not; for frames without them.
    Plain,
    /// It leaves them out and counts them; where they are censored, kernels of their own sum them.
    Dropping,
    /// It leaves pixels out that are no numbers as well; for pictures that are blind in places.
    Blind,
}

/// How programs are lowered on this machine.
pub(crate) fn lowering(control: Control) -> Lowering {
    Lowering { fma: has_fma(), drop_saturated: control != Control::Plain }
}
