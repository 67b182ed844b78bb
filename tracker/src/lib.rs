//! A frame in, an estimate out.
//!
//! What comes in: a [`Frame`] of raw planes, and a model as a [`Compiled`] set of kernels. What goes out: an [`Estimate`],
//! the parameters with their covariance, the track's state, and how the fit ended.
//!
//! ```text
//! frame ─► start ───► stage ─► stage ─► … ─► covariance ─► track ──► estimate
//!          moments,   trust region on        Fisher         predict, believe,
//!          prediction scaled normal equations               coast, lose, find again
//! ```
//! It must never know a clock, a thread, a file or a socket: times come with the frame, timings are taken above.

mod alternatives;
mod background;
mod camera;
mod clipping;
mod cold;
mod colours;
mod compiled;
mod component;
mod contour;
mod estimate;
mod exposure;
mod fit;
mod frame;
mod grey;
mod halved;
mod loops;
mod mask;
mod mixing;
mod motion;
mod options;
#[cfg(test)]
mod picture;
mod pose;
mod report;
mod scaled;
mod stage;
mod start;
mod track;
mod tracker;
mod trust;
pub mod tune;
mod workers;

pub use alternatives::Substitute;
pub use camera::{CalibrationError, Camera, Distortion, Intrinsics, IntrinsicsError};
pub use compiled::{CompileFailure, Compiled};
pub use contour::{Contour, contours};
pub use estimate::{Ahead, Ending, Estimate, Rejection, StageReport, TrackState};
pub use exposure::{ControllerOptions, ExposureAdvice, ExposureController, ExposureGoal};
pub use frame::{Buffer, Frame, FrameError, Lease, Plane};
pub use mixing::{Mixing, MixingError, MixingMeasurement};
pub use options::{MotionOptions, PREDICT_STEPS_MAX, PredictOptions, TARGETS_MAX, TrackError, TrackerOptions};
pub use pose::{Alternative, Pose, Target, TargetError, TargetSpot, geometry};
pub use report::{Bound, CheckReport, StageCost};
pub use track::evidence::Evidence;
pub use track::search::Sighting;
pub use tracker::{Carried, Tracker};
pub use workers::{InTurn, Workers};
