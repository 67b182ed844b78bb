//! Why a camera cannot be used, and which key of a document is to blame.

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
    /// Its driver was asked who it is, and has not said anything.
    #[error("the driver of {device} does not answer; unplug the camera and plug it in again")]
    Silent {
        /// What was asked for; where that is no path, the devices that do not answer.
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
