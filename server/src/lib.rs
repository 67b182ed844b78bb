//! The service: models, sources, sessions and streams.
//!
//! What comes in: documents over HTTP, frames from `capture` and from clients. What goes out: estimates over WebSocket, server-sent events
//! or NDJSON, and answers in JSON ([`wire`]). It contains no mathematics: what a frame says, the tracker says.
//!
//! ```text
//! source thread ──latest wins──► fit thread ──► Hub ──queue a subscriber──► WebSocket, SSE, NDJSON
//!  FrameSource      Inbox         Tracker        ▲
//!                     ▲ swap, between two frames │
//! HTTP ─► routes ─► compile thread ──────────────┘ Registry, Sessions, Sources
//! ```
//! Only `routes`, `streams`, `guard` and `listener` know HTTP; only they are async. Sources, sessions and the compiler are
//! named threads, joined when the service stops. Without the feature `http` the crate is its wire types, the clock
//! and the reports and explanations that the service and the commands print alike.

pub mod clock;
pub mod explain;
pub mod export;
mod threads;
pub mod wire;

#[cfg(feature = "http")]
mod compiler;
#[cfg(feature = "http")]
mod demo;
#[cfg(feature = "http")]
mod documents;
#[cfg(feature = "http")]
mod guard;
#[cfg(feature = "http")]
mod hub;
#[cfg(feature = "http")]
pub mod limits;
#[cfg(feature = "http")]
mod listener;
#[cfg(feature = "http")]
mod name;
#[cfg(feature = "http")]
mod problem;
#[cfg(feature = "http")]
mod registry;
#[cfg(feature = "http")]
mod routes;
#[cfg(feature = "http")]
mod service;
#[cfg(feature = "http")]
mod session;
#[cfg(feature = "http")]
mod source;
#[cfg(feature = "http")]
mod store;
#[cfg(feature = "http")]
mod streams;

pub use threads::Threads;

#[cfg(feature = "http")]
pub use listener::{Options, Server, StartError};
