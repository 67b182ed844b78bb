//! A subscription in, messages on a socket out, pictures among them; frames on a socket in, their estimates out.

pub mod body;
pub mod frames;
pub mod latest;
mod pace;
pub mod preview;
pub mod pushed;
pub mod websocket;
