//! What the log has of changes leads from an empty service to the same declarations.

#![allow(clippy::unwrap_used)]

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;

use isophote_jit::VectorWidth;
use serde_json::{Value, json};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Metadata, Subscriber};

use super::Service;
use super::drawn::{Draws, SimulatedEvent};
use super::simulation::Simulation;
use crate::command::Command;
use crate::commons::Commons;
use crate::compiler::Owner;
use crate::limits::LIMITS;

/// What is declared, without times and epochs.
fn declarations(service: &Service) -> Value {
    let models = service.registry.list().into_iter();
    let models = models.map(|entry| json!([entry.name.as_str(), entry.version, entry.model.digest()]));
    let sources = service.source_views().into_iter().map(|view| json!([view.name, view.document]));
    let sessions = service.session_views().into_iter();
    let sessions = sessions.map(|view| json!([view.name, view.document, view.active_model, view.active_digest]));
    json!([models.collect::<Vec<_>>(), sources.collect::<Vec<_>>(), sessions.collect::<Vec<_>>()])
}

thread_local! {
    /// What was done, where this thread wants to know.
    static DONE: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// The log of all tests: of a subscriber for one thread alone, others that are first to say something would hide it.
struct ChangeLog;

#[derive(Default)]
struct Fields(BTreeMap<&'static str, String>);

impl Visit for Fields {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.0.insert(field.name(), value.to_string());
    }
    fn record_debug(&mut self, _field: &Field, _value: &dyn Debug) {}
}

impl Subscriber for ChangeLog {
    fn enabled(&self, _metadata: &Metadata<'_>) -> bool {
        true
    }
    fn event(&self, said: &tracing::Event<'_>) {
        DONE.with_borrow_mut(|done| {
            let Some(done) = done else { return };
            let mut fields = Fields::default();
            said.record(&mut fields);
            if fields.0.get("outcome").is_some_and(|outcome| outcome == "done") {
                done.push(fields.0["command"].clone());
            }
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

#[test]
fn the_log_of_changes_leads_to_the_same_declarations() {
    tracing::subscriber::set_global_default(ChangeLog).unwrap();
    tracing::callsite::rebuild_interest_cache(); // of what was said before there was a log
    let (mut draws, mut simulation) = (Draws(2), Simulation::new());
    DONE.set(Some(Vec::new()));
    for _ in 0..1_000 {
        let event = draws.event(&simulation.books);
        if matches!(event, SimulatedEvent::Killed) {
            // Too many that died keep sessions from running, and what does not run keeps nothing in use.
            simulation.run(SimulatedEvent::EmptyDisk);
            simulation.run(SimulatedEvent::Waited(LIMITS.start_time));
        }
        simulation.run(event);
    }
    let done = DONE.take().unwrap();
    assert!(done.len() > 200, "{}", done.len());
    let (replayed, mut owner) =
        (Service::open(None, &Arc::new(Commons::of_machine(VectorWidth::default()))).unwrap(), Owner::new());
    for line in &done {
        let command: Command = serde_json::from_str(line).unwrap();
        assert_eq!(replayed.apply(&mut owner, command), Ok(()), "{line}");
    }
    assert_eq!(declarations(&replayed), declarations(&simulation.service));
    replayed.stop();
    simulation.service.stop();
}
