//! Poses of three round spots: rendered in true perspective with the noise of a camera, found again, compared with the truth
//! and with the Cramér–Rao bound.
//!
//! What comes in: a seed. What goes out: the tables of [docs/pose-accuracy.md](../../../docs/pose-accuracy.md).

pub mod bound;
pub mod cell;
pub mod cold;
pub mod disturbed;
pub mod light;
pub mod methods;
pub mod scene;
pub mod table;
pub mod thesis;
pub mod told;
