//! What a pixel costs in operations: counted, not measured.
//!
//! What comes in: shipped models. What goes out: the tables of [docs/flops.md](../../../docs/flops.md) and its figure, the same
//! on every machine; a test compares them with the page.

pub mod counts;
mod figure;
pub mod page;
