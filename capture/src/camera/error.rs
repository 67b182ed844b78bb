//! Camera errors, and the document key that each concerns.

/// Why a camera cannot be used. Every message suggests a remedy.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// No such device.
    #[error("there is no camera {device}; {}", present_cameras(present))]
    Missing {
        /// Requested device.
        device: String,
        /// Cameras present.
        present: Vec<String>,
    },
    /// Permission denied.
    #[error("{device} may not be opened by this user; who may is in the group `video` on most systems")]
    Forbidden {
        /// Requested device.
        device: String,
    },
    /// Not a video device, or one without single-planar streaming capture.
    #[error("{device} is no camera that streams single-planar pictures; `isophote cameras` lists those that do")]
    NotACamera {
        /// Requested device.
        device: String,
    },
    /// The driver does not answer the identity query.
    #[error("the driver of {device} does not answer; unplug the camera and plug it in again")]
    Silent {
        /// Requested device; if that is not a path, the devices that do not answer.
        device: String,
    },
    /// Another program streams from it.
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
        /// Attempted operation, as a participle.
        doing: &'static str,
        /// Error of the operating system.
        reason: std::io::Error,
    },
    /// A format that the camera lacks or this program does not read.
    #[error("{device} does not offer {wanted}; of what is read here it offers {}", offered.join(", "))]
    Format {
        /// Its path.
        device: String,
        /// Requested format.
        wanted: String,
        /// Codes of the formats that can be read.
        offered: Vec<String>,
    },
    /// A size that the camera lacks.
    #[error("{device} has no pictures of {wanted} px in such a format; it offers {}", offered.join(", "))]
    Size {
        /// Its path.
        device: String,
        /// Requested size.
        wanted: String,
        /// Offered sizes, for display.
        offered: Vec<String>,
    },
    /// A single colour of a format without colours.
    #[error(
        "{device} sends {format}, which has no red, green or blue; leave `colour` out, or set `format` to one that has"
    )]
    Colour {
        /// Its path.
        device: String,
        /// Format code.
        format: String,
    },
    /// The driver sets another format than the requested one.
    #[error("{device} gives {given}, not {wanted}")]
    Changed {
        /// Its path.
        device: String,
        /// Format that the driver set.
        given: String,
        /// Requested format.
        wanted: String,
    },
    /// A control that the camera lacks or rejects.
    #[error("control {name}: {reason}")]
    Control {
        /// Name in the document.
        name: String,
        /// Fault and remedy.
        reason: String,
    },
}

fn present_cameras(present: &[String]) -> String {
    if present.is_empty() { "no camera is plugged in".into() } else { format!("there is {}", present.join(", ")) }
}

impl CameraError {
    /// Key of the source document at fault.
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
