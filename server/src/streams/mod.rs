//! A subscription in, messages on a socket out.

pub mod body;
pub mod websocket;
