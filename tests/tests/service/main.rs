//! The service over real sockets: what a client may rely on.

#![allow(clippy::unwrap_used)]

mod access;
mod bounds;
mod budgets;
mod cameras;
mod client;
mod clocks;
mod commands;
mod configuration;
mod control;
mod deploy;
mod disk;
mod docs;
mod encryption;
mod exposure;
mod fairness;
mod guards;
mod hostile;
mod images;
mod killing;
mod light;
mod logs;
mod malformed;
mod metrics;
mod models;
mod openapi;
mod paths;
mod playback;
mod preview;
mod pushing;
mod recorded;
mod recorder;
mod recordings;
mod replayed;
mod restarts;
mod scenes;
mod sessions;
mod shadows;
mod streams;
mod swaps;
mod targets;
mod tenants;
mod versions;
mod volumes;
