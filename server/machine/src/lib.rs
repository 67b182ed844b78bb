//! The machine's clock and threads, as the crates that are pure are handed them, and how far a TCP connection's peer has come.
//!
//! What comes in: nothing. What goes out: [`monotonic_ns`], the clock of every `*_ns` field but those of the wall clock
//! ([`unix_ms`], [`unix_ns_at`]: labels for people), [`thread_ns`], [`program_checksum`], [`PeerProgress`], and [`Threads`], which
//! derives and compiles stages side by side. It never knows what is timed, sent or computed.

mod clock;
mod peer;
mod program;
mod threads;

pub use clock::{elapsed_ms, monotonic_ns, rfc3339, thread_ns, unix_ms, unix_ns_at};
pub use peer::PeerProgress;
pub use program::program_checksum;
pub use threads::Threads;
