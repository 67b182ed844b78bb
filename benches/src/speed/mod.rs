//! The cost of a pixel in time.
//!
//! Makes the tables of [docs/speed.md](../../../docs/speed.md) on pictures of a shipped model's spot: Isophote's
//! kernels against the same loops by other compilers and against the thesis' code, alternating. Accuracy is measured
//! by [`crate::accuracy`]; neither imports from the other.

pub mod against;
pub mod appendix;
pub mod compile_time;
pub mod contenders;
pub mod foreign;
pub mod frame;
pub mod race;
pub mod tables;
pub mod windows;
