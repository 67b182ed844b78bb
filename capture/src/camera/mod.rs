//! Cameras behind V4L2.
//!
//! In: a device by path or identity, and what a document wants of it ([`CameraSpec`]). Out: frames, the newest there is
//! ([`LiveCamera::next`]), with the driver's time and a number whose gaps say what was lost; the cameras of the machine
//! ([`cameras`]) and their controls ([`set_controls`]). It never knows who looks at the frames, has no thread, and waits
//! no longer than it is told to.
//!
//! ```text
//! ioctl (unsafe) ─► device ─► formats, controls, knob ──┐
//!       └─► stream (buffers) ─► pixels ─────────────────┴─► Camera: rests, streams, is down and comes back
//! ```
//! A camera that is lost is looked for again by identity, at growing intervals of one second at most and whenever
//! something changes in `/dev`.

mod controls;
mod device;
mod formats;
mod ioctl;
mod knob;
mod live;
mod sequence;
mod stream;
mod watch;

use serde::{Deserialize, Serialize};

pub use controls::{ControlInfo, ControlKind, ControlValue, ControlValues, set_controls};
pub use device::{CameraInfo, camera, cameras};
pub use formats::{FormatInfo, FormatWanted, SizeInfo};
pub use live::LiveCamera;

use crate::pixels::Colour;

/// What a document wants of a camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraSpec {
    /// A path such as `/dev/video0`, or an identity as [`cameras`] lists it.
    pub device: String,
    /// Of the pictures.
    pub format: FormatWanted,
    /// What becomes of their colour.
    pub colour: Colour,
    /// Set before the first frame, and again whenever the camera comes back.
    pub controls: ControlValues,
}

/// What a camera does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraState {
    /// It is closed: others may use it.
    Resting,
    /// Frames come, or will soon.
    Running,
    /// It streams, but there is nothing to see; why.
    Stalled(String),
    /// It is gone, or refuses; why. It is looked for again.
    Lost(String),
}

/// Who a camera is, how it is set, and what was lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraStatus {
    /// Its device node, at present or last.
    pub device: String,
    /// Its name for documents, which stays when it is plugged in again.
    pub identity: String,
    /// The four-character code, blanks at its end cut.
    pub format: String,
    /// Of the sensor's pictures, px.
    pub width: u32,
    /// Of the sensor's pictures, px.
    pub height: u32,
    /// Frames a second that the driver promises; absent where it does not.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rate_hz: Option<f64>,
    /// What the driver made of the document's controls.
    pub controls_taken: ControlValues,
    /// Frames that the driver's numbers leave out.
    pub gaps: u64,
    /// Frames that came flagged as wrong, too short, or could not be decoded.
    pub damaged: u64,
    /// Sound frames that were not handed on because a newer one was there.
    pub overtaken: u64,
    /// How often it was opened again after it was lost.
    pub reconnects: u64,
}

/// Why a camera cannot be used. Every message says what would help.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Nothing is there.
    #[error("there is no camera {device}; {}", present_cameras(present))]
    Missing {
        /// What was asked for.
        device: String,
        /// Those that there are.
        present: Vec<String>,
    },
    /// It belongs to others.
    #[error("{device} may not be opened by this user; who may is in the group `video` on most systems")]
    Forbidden {
        /// What was asked for.
        device: String,
    },
    /// Something is there that delivers no pictures.
    #[error("{device} is no camera that streams single-planar pictures; `isophote cameras` lists those that do")]
    NotACamera {
        /// What was asked for.
        device: String,
    },
    /// Somebody else streams from it.
    #[error(
        "{device} is in use; close the other program, or give the camera a source of its own (PUT /v1/sources/…) that several sessions name"
    )]
    Busy {
        /// Its path.
        device: String,
    },
    /// The operating system or the driver refused.
    #[error("{device} cannot be {doing}: {reason}")]
    Io {
        /// Its path.
        device: String,
        /// What was tried, as a participle.
        doing: &'static str,
        /// The system's words.
        reason: std::io::Error,
    },
    /// A format that the camera does not have, or this program does not read.
    #[error("{device} does not offer {wanted}; of what is read here it offers {}", offered.join(", "))]
    Format {
        /// Its path.
        device: String,
        /// What was asked for.
        wanted: String,
        /// Codes of those that are read.
        offered: Vec<String>,
    },
    /// A size that the camera does not have.
    #[error("{device} has no pictures of {wanted} px in such a format; it offers {}", offered.join(", "))]
    Size {
        /// Its path.
        device: String,
        /// What was asked for.
        wanted: String,
        /// For people.
        offered: Vec<String>,
    },
    /// One colour of a format that has none.
    #[error(
        "{device} sends {format}, which has no red, green or blue; leave `colour` out, or set `format` to one that has"
    )]
    Colour {
        /// Its path.
        device: String,
        /// Code.
        format: String,
    },
    /// The driver answers a format with another one.
    #[error("{device} gives {given}, not {wanted}")]
    Changed {
        /// Its path.
        device: String,
        /// What it gives.
        given: String,
        /// What it was set to.
        wanted: String,
    },
    /// A control that the camera does not have, or does not take.
    #[error("control {name}: {reason}")]
    Control {
        /// As the document writes it.
        name: String,
        /// What is wrong and what would be right.
        reason: String,
    },
}

fn present_cameras(present: &[String]) -> String {
    if present.is_empty() { "no camera is plugged in".into() } else { format!("there is {}", present.join(", ")) }
}

impl CameraError {
    /// The key of a source's document that is wrong.
    pub fn key(&self) -> String {
        match self {
            CameraError::Format { .. } => "format".into(),
            CameraError::Colour { .. } => "colour".into(),
            CameraError::Size { .. } | CameraError::Changed { .. } => "width".into(),
            CameraError::Control { name, .. } => format!("controls.{name}"),
            _ => "device".into(),
        }
    }
}
