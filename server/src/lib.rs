//! The service: models, sources, sessions and streams.
//!
//! What comes in: documents over HTTP, frames from `capture` and from clients. What goes out: estimates over WebSocket, server-sent events
//! or NDJSON, and answers in JSON (`isophote_wire`). It contains no mathematics: what a frame says, the tracker says.
//!
//! ```text
//! source thread ──latest wins──► fit thread ──► Hub ──one ring, a place a subscriber──► WebSocket, SSE, NDJSON
//!  FrameSource      Inbox         Tracker        ▲
//!                     ▲ swap, between two frames │
//! HTTP ─► routes ─► compile thread ──────────────┘ Registry, Sessions, Sources
//!              └─► Workshop ─► what was prepared ─► compile thread
//! ```
//! Whoever asks passes `guard` first, which asks `access` who that is.
//! Only `routes`, `streams`, `access`, `guard` and `listener` know HTTP, and of its headers `preconditions`; only they are async.
//! Sources, sessions and the compiler are named threads, waited for when the service stops, and never for long.

mod access;
mod app;
mod capacity;
mod check;
mod command;
mod commons;
mod compiler;
mod counters;
mod declared;
mod demo;
mod documents;
mod event_id;
mod exposition;
mod gate;
mod guard;
mod hub;
pub mod limits;
mod listener;
mod name;
mod node;
mod objects;
mod openings;
mod places;
mod preconditions;
mod preview;
mod problem;
mod prompt;
mod recording;
mod registry;
mod restore;
mod ring;
mod room;
mod routes;
mod service;
mod session;
mod socket;
mod source;
mod store;
mod streams;
mod tenants;
#[cfg(test)]
mod test_log;
mod thread;
mod turns;
mod watchdog;
mod workshop;
mod written;

pub use access::{
    AccessError, AccessOptions, HostName, Role, Secret, TlsError, TlsFiles, TokenError, TokenFile, TokenRecord,
};
pub use check::{StartFinding, check};
pub use listener::{Options, Server, Signals, StartError, Stopped};
pub use recording::RecordingQuota;
