//! `WrittenEstimate`: an estimate as JSON, written once for all subscribers. `SentEstimate`: the same for one of them.
//!
//! What differs between subscribers is one number, and whether the steps of the fits are told.

use std::sync::Arc;

use isophote_wire::{EstimateView, TraceView};

use crate::event_id::{EventId, life};

/// By so much an estimate may be longer than the one before it, for nothing: numbers have more digits, or fewer.
const SPARE_BYTES: usize = 64;

/// See above.
#[derive(Debug, PartialEq)]
pub struct WrittenEstimate {
    /// The number of its frame.
    pub frame: u64,
    /// The target's id.
    pub target: String,
    life: String,
    /// All but the digits of what the subscriber has lost, …
    text: String,
    /// … which stand here.
    at: usize,
    trace: String,
}

impl WrittenEstimate {
    /// An estimate without a trace, and the trace that goes with it. The text will have about so many `bytes`, where that is known: it
    /// is written in one piece then, in memory that need not grow.
    pub fn of(estimate: &EstimateView, trace: &[TraceView], bytes: Option<usize>) -> Arc<WrittenEstimate> {
        // In a string of the user's the quotes would be escaped, and objects with names of the user's come later.
        const KEY: &str = "\"dropped\":";
        let mut text = Vec::with_capacity(bytes.map_or(0, |bytes| bytes + SPARE_BYTES));
        let written = serde_json::to_writer(&mut text, estimate).ok().and_then(|()| String::from_utf8(text).ok());
        let mut text = written.unwrap_or_default();
        let at = text.find(KEY).map_or(text.len(), |at| at + KEY.len());
        let digits = text[at..].bytes().take_while(u8::is_ascii_digit).count();
        text.replace_range(at..at + digits, "");
        if bytes.is_none() {
            text.shrink_to_fit();
        }
        let trace = if trace.is_empty() { String::new() } else { serde_json::to_string(trace).unwrap_or_default() };
        let (frame, target) = (estimate.frame, estimate.target.clone());
        Arc::new(WrittenEstimate { frame, target, life: life(estimate), text, at, trace })
    }

    /// Of the text, for the next one.
    pub fn text_bytes(&self) -> usize {
        self.text.len()
    }

    /// Memory that it takes.
    pub fn bytes(&self) -> usize {
        let text = self.target.len() + self.life.len() + self.text.capacity() + self.trace.capacity();
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
    before: Option<u64>,
}

impl SentEstimate {
    /// For one who lost so many before it. Of one that may come back: it has had no later frame of some other target than the one
    /// `before`.
    pub fn new(written: Arc<WrittenEstimate>, dropped: u64, wish: TraceWish, before: Option<u64>) -> SentEstimate {
        SentEstimate { written, dropped, wish, before }
    }

    /// Says what the subscriber has had with this one.
    pub fn event_id(&self) -> EventId {
        let WrittenEstimate { frame, target, life, .. } = &*self.written;
        let partial = self.before.map(|before| (target.clone(), before));
        EventId { frame: *frame, partial, life: Some(life.clone()) }
    }

    /// As JSON, `dropped` filled in.
    pub fn json(&self) -> String {
        let WrittenEstimate { text, at, trace, .. } = &*self.written;
        let (before, after) = text.split_at(*at);
        let trace = Some(trace).filter(|trace| self.wish == TraceWish::With && !trace.is_empty());
        let dropped = self.dropped.to_string();
        // All of it at once: what is sent is not copied again as it grows.
        match (after.strip_suffix('}'), trace) {
            (Some(after), Some(trace)) => [before, &dropped, after, ",\"trace\":", trace, "}"].concat(),
            _ => [before, &dropped, after].concat(),
        }
    }
}
