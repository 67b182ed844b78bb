//! Errors of estimates relative to the Cramér–Rao bound.
//!
//! For each condition of light: the error of the tracker's answers over the bound, the failure rate, and the
//! consistency of the covariance; as tables and figures of [docs/accuracy.md](../../../docs/accuracy.md). Only the
//! tracker's public interface is used, and the renderer is independent of the documents: it has its own formula, noise
//! and clipping.
//!
//! ```text
//! condition ─► scene ─► light ─► sensor ─► Frame ─► Tracker ─► trial ─► summary ─► table, figure
//!              drawn      └────► bound (CRLB) ────────────────────────────┘
//! ```
//!
//! Further studies: verdicts, poses, colour, searches and photographs.

pub mod basin;
pub mod bound;
pub mod colour;
pub mod condition;
pub mod consistency;
pub mod curves;
pub mod document;
pub mod held_out;
pub mod light;
pub mod peers;
#[allow(missing_docs)] // fields of tables
pub mod pose;
pub mod real;
pub mod report;
pub mod run;
pub mod sampling;
pub mod scene;
pub mod search;
pub mod sensor;
pub mod summary;
pub mod table;
pub mod trial;
#[allow(missing_docs)] // fields of tables
pub mod verdict;

/// Maps `work` over the frames on all processors.
fn shared_out<T: Send>(frames: usize, work: impl Fn(u64) -> T + Sync) -> Vec<Vec<T>> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let part = |first: usize| -> Vec<T> { (first..frames).step_by(threads).map(|seed| work(seed as u64)).collect() };
    std::thread::scope(|scope| {
        let started: Vec<_> = (0..threads).map(|first| scope.spawn(move || part(first))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}
