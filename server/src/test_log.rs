//! Captures the log of tests by thread. One global subscriber: a callsite that another thread hits first would be disabled for
//! a subscriber of one thread.

#![allow(clippy::unwrap_used)]

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Once;

use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// An event with its fields as text.
pub(crate) struct LoggedEvent {
    pub level: Level,
    pub fields: BTreeMap<&'static str, String>,
}

thread_local! {
    static EVENTS: RefCell<Option<Vec<LoggedEvent>>> = const { RefCell::new(None) };
}

/// The events that this thread logs while `run` runs.
pub(crate) fn logged(run: impl FnOnce()) -> Vec<LoggedEvent> {
    static SUBSCRIBER: Once = Once::new();
    SUBSCRIBER.call_once(|| {
        tracing::subscriber::set_global_default(TestLog).unwrap();
        tracing::callsite::rebuild_interest_cache(); // of callsites hit before there was a subscriber
    });
    EVENTS.set(Some(Vec::new()));
    run();
    EVENTS.take().unwrap()
}

impl Visit for LoggedEvent {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.fields.insert(field.name(), value.to_string());
    }
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.fields.insert(field.name(), format!("{value:?}"));
    }
}

struct TestLog;

impl Subscriber for TestLog {
    fn enabled(&self, _metadata: &Metadata<'_>) -> bool {
        true
    }
    fn event(&self, event: &Event<'_>) {
        EVENTS.with_borrow_mut(|events| {
            let Some(events) = events else { return };
            let mut logged = LoggedEvent { level: *event.metadata().level(), fields: BTreeMap::new() };
            event.record(&mut logged);
            events.push(logged);
        });
    }
    fn new_span(&self, _span: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }
    fn record(&self, _span: &Id, _values: &Record<'_>) {}
    fn record_follows_from(&self, _span: &Id, _follows: &Id) {}
    fn enter(&self, _span: &Id) {}
    fn exit(&self, _span: &Id) {}
}
