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
pub mod clutter;
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
pub mod reliability;
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
