//! A disk that refuses every change: 507, and nothing is changed.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::http::StatusCode;
use isophote_jit::VectorWidth;
use isophote_wire::ModelAnswer;
use serde_json::{Value, json};

use super::{Put, Service};
use crate::http::preconditions::Preconditions;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{Media, ModelEntry};
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;
use crate::service::machine::Machine;
use crate::session::SlowModels;
use crate::store::{MemoryStore, Record, RecordTable, Store, StoreError, Transaction};

/// Refuses changes while it is full.
#[derive(Default)]
pub(super) struct Disk {
    records: MemoryStore,
    is_full: AtomicBool,
}

impl Disk {
    /// Sets whether changes are refused.
    pub(super) fn fill(&self, is_full: bool) {
        self.is_full.store(is_full, Ordering::SeqCst);
    }
}

impl Store for Disk {
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError> {
        self.records.get(table, key)
    }
    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError> {
        self.records.list(table)
    }
    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError> {
        match self.is_full.load(Ordering::SeqCst) {
            true => Err(StoreError::Failed("no space left".into())),
            false => self.records.commit(transaction),
        }
    }
}

fn name(text: &str) -> Name {
    Name::parse(text).unwrap()
}

fn source(rate_hz: u32) -> Value {
    json!({"kind": "synthetic", "model": "spot", "width": 64, "height": 48, "samples": 1, "rate_hz": rate_hz, "pace": "fit"})
}

/// Checks a document on this thread.
pub(super) fn checked_at_once(
    service: &Service,
    model: &str,
    document: &Value,
) -> Result<(ModelEntry, ModelAnswer), Problem> {
    service.check_model(&name(model), Media::Json, &document.to_string(), &service.workshop.at_once())
}

/// Prepares a swap on this thread and commits it.
pub(super) fn swap_at_once(service: &Service, owner: &mut Owner, session: &str, model: &str) -> Result<(), Problem> {
    let (running, entry) = (service.session(session)?, service.registry.get(model)?);
    let prepared = running.prepare_swap(&entry, SlowModels::Allowed, &service.workshop.at_once())?;
    service.commit_swap(owner, session, &running, &entry, prepared).map(drop)
}

fn put_model(service: &Service, start: u32) -> Result<(), Problem> {
    let document = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                          "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}});
    let prepared = checked_at_once(service, "level", &document)?;
    service.put_model(&mut Owner::new(), &name("level"), &Preconditions::default(), prepared).map(drop)
}

fn roll_back(service: &Service, version: u64) -> Result<(), Problem> {
    let content = service.registry.version(&name("level"), version)?;
    let workers = service.workshop.at_once();
    let prepared = service.check_model(&name("level"), content.media, &content.text, &workers)?;
    service.roll_back_model(&mut Owner::new(), &name("level"), &Preconditions::default(), version, prepared).map(drop)
}

fn put_source(service: &Service, called: &str, rate_hz: u32) -> Result<Put, Problem> {
    service.put_source(
        &mut Owner::new(),
        &name(called),
        serde_json::from_value(source(rate_hz)).unwrap(),
        None,
        Keeping::Declared,
    )
}

fn put_session(service: &Service, called: &str, rate_hz: u32) -> Result<(), Problem> {
    let document = json!({"source": source(rate_hz), "model": "spot"});
    service
        .put_session(
            &mut Owner::new(),
            &name(called),
            serde_json::from_value(document).unwrap(),
            None,
            None,
            Keeping::Declared,
        )
        .map(drop)
}

/// The published state, without keys that change by themselves.
fn seen(service: &Service) -> Value {
    let mut sessions = serde_json::to_value(service.session_views()).unwrap();
    for session in sessions.as_array_mut().unwrap() {
        for key in ["state", "frames", "dropped", "rate_hz", "last", "over_budget", "searches", "cost_ms"] {
            session.as_object_mut().unwrap().remove(key);
        }
    }
    let models: Vec<_> = service.registry.list().iter().map(|entry| entry.tag().to_string()).collect();
    let versions = service.registry.versions("level").unwrap();
    json!([models, versions, service.source_views(), sessions])
}

type Change<'a> = &'a dyn Fn() -> Result<(), Problem>;

#[test]
fn refused_commits_change_nothing() {
    let disk = Arc::new(Disk::default());
    let service = Service::of_store(disk.clone(), Arc::new(Machine::of_machine(VectorWidth::default()))).unwrap();
    put_model(&service, 1).unwrap();
    put_model(&service, 2).unwrap();
    assert_eq!(put_source(&service, "one", 100), Ok(Put::Created));
    put_session(&service, "one", 100).unwrap();
    let before = seen(&service);
    let changes: [(&str, Change); 11] = [
        ("put model", &|| put_model(&service, 3)),
        ("roll back", &|| roll_back(&service, 1)),
        ("remove model", &|| service.remove_model(&mut Owner::new(), &name("level"), &Preconditions::default())),
        ("remove shipped model", &|| service.remove_model(&mut Owner::new(), &name("ring"), &Preconditions::default())),
        ("put source", &|| put_source(&service, "two", 100).map(drop)),
        ("replace source", &|| put_source(&service, "one", 50).map(drop)),
        ("remove source", &|| service.remove_source(&mut Owner::new(), &name("one"))),
        ("put session", &|| put_session(&service, "two", 100)),
        ("replace session", &|| put_session(&service, "one", 50)),
        ("swap", &|| swap_at_once(&service, &mut Owner::new(), "one", "gaussian")),
        ("remove session", &|| service.remove_session(&mut Owner::new(), &name("one")).map(drop)),
    ];
    for (what, change) in &changes {
        disk.fill(true);
        let problem = change().unwrap_err();
        assert_eq!((problem.status, problem.code), (StatusCode::INSUFFICIENT_STORAGE, "storage"), "{what}");
        assert_eq!(seen(&service), before, "{what}");
    }
    // Control: on a disk with space each of them changes something.
    for (what, change) in changes {
        let before = seen(&service);
        disk.fill(false);
        if what == "remove model" {
            continue; // `seen` needs its versions
        }
        change().unwrap();
        if what != "swap" {
            assert_ne!(seen(&service), before, "{what}");
        }
    }
    service.stop();
}
