//! `SessionStart`: which of a session's starts it is.

use std::sync::Arc;

/// One start of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionStart {
    /// Where it runs.
    pub node: Arc<str>,
    /// No other start on that node has it.
    pub epoch: u64,
    /// When it began, by the wall clock.
    pub started_at: String,
    /// When it was put, by the wall clock; nothing of the demo's.
    pub declared_at: Option<String>,
    /// How often the service was started since then.
    pub restarts: u64,
}
