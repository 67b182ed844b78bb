//! `Camera`: sensor and lens facts that do not belong to the model, from documents or calibration text; projection of
//! directions to pixels and back.

mod defects;
mod facts;
mod lens;
mod opencv;

pub use defects::{DefectMap, DefectMapError};
pub use facts::{Camera, Distortion, Intrinsics};
pub use lens::IntrinsicsError;
pub use opencv::CalibrationError;
