//! What a pixel costs in time: the stopwatch.
//!
//! What comes in: a picture of a shipped model's spot. What goes out: the tables of [docs/speed.md](../../../docs/speed.md), our
//! kernels beside the same loops by other compilers and beside the thesis' code, all taking turns. It asks for no answer's
//! accuracy: that is [`crate::accuracy`]'s, and neither imports from the other.

pub mod against;
pub mod appendix;
pub mod compile_time;
pub mod contenders;
pub mod foreign;
pub mod frame;
pub mod race;
pub mod tables;
pub mod windows;
