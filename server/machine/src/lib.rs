//! The machine's clock and threads, as the crates that are pure are handed them.
//!
//! What comes in: nothing. What goes out: [`monotonic_ns`], the clock of every `*_ns` field, [`thread_ns`], [`unix_ms`], a label for people, [`program_checksum`], and [`Threads`], which derives and
//! compiles stages side by side. It never knows what is timed or computed.

mod clock;
mod program;
mod threads;

pub use clock::{elapsed_ms, monotonic_ns, rfc3339, thread_ns, unix_ms};
pub use program::program_checksum;
pub use threads::Threads;
