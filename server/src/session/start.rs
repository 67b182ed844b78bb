//! `SessionStart`: identifies one start of a session.

use std::sync::Arc;

/// One start of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionStart {
    /// The node that it runs on.
    pub node: Arc<str>,
    /// Unique to this start on that node.
    pub epoch: u64,
    /// Start time, wall clock.
    pub started_at: String,
    /// When it was declared, wall clock; `None` for the demo.
    pub declared_at: Option<String>,
    /// Number of service starts since then.
    pub restarts: u64,
}
