//! The JSON types of documents, answers and estimates, for server, client and Python, in one place.
//!
//! What comes in: values of tracker, capture and the crates below. What goes out: serde types whose field names are fixed in the
//! contract, and [`explain`], the answer about a model that service and commands print alike. It never knows axum, sockets,
//! threads or a clock: times are handed in.

mod answer;
mod control;
mod document;
mod estimate;
pub mod explain;
mod named;
mod playback;
mod preview;
mod recording;
mod shadow;
mod tracker_options;

pub use answer::*;
pub use control::*;
pub use document::*;
pub use estimate::*;
pub use named::Named;
pub use playback::*;
pub use preview::*;
pub use recording::*;
pub use shadow::*;
pub use tracker_options::{options, options_known};
