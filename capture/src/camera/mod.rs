//! Cameras behind V4L2.
//!
//! In: a device by path or identity, and what a document wants of it ([`CameraSpec`]). Out: frames, the newest there is
//! ([`LiveCamera::next`]), with the driver's time and a number whose gaps say what was lost; the cameras of the machine
//! ([`cameras`]) and their controls ([`set_controls`]). It never knows who looks at the frames, and waits
//! no longer than it is told to, unless a driver's call does not return: then its caller is held. Only who a device is is asked on
//! threads of their own, since one that hangs must not stand before the others.
//!
//! ```text
//! ioctl (unsafe) ─► asking, device ─► formats, controls, knob ──┐
//!       └─► stream (buffers) ─► pixels ─────────────────┴─► Camera: rests, streams, is down and comes back
//! ```
//! A camera that is lost is looked for again by identity, at growing intervals of one second at most and whenever
//! something changes in `/dev`.

mod asking;
mod controls;
mod device;
mod error;
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
pub use error::CameraError;
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
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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
