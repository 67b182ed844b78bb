//! `WrittenEstimate`: an estimate as JSON, written once for all subscribers. `SentEstimate`: the same for one of them.
//!
//! What differs between subscribers is one number, and whether the steps of the fits are told.

use std::sync::Arc;

use isophote_wire::{EstimateView, TraceView};

/// See above.
#[derive(Debug, PartialEq)]
pub struct WrittenEstimate {
    /// The number of its frame.
    pub frame: u64,
    /// The target's id.
    pub target: String,
    before: String,
    after: String,
    trace: String,
}

impl WrittenEstimate {
    /// An estimate without a trace, and the trace that goes with it.
    pub fn of(estimate: &EstimateView, trace: &[TraceView]) -> Arc<WrittenEstimate> {
        // In a string of the user's the quotes would be escaped, and objects with names of the user's come later.
        const KEY: &str = "\"dropped\":";
        let mut before = serde_json::to_string(estimate).unwrap_or_default();
        let at = before.find(KEY).map_or(before.len(), |at| at + KEY.len());
        let after = before.split_off(at).trim_start_matches(|c: char| c.is_ascii_digit()).to_string();
        let trace = if trace.is_empty() { String::new() } else { serde_json::to_string(trace).unwrap_or_default() };
        let (frame, target) = (estimate.frame, estimate.target.clone());
        Arc::new(WrittenEstimate { frame, target, before, after, trace })
    }

    /// Memory that it takes.
    pub fn bytes(&self) -> usize {
        let text = self.target.len() + self.before.capacity() + self.after.capacity() + self.trace.capacity();
        size_of::<WrittenEstimate>() + text
    }
}

/// Whether a subscriber is told the steps of the fits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
pub enum TraceWish {
    /// It is not.
    #[default]
    #[serde(rename = "0")]
    Without,
    /// It is.
    #[serde(rename = "1")]
    With,
}

/// An estimate for one subscriber.
#[derive(Clone, Debug, PartialEq)]
pub struct SentEstimate {
    written: Arc<WrittenEstimate>,
    dropped: u64,
    wish: TraceWish,
}

impl SentEstimate {
    /// For one who lost so many before it.
    pub fn new(written: Arc<WrittenEstimate>, dropped: u64, wish: TraceWish) -> SentEstimate {
        SentEstimate { written, dropped, wish }
    }

    /// The number of its frame.
    pub fn frame(&self) -> u64 {
        self.written.frame
    }

    /// As JSON, `dropped` filled in.
    pub fn json(&self) -> String {
        let WrittenEstimate { before, after, trace, .. } = &*self.written;
        match after.strip_suffix('}') {
            Some(after) if self.wish == TraceWish::With && !trace.is_empty() => {
                format!("{before}{}{after},\"trace\":{trace}}}", self.dropped)
            }
            _ => format!("{before}{}{after}", self.dropped),
        }
    }
}
