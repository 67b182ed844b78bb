//! `Camera`: what belongs to the camera and not to the model.
//!
//! What comes in: documents, or the text of a calibration file. What goes out: facts, and pixels of directions and back.
//! It never knows a file or an image.

mod defects;
mod facts;
mod lens;
mod opencv;

pub use defects::{DefectMap, DefectMapError};
pub use facts::{Camera, Distortion, Intrinsics};
pub use lens::IntrinsicsError;
pub use opencv::CalibrationError;
