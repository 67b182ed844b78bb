//! The machine's clocks and threads, which pure crates take as arguments, and the progress of a TCP peer.
//!
//! [`monotonic_ns`] is the clock of every `*_ns` field, except wall-clock fields ([`unix_ms`], [`unix_ns_at`]: labels for
//! people). [`Threads`] derives and compiles stages concurrently.

mod clock;
mod peer;
mod program;
mod threads;

pub use clock::{elapsed_ms, monotonic_ns, rfc3339, thread_ns, unix_ms, unix_ns_at};
pub use peer::PeerProgress;
pub use program::program_checksum;
pub use threads::Threads;
