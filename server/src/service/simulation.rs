//! Randomized test of the owner thread's changes: commands drawn from a seed, with frames, expiring leases, a full disk,
//! crashing starts and a simulated clock. After each command the answer and all declarations are compared with a reference
//! model.
//!
//! `ISOPHOTE_COMMANDS` sets the number of commands (a million takes minutes), `ISOPHOTE_SEED` the seed.

#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::http::{HeaderMap, HeaderValue, header};
use isophote_capture::Captured;
use isophote_jit::VectorWidth;
use isophote_wire::{ModelAnswer, SessionDocument, SessionState, SourceDocument, SourceReference};
use serde_json::json;
use tokio::sync::oneshot;

use super::Service;
use super::drawn::{Draws, SimulatedEvent};
use super::tests::{Disk, checked_at_once};
use crate::http::preconditions::Preconditions;
use crate::http::streams::pushed::{FrameMedia, decode};
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::service::machine::Machine;
use crate::session::inbox::Reply;
use crate::source::LeaseId;

const COMMANDS: u64 = 4_000;
/// Frame size of the sessions' own sources, px.
pub(super) const WIDTH: usize = 8;
const HEIGHT: usize = 6;
/// Value of every pixel.
const LIGHT: u8 = 100;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Runs {
    Yes,
    /// Its source is missing.
    Failed,
    /// Stopped after repeated crashes.
    Stopped,
}

#[derive(Clone, Debug)]
struct Declared {
    /// Of the document, and the active one.
    models: [String; 2],
    /// Constant of the active model.
    offset: u64,
    /// `None` if it has its own.
    source: Option<String>,
    runs: Runs,
}

/// The reference model: the expected state.
#[derive(Default)]
pub(super) struct Books {
    /// Time since the simulation began, and when the process started.
    clock: Duration,
    started: Duration,
    /// Holder of each source's lease, and its expiry.
    leases: BTreeMap<String, (u64, Duration)>,
    /// Constants of the documents by version, from 1, and the active version.
    pub(super) models: BTreeMap<String, (Vec<u64>, usize)>,
    /// Widths of the sources.
    sources: BTreeMap<String, usize>,
    sessions: BTreeMap<String, Declared>,
    is_full: bool,
    /// Consecutive starts that died.
    died: u32,
}

impl Books {
    fn offset_of(&self, model: &str) -> Option<u64> {
        self.models.get(model).map(|(offsets, version)| offsets[version - 1])
    }

    fn is_used(&self, model: &str) -> bool {
        // A running session needs the active model, and after a swap no longer the document's.
        let needed = |session: &Declared| match session.runs {
            Runs::Yes => session.models[1] == model,
            _ => session.models.iter().any(|one| one == model),
        };
        self.sessions.values().any(needed)
    }

    /// Holder of a source's lease.
    fn holder(&self, source: &str) -> Option<u64> {
        self.leases.get(source).filter(|(_, until)| *until > self.clock).map(|(client, _)| *client)
    }

    fn feeds(&self, source: &str) -> bool {
        self.sessions.values().any(|session| session.source.as_deref() == Some(source) && session.runs == Runs::Yes)
    }

    /// The next start of the service, after the last one died.
    fn start(&mut self) {
        let runnable = self.sessions.values().filter(|session| session.runs != Runs::Stopped).count();
        let is_held = self.died >= LIMITS.starts_died;
        self.died = if runnable == 0 || is_held { 0 } else { self.died + 1 };
        for session in self.sessions.values_mut() {
            session.runs = match session.runs {
                Runs::Stopped => Runs::Stopped,
                _ if is_held => Runs::Stopped,
                _ if session.source.as_ref().is_some_and(|source| !self.sources.contains_key(source)) => Runs::Failed,
                _ => Runs::Yes,
            };
        }
    }
}

type Checked = (ModelEntry, ModelAnswer);

pub(super) struct Simulation {
    disk: Arc<Disk>,
    pub(super) service: Service,
    owner: Owner,
    /// Origin of the simulated clock.
    begin: Instant,
    pub(super) books: Books,
    pending: BTreeMap<u64, (String, u64, Checked)>,
    digests: BTreeMap<(String, u64), String>,
    /// Epoch of each session start.
    epochs: BTreeSet<(String, u64)>,
}

fn code<T>(answer: &Result<T, Problem>) -> &'static str {
    answer.as_ref().map_or_else(|problem| problem.code, |_| "done")
}

pub(super) fn source(width: usize) -> SourceDocument {
    serde_json::from_value(json!({"kind": "pushed", "width": width, "height": HEIGHT, "format": "u8"})).unwrap()
}

impl Simulation {
    pub(super) fn new() -> Simulation {
        let disk = Arc::new(Disk::default());
        let service = Service::of_store(disk.clone(), Arc::new(Machine::of_machine(VectorWidth::default()))).unwrap();
        let (books, pending) = (Books::default(), BTreeMap::new());
        let (digests, epochs) = (BTreeMap::new(), BTreeSet::new());
        Simulation { disk, service, owner: Owner::new(), begin: Instant::now(), books, pending, digests, epochs }
    }

    fn checked(&self, model: &str, offset: u64) -> Checked {
        let document = json!({"name": model, "coordinates": ["x", "y"], "channels": ["phi"], "constants": {"k": offset},
                              "parameters": {"v0": {"start": 1}}, "model": {"intensity": "v0 + k"}});
        checked_at_once(&self.service, model, &document).unwrap()
    }

    /// Runs an event; returns the service's answer and the expected one.
    pub(super) fn run(&mut self, event: SimulatedEvent) -> (&'static str, &'static str) {
        match event {
            SimulatedEvent::Asked(command) => self.ask(command),
            SimulatedEvent::Prepared { client, model, offset } => {
                let checked = self.checked(&model, offset);
                self.digests.insert((model.clone(), offset), checked.0.model.digest().to_string());
                self.pending.insert(client, (model, offset, checked));
                ("done", "done")
            }
            SimulatedEvent::Put { client, is_new } => match self.pending.remove(&client) {
                Some(pending) => self.put(pending, is_new),
                None => ("done", "done"),
            },
            SimulatedEvent::Frame { session } => {
                self.push(&session);
                ("done", "done")
            }
            SimulatedEvent::FullDisk | SimulatedEvent::EmptyDisk => {
                self.books.is_full = matches!(event, SimulatedEvent::FullDisk);
                self.disk.fill(self.books.is_full);
                ("done", "done")
            }
            SimulatedEvent::Lease { client, source, timeout } => self.lease(client, source, timeout),
            SimulatedEvent::Released { client, source } => self.release(client, &source),
            SimulatedEvent::Waited(time) => {
                self.wait(time);
                ("done", "done")
            }
            SimulatedEvent::Killed => {
                self.kill();
                ("done", "done")
            }
        }
    }

    fn put(&mut self, (model, offset, checked): (String, u64, Checked), is_new: bool) -> (&'static str, &'static str) {
        let mut headers = HeaderMap::new();
        if is_new {
            headers.insert(header::IF_NONE_MATCH, HeaderValue::from_static("*"));
        }
        let (name, preconditions) = (Name::parse(&model).unwrap(), Preconditions::of(&headers).unwrap());
        let answer = self.service.put_model(&mut self.owner, &name, &preconditions, checked);
        if is_new && self.books.models.contains_key(&model) {
            return (code(&answer), "stale");
        }
        if !self.books.is_full {
            let (offsets, version) = self.books.models.entry(model).or_default();
            offsets.push(offset);
            *version = offsets.len();
            assert_eq!(answer.as_ref().unwrap().2.version, *version as u64);
        }
        (code(&answer), self.on_disk())
    }

    /// Expected answer of a change that only the disk can refuse.
    fn on_disk(&self) -> &'static str {
        if self.books.is_full { "storage" } else { "done" }
    }

    fn ask(&mut self, command: Command) -> (&'static str, &'static str) {
        let answer = self.service.apply(&mut self.owner, command.clone());
        let (answered, done) = (code(&answer), self.on_disk());
        let right = match &command {
            Command::RollBackModel { name, .. } if !self.books.models.contains_key(name.as_str()) => "unknown-name",
            Command::RemoveModel { name } => match self.books.models.contains_key(name.as_str()) {
                false => "unknown-name",
                true if self.books.is_used(name.as_str()) => "in-use",
                true => done,
            },
            Command::PutSource { name, .. } if self.books.feeds(name.as_str()) => "in-use",
            Command::RemoveSource { name } => match self.books.sources.contains_key(name.as_str()) {
                false => "unknown-name",
                true if self.books.feeds(name.as_str()) => "in-use",
                true => done,
            },
            Command::PutSession { document, .. } => {
                let is_known = source_of(document).is_none_or(|named| self.books.sources.contains_key(&named));
                match self.books.offset_of(&document.model) {
                    // A full disk may be found before or after an unknown name.
                    _ if self.books.is_full && answered == "storage" => "storage",
                    Some(_) if is_known => done,
                    _ => "unknown-name",
                }
            }
            Command::RemoveSession { name } if !self.books.sessions.contains_key(name.as_str()) => "unknown-name",
            Command::SwapModel { session, model } => match self.books.sessions.get(session).map(|one| one.runs) {
                Some(Runs::Stopped | Runs::Failed) => "not-applicable",
                Some(Runs::Yes) if self.books.models.contains_key(model) => done,
                _ => "unknown-name",
            },
            _ => done,
        };
        if right == "done" {
            self.book(command);
        }
        (answered, right)
    }

    /// Applies a change to the reference model.
    fn book(&mut self, command: Command) {
        let books = &mut self.books;
        match command {
            Command::RollBackModel { name, version } => {
                books.models.get_mut(name.as_str()).unwrap().1 = version as usize;
            }
            Command::RemoveModel { name } => drop(books.models.remove(name.as_str())),
            Command::PutSource { name, document, .. } => {
                let SourceDocument::Pushed(document) = *document else { panic!() };
                books.sources.insert(name.to_string(), document.width);
                books.leases.remove(name.as_str());
            }
            Command::RemoveSource { name } => {
                books.sources.remove(name.as_str());
                books.leases.remove(name.as_str());
            }
            Command::PutSession { name, document, .. } => {
                let (offset, source) = (books.offset_of(&document.model).unwrap(), source_of(&document));
                let models = [document.model.clone(), document.model];
                books.sessions.insert(name.to_string(), Declared { models, offset, source, runs: Runs::Yes });
                self.begun(name.as_str());
            }
            Command::RemoveSession { name } => drop(books.sessions.remove(name.as_str())),
            Command::SwapModel { session, model } => {
                let offset = books.offset_of(&model).unwrap();
                let declared = books.sessions.get_mut(&session).unwrap();
                (declared.models[1], declared.offset) = (model, offset);
            }
            other => panic!("{other:?} is not drawn"),
        }
    }

    /// Pushes a frame and checks that the session's active model fits all of it.
    fn push(&self, session: &str) {
        let Some(declared) = self.books.sessions.get(session).filter(|declared| declared.runs == Runs::Yes) else {
            return;
        };
        let running = self.service.session(session).unwrap();
        let SourceDocument::Pushed(document) = running.source().source.document().clone() else { panic!() };
        let width = declared.source.as_ref().map_or(WIDTH, |source| self.books.sources[source]);
        assert_eq!(document.width, width);
        let frame = decode(&document, FrameMedia::Raw, vec![LIGHT; width * HEIGHT]).unwrap();
        let (sender, answer) = oneshot::channel();
        let reply = Reply { session: running.inbox().clone(), sender };
        running.source().source.push(Captured { frame, file: None, truth: None }, reply).unwrap();
        let estimate = serde_json::to_value(&*answer.blocking_recv().unwrap()).unwrap();
        let digest = &self.digests[&(declared.models[1].clone(), declared.offset)];
        assert_eq!(estimate["model"], format!("{}@{digest}", declared.models[1]));
        let level = estimate["parameters"]["v0"].as_f64().unwrap() + declared.offset as f64;
        assert!((level - f64::from(LIGHT)).abs() < 1e-3, "{estimate}");
    }

    fn now(&self) -> Instant {
        self.begin + self.books.clock
    }

    /// A lease belongs to one client until it is released, expires, or the source is replaced.
    fn lease(&mut self, client: u64, source: String, timeout: Duration) -> (&'static str, &'static str) {
        let (now, id) = (self.now(), LeaseId::Client(client.to_string()));
        let Ok(running) = self.service.source(&source) else {
            return ("unknown-name", if self.books.sources.contains_key(&source) { "done" } else { "unknown-name" });
        };
        let taken = running.lease().take("a client", &id, Some(timeout), now);
        let holder = self.books.holder(&source);
        if holder.is_none_or(|holder| holder == client) {
            assert_eq!(taken, Ok(holder.is_none()));
            self.books.leases.insert(source, (client, self.books.clock + timeout));
            return ("done", "done");
        }
        (if taken.is_err() { "in-use" } else { "done" }, "in-use")
    }

    fn release(&mut self, client: u64, source: &str) -> (&'static str, &'static str) {
        let (now, id) = (self.now(), LeaseId::Client(client.to_string()));
        let Ok(running) = self.service.source(source) else { return ("done", "done") };
        let is_theirs = self.books.holder(source) == Some(client);
        assert_eq!(running.lease().release(&id, now, || ()), is_theirs);
        if is_theirs {
            self.books.leases.remove(source);
        }
        ("done", "done")
    }

    /// Advances the clock; a process that has run for `LIMITS.start_time` has not died early, if the disk records it.
    fn wait(&mut self, time: Duration) {
        self.books.clock += time;
        if self.books.clock - self.books.started >= LIMITS.start_time && !self.books.is_full {
            self.service.lived();
            self.books.died = 0;
        }
    }

    /// Kills the service without further writes and restarts it from the disk.
    fn kill(&mut self) {
        self.books.is_full = false;
        self.books.leases.clear();
        self.books.started = self.books.clock;
        self.disk.fill(true);
        self.service.stop();
        self.disk.fill(false);
        self.pending.clear();
        self.service =
            Service::of_store(self.disk.clone(), Arc::new(Machine::of_machine(VectorWidth::default()))).unwrap();
        for (source, _) in self.service.awaited_sources() {
            self.service.restore_source(&mut self.owner, &source, Ok(None));
        }
        for (session, _) in self.service.awaited_sessions() {
            self.service.restore_session(&mut self.owner, &session, Ok(None));
        }
        self.books.start();
        let runs = self.books.sessions.iter().filter(|(_, session)| session.runs == Runs::Yes);
        let runs: Vec<String> = runs.map(|(session, _)| session.clone()).collect();
        runs.iter().for_each(|session| self.begun(session));
    }

    /// Checks that a new session start has a new epoch.
    fn begun(&mut self, session: &str) {
        let view = self.service.session_view(session).unwrap();
        assert!(self.epochs.insert((view.node.clone(), view.epoch.unwrap())), "{view:?}");
    }

    /// Compares all declarations with the reference model.
    fn check(&mut self) {
        let is_ours = |name: &str| name.strip_prefix('m').is_some_and(|rest| rest.parse::<u64>().is_ok());
        let entries = self.service.registry.list();
        let entries = entries.iter().filter(|entry| is_ours(entry.name.as_str()));
        let models = entries.map(|entry| (entry.name.to_string(), (entry.version, entry.model.digest().to_string())));
        let wanted = self.books.models.iter().map(|(model, (offsets, version))| {
            (model.clone(), (*version as u64, self.digests[&(model.clone(), offsets[version - 1])].clone()))
        });
        assert_eq!(models.collect::<BTreeMap<_, _>>(), wanted.collect(), "models");
        let sources = self.service.source_views().into_iter().map(|view| view.name);
        assert!(sources.eq(self.books.sources.keys().cloned()), "sources");
        let views = self.service.session_views();
        assert_eq!(views.len(), self.books.sessions.len(), "sessions");
        for view in views {
            let declared = &self.books.sessions[&view.name];
            let digest = &self.digests[&(declared.models[1].clone(), declared.offset)];
            assert_eq!(&view.active_digest, digest, "{view:?}");
            let runs = match view.state {
                SessionState::Stopped => Runs::Stopped,
                SessionState::Failed => Runs::Failed,
                _ => Runs::Yes,
            };
            assert_eq!(runs, declared.runs, "{view:?}");
            assert_eq!(view.reason.is_none(), runs == Runs::Yes, "{view:?}");
        }
    }
}

fn source_of(document: &SessionDocument) -> Option<String> {
    match &document.source {
        SourceReference::Named(name) => Some(name.clone()),
        SourceReference::Own(_) => None,
    }
}

#[test]
fn service_matches_the_reference_model() {
    let number = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let (commands, seed) = (number("ISOPHOTE_COMMANDS", COMMANDS), number("ISOPHOTE_SEED", 1));
    let (mut draws, mut simulation, mut refused) = (Draws(seed), Simulation::new(), 0);
    for step in 0..commands {
        let event = draws.event(&simulation.books);
        let (answered, right) = simulation.run(event.clone());
        assert_eq!(answered, right, "seed {seed}, command {step}: {event:?}");
        refused += u64::from(answered != "done");
        simulation.check();
    }
    simulation.service.stop();
    assert!(refused * 20 > commands, "only {refused} of {commands} were refused: the simulation shows little");
}
