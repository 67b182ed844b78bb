//! Every JSON type that crosses the network or that a command prints, in one place.
//!
//! What comes in: values of tracker and of server. What goes out: serde types whose field names are fixed in the
//! contract. They never know axum, sockets or threads, so that a client uses them without the server (`http` off).

mod answer;
mod document;
mod estimate;
mod named;

pub use answer::*;
pub use document::*;
pub use estimate::*;
pub use named::Named;
