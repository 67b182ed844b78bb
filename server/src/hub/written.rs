//! `WrittenEstimate`: an estimate as JSON, written once for all subscribers. `SentEstimate`: the same for one subscriber, with
//! its `dropped` and with or without the trace.

use std::sync::Arc;

use isophote_wire::{EstimateView, TraceView};

use crate::hub::event_id::{EventId, life};

/// Spare capacity beyond the length of the estimate before: numbers may have more digits.
const SPARE_BYTES: usize = 64;

/// An estimate as JSON.
#[derive(Debug, PartialEq)]
pub struct WrittenEstimate {
    /// The number of its frame.
    pub frame: u64,
    /// The target's id.
    pub target: String,
    life: String,
    /// The JSON without the digits of `dropped`.
    text: String,
    /// Offset of these digits in `text`.
    at: usize,
    trace: String,
}

impl WrittenEstimate {
    /// Writes an estimate without a trace, and the trace that goes with it. `bytes` is the expected length of the text, if
    /// known: it is then written without reallocation.
    pub fn of(estimate: &EstimateView, trace: &[TraceView], bytes: Option<usize>) -> Arc<WrittenEstimate> {
        // Quotes in a user's string would be escaped, and objects with users' keys come later.
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

    /// Length of the text, to size the next one.
    pub fn text_bytes(&self) -> usize {
        self.text.len()
    }

    /// Memory that it uses.
    pub fn bytes(&self) -> usize {
        let text = self.target.len() + self.life.len() + self.text.capacity() + self.trace.capacity();
        size_of::<WrittenEstimate>() + text
    }
}

/// Whether estimates include the trace of the fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
pub enum TraceWish {
    /// Without the trace.
    #[default]
    #[serde(rename = "0")]
    Without,
    /// With the trace.
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
    /// An estimate for a subscriber that lost `dropped` frames before it. `before` is for a subscriber that may return: of
    /// other targets it has had no later frame.
    pub fn new(written: Arc<WrittenEstimate>, dropped: u64, wish: TraceWish, before: Option<u64>) -> SentEstimate {
        SentEstimate { written, dropped, wish, before }
    }

    /// The id of this event: what the subscriber has had, including it.
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
        // Concatenated at once: nothing is copied again as the text grows.
        match (after.strip_suffix('}'), trace) {
            (Some(after), Some(trace)) => [before, &dropped, after, ",\"trace\":", trace, "}"].concat(),
            _ => [before, &dropped, after].concat(),
        }
    }
}
