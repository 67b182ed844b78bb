//! The cost of a pixel in operations: counted, not measured.
//!
//! Makes the tables of [docs/flops.md](../../../docs/flops.md) and its figure, the same on every machine; a test
//! compares them with the page.

pub mod counts;
mod figure;
pub mod page;
