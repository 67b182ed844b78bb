//! Benchmarks of the whole way from a document to an estimate; see `benches/`.
//!
//! What comes in: shipped models and frames made here. What goes out: tables on standard output, for docs/results.md.
