//! MCAP writer for frames and session results.
//!
//! Pictures, lens, outlines and poses are Foxglove messages in Protobuf; everything else is JSON. Chunks are written whole
//! and uncompressed, so a killed process leaves a file truncated in its last chunk: [`mend`] cuts that off and completes the
//! file.

mod foxglove;
mod jpeg;
mod mend;
mod protobuf;
mod schemas;
mod summary;
#[cfg(test)]
mod tests;
mod writer;

pub use foxglove::{
    BodyPose, DrawnLine, NoPicture, Stamped, camera_calibration, compressed_image, image_annotations, odometry,
    raw_image,
};
pub use jpeg::{NoJpeg, jpeg};
pub use mend::{MendedFile, mend};
pub use writer::{LogChannel, LogSchema, LogWriter};
