//! A subscription in, messages on a socket out; frames on a socket in, their estimates out.

pub mod body;
pub mod frames;
pub mod pushed;
pub mod websocket;
