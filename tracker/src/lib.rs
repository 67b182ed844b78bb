//! The tracker: fits a compiled model to frames and follows its targets from frame to frame.
//!
//! A [`Compiled`] set of kernels is fitted to the raw planes of a [`Frame`]; the [`Estimate`] has the parameters with
//! their covariance, the track's state, and how the fit ended.
//!
//! ```text
//! frame ─► start ───► stage ─► stage ─► … ─► covariance ─► track ──► estimate
//!          moments,   trust region on        Fisher         predict, believe,
//!          prediction scaled normal equations               coast, lose, find again
//! ```
//! No clocks, threads, files or sockets: times come with the frame, callers measure timings.

mod budget;
mod camera;
mod estimate;
mod exposure;
mod least_squares;
mod options;
mod outline;
mod photometry;
#[cfg(test)]
mod picture;
mod pose;
mod preview;
mod report;
mod scaled;
mod sight;
mod solve;
mod statistics;
mod track;
pub mod tune;
mod verdict;

pub use budget::{Stop, WORK_MAX, Watch};
pub use camera::{CalibrationError, Camera, DefectMap, DefectMapError, Distortion, Intrinsics, IntrinsicsError};
pub use estimate::{
    Ahead, Ending, Estimate, Quality, RejectedFit, Rejection, Sampled, StageReport, Substitute, TracePoint, TrackState,
};
pub use exposure::{ControllerOptions, ExposureAdvice, ExposureController, ExposureGoal};
pub use isophote_frame::{
    Buffer, CameraResponse, Frame, FrameError, GainMap, Lease, Plane, Response, ResponseError, plain,
};
pub use options::{
    CONFIDENCE_MIN, MotionOptions, PREDICT_STEPS_MAX, PredictOptions, TARGETS_MAX, TrackError, TrackerOptions,
};
pub use photometry::Photometry;
pub use pose::{Alternative, Pose, PoseMismatch, Target, TargetError, TargetSpot, geometry};
pub use preview::{
    CrossSection, FrameScene, PixelRun, PoseAxis, PreviewDepth, PreviewOverlay, PreviewPart, PreviewPicture, Viewer,
};
pub use report::{
    BodyCost, Bound, CheckReport, LoopCost, LoopSums, StageCost, loop_costs, over_pixels_of, plain_flops, plain_program,
};
pub use sight::contour::{Contour, contours};
pub use sight::defective::{DefectFault, DefectMeasurement, DefectOptions, DefectScene, FoundDefects, PixelKinds};
pub use sight::detect::Strength;
pub use sight::mixing::{Mixing, MixingError, MixingMeasurement};
pub use sight::radial::{MeasuredProfile, ProfileMeasurement};
pub use sight::response::{
    GainMeasurement, MeasuredGains, MeasuredResponse, ResponseFault, ResponseMeasurement, ResponseOptions,
};
pub use sight::transfer::{MeasuredNoise, NoiseFault, NoiseMeasurement, NoiseOptions};
pub use solve::compiled::Compiled;
pub use solve::pixel_handling::CompileFailure;
pub use solve::prepare::{Preparation, Preparing};
pub use solve::readiness::FrameReadiness;
pub use solve::stage_kernels::StageKernels;
pub use solve::workers::{InTurn, Workers};
pub use track::candidate::Sighting;
pub use track::disagreement::{Disagreement, ParameterShift};
pub use track::shared::Carried;
pub use track::snapshot::{SNAPSHOT_VERSION, Snapshot, SnapshotError};
pub use track::tracker::Tracker;
pub use verdict::{DeviationLikelihood, Signs};
