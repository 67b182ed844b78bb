//! Poses of three round spots: rendered in true perspective with camera noise, estimated, and compared with the truth
//! and the Cramér–Rao bound, for [docs/pose-accuracy.md](../../../docs/pose-accuracy.md).

pub mod bound;
pub mod cell;
pub mod cold;
pub mod disturbed;
pub mod light;
pub mod methods;
pub mod scene;
pub mod table;
pub mod tally;
pub mod thesis;
