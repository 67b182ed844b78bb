//! The JSON types of documents, answers and estimates, shared by server, client and Python.
//!
//! Field names are fixed in the contract. [`explain`] makes the answer about a model that service and commands print
//! alike. Times are passed in: the crate has no axum, sockets, threads or clock.

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
