//! Replaying the log of changes in an empty service gives the same declarations.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_jit::VectorWidth;
use serde_json::{Value, json};

use super::Service;
use super::drawn::{Draws, SimulatedEvent};
use super::simulation::Simulation;
use crate::limits::LIMITS;
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::service::machine::Machine;
use crate::test_log::logged;

/// The declarations, without times and epochs.
fn declarations(service: &Service) -> Value {
    let models = service.registry.list().into_iter();
    let models = models.map(|entry| json!([entry.name.as_str(), entry.version, entry.model.digest()]));
    let sources = service.source_views().into_iter().map(|view| json!([view.name, view.document]));
    let sessions = service.session_views().into_iter();
    let sessions = sessions.map(|view| json!([view.name, view.document, view.active_model, view.active_digest]));
    json!([models.collect::<Vec<_>>(), sources.collect::<Vec<_>>(), sessions.collect::<Vec<_>>()])
}

#[test]
fn replayed_change_log_restores_the_declarations() {
    let (mut draws, mut simulation) = (Draws(2), Simulation::new());
    let events = logged(|| {
        for _ in 0..1_000 {
            let event = draws.event(&simulation.books);
            if matches!(event, SimulatedEvent::Killed) {
                // Too many early deaths would keep sessions stopped, and stopped sessions keep nothing in use.
                simulation.run(SimulatedEvent::EmptyDisk);
                simulation.run(SimulatedEvent::Waited(LIMITS.start_time));
            }
            simulation.run(event);
        }
    });
    let done = events.iter().filter(|event| event.fields.get("outcome").is_some_and(|outcome| outcome == "done"));
    let done: Vec<&String> = done.map(|event| &event.fields["command"]).collect();
    assert!(done.len() > 200, "{}", done.len());
    let (replayed, mut owner) =
        (Service::open(None, &Arc::new(Machine::of_machine(VectorWidth::default()))).unwrap(), Owner::new());
    for line in &done {
        let command: Command = serde_json::from_str(line).unwrap();
        assert_eq!(replayed.apply(&mut owner, command), Ok(()), "{line}");
    }
    assert_eq!(declarations(&replayed), declarations(&simulation.service));
    replayed.stop();
    simulation.service.stop();
}
