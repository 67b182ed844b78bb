//! The service: models, sources, sessions and streams.
//!
//! It takes documents over HTTP and frames from `capture` and from clients; it sends estimates over WebSocket, server-sent
//! events or NDJSON, and answers in JSON (`isophote_wire`). It contains no mathematics: frames are evaluated by the tracker.
//!
//! ```text
//! source thread ──latest wins──► fit thread ──► Hub ──ring, a cursor per subscriber──► WebSocket, SSE, NDJSON
//!  FrameSource      Inbox         Tracker        ▲
//!                     ▲ swap, between two frames │
//! HTTP ─► routes ─► compile thread ──────────────┘ Registry, Sessions, Sources
//!              └─► Workshop ─► what was prepared ─► compile thread
//! ```
//! Every request passes `http/guard.rs` first, which identifies its sender by `access`.
//! Only `net`, `http` and `access` read requests; the others know of HTTP no more than a status code or an entity tag.
//! Sources, sessions and the compiler are named threads, joined with a deadline when the service stops.

mod access;
mod check;
mod counters;
mod http;
mod hub;
pub mod limits;
mod name;
mod net;
mod preview;
mod problem;
mod recording;
mod registry;
mod service;
mod session;
mod source;
mod store;
#[cfg(test)]
mod test_log;
mod thread;

pub use access::{
    AccessError, AccessOptions, HostName, Role, Secret, TlsError, TlsFiles, TokenError, TokenFile, TokenRecord,
};
pub use check::{StartFinding, check};
pub use net::listener::{Options, Server, Signals, StartError, Stopped};
pub use recording::RecordingQuota;
