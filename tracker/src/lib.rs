//! A frame in, an estimate out.
//!
//! What comes in: a [`Frame`] of raw planes, and a model as a [`Compiled`] set of kernels. What goes out: an [`Estimate`],
//! the parameters with their covariance, the track's state, and how the fit ended.
//!
//! ```text
//! frame ─► start ───► stage ─► stage ─► … ─► covariance ─► tracker ──► estimate
//!          moments    trust region on        Fisher         believe,
//!                     scaled normal equations               lose, find again
//! ```
//! It must never know a clock, a thread, a file or a socket: times come with the frame, timings are taken above.

mod background;
mod camera;
mod cold;
mod compiled;
mod component;
mod contour;
mod estimate;
mod fit;
mod frame;
mod grey;
mod options;
#[cfg(test)]
mod picture;
mod pose;
mod report;
mod stage;
mod start;
mod tracker;
mod trust;
mod workers;

pub use camera::{CalibrationError, Camera, Distortion, Intrinsics, IntrinsicsError};
pub use compiled::{CompileFailure, Compiled};
pub use contour::{Contour, contours};
pub use estimate::{Ending, Estimate, Rejection, StageReport, TrackState};
pub use frame::{Buffer, Frame, FrameError, Lease, Plane};
pub use options::{TrackError, TrackerOptions};
pub use pose::{Alternative, Pose, Target, TargetError, TargetSpot, geometry};
pub use report::{CheckReport, StageCost};
pub use tracker::{Carried, Tracker};
pub use workers::{InTurn, Workers};
