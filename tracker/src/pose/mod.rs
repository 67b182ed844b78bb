//! Six degrees of freedom from round spots.
//!
//! From a lens, a [`Target`] and each spot's fitted ellipse with covariance and profile, or from a fit whose parameters
//! are the pose itself: a [`Pose`] with covariance, and the other minima that are as good.
//!
//! ```text
//! ellipses ─► both circles of each (conic), P3P ─► seeds ─► joint refinement (seen) ─► minima, best first ─► Pose
//! outlines ─► start: all assignments ─────────────────────────► fit of the document ─► direct ─────────────► Pose
//! ```
//! No pixels, frames or kernels.

mod calibrated;
mod conic;
mod direct;
mod found;
pub mod geometry;
mod joint;
mod measured;
mod mirrored;
mod mismatch;
mod p3p;
mod profile;
pub(crate) mod rigid;
mod seen;
mod start;
mod target;

pub(crate) use calibrated::with_lens;
pub(crate) use direct::{Geometry, brightest, lights};
pub(crate) use found::DELTA_CHI_SQUARE_MAX;
pub use found::{Alternative, Pose};
pub(crate) use measured::{Fitted, of_ellipses};
pub use mismatch::PoseMismatch;
pub(crate) use seen::Five;
pub(crate) use start::{OUTLINES_MAX, PoseStart, namings, starts};
pub use target::{Target, TargetError, TargetSpot};
