//! V4L2 cameras: the newest frame ([`LiveCamera::next`]), device lists ([`cameras`]) and controls ([`set_controls`]).
//!
//! Frames carry the driver's time and a number whose gaps count lost frames. No wait exceeds its limit unless a driver call
//! hangs, which blocks its caller. Only identity queries run on threads of their own, so that one hung device does not delay
//! the others.
//!
//! ```text
//! ioctl (unsafe) ─► asking, device ─► formats, controls, knob ──┐
//!       └─► stream (buffers) ─► pixels ─────────────────┴─► LiveCamera: resting, running, lost and found
//! ```
//! A lost camera is looked for by identity, at growing intervals of at most one second and after every change in `/dev`.

mod controls;
mod device;
mod error;
mod formats;
mod ioctl;
mod light_control;
mod live;
mod queries;
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

/// Camera settings that a document requests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraSpec {
    /// A path such as `/dev/video0`, or an identity as [`cameras`] lists it.
    pub device: String,
    /// Requested picture format.
    pub format: FormatWanted,
    /// Selected colours.
    pub colour: Colour,
    /// Set before the first frame and after every reconnection.
    pub controls: ControlValues,
}

/// State of a camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraState {
    /// Closed: other programs may use it.
    Resting,
    /// Frames arrive, or will soon.
    Running,
    /// It streams but delivers no pictures; the reason.
    Stalled(String),
    /// It is gone or cannot be opened; the reason. It is looked for again.
    Lost(String),
}

/// Identity, settings and frame losses of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CameraStatus {
    /// Present or last device node.
    pub device: String,
    /// Name for documents; unchanged when the camera is plugged in again.
    pub identity: String,
    /// Pixel format: four-character code without trailing blanks.
    pub format: String,
    /// Width of the sensor's pictures, px.
    pub width: u32,
    /// Height of the sensor's pictures, px.
    pub height: u32,
    /// Frame rate that the driver reports, Hz; absent if it reports none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rate_hz: Option<f64>,
    /// Values of the document's controls, as read back from the driver.
    pub controls_taken: ControlValues,
    /// Frames missing from the driver's sequence numbers.
    pub gaps: u64,
    /// Frames that the driver flagged as erroneous, that were too short, or that could not be decoded.
    pub damaged: u64,
    /// Valid frames that were dropped because a newer one was available.
    pub overtaken: u64,
    /// Number of times that the camera was reopened after it was lost.
    pub reconnects: u64,
}
