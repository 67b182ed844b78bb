//! HTTP: a request passes `guard`, finds its tenant and its route, and is answered or becomes a stream.
//!
//! Handlers move documents between clients and the service; they compute nothing.

pub mod app;
pub mod documents;
pub mod exposition;
pub mod guard;
mod objects;
mod openings;
pub mod preconditions;
mod restore;
pub mod routes;
pub mod streams;
pub mod tenants;
