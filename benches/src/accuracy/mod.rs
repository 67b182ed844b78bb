//! How right estimates are, beside how right they can be.
//!
//! What comes in: shipped documents and a seed. What goes out: for each condition of light the error of the tracker's
//! answers over the Cramér–Rao bound, how often it fails, and whether its covariance says the truth; as tables and figures
//! of [docs/accuracy.md](../../../docs/accuracy.md). It asks the tracker through its public door alone, and the renderer
//! knows nothing of the documents: it has a formula, noise and clipping of its own.
//!
//! ```text
//! condition ─► scene ─► light ─► sensor ─► Frame ─► Tracker ─► trial ─► summary ─► table, figure
//!              drawn      └────► bound (CRLB) ────────────────────────────┘
//! ```
//!
//! Beside it stand the studies of verdicts, of poses, of colour, of searches and of photographs.

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

/// `work` for each frame, on all processors.
fn shared_out<T: Send>(frames: usize, work: impl Fn(u64) -> T + Sync) -> Vec<Vec<T>> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let part = |first: usize| -> Vec<T> { (first..frames).step_by(threads).map(|seed| work(seed as u64)).collect() };
    std::thread::scope(|scope| {
        let started: Vec<_> = (0..threads).map(|first| scope.spawn(move || part(first))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}
