//! The sockets of the service: connections are accepted and limited here, and handed to `http`.

pub mod connection_limits;
pub mod gate;
pub mod listener;
pub mod quota;
pub mod socket;
