//! Streams: estimates and previews to clients, and pushed frames from clients.

pub mod body;
pub mod frames;
pub mod latest;
mod pace;
pub mod preview;
pub mod pushed;
pub mod websocket;
