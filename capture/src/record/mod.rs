//! Recordings are written: frames and what is said of them in, an MCAP file out.
//!
//! Pictures, lens, outlines and poses are Foxglove's messages, as Protobuf; everything else is JSON. Chunks are written whole and are
//! not packed, so that a process that is killed leaves a file that ends in the middle of its last one: [`mend`] cuts that off and
//! gives the file its end. It knows no session and no clock.

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
