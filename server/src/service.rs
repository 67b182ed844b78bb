//! Everything of one tenant that runs: models, sources, sessions. Changed on its compile thread only, one change after the other,
//! from what was prepared beside it; read from anywhere. What is put is made ready, written, and only then takes its place:
//! acknowledged means durable, refused means that nothing was changed.

mod admission;
mod apply;
mod declare;
#[cfg(test)]
mod drawn;
#[cfg(test)]
mod hanging_tests;
mod models;
#[cfg(test)]
mod replay;
mod restore;
mod shadows;
#[cfg(test)]
mod simulation;
mod standing;
mod tags;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trouble_tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock, Weak};
use std::time::Instant;

use isophote_symbolic::Model;
use isophote_wire::{SessionDocument, SourceDocument, SourceReference};
use tokio::sync::oneshot;

use crate::command::Command;
use crate::commons::{Commons, Holding, Member};
use crate::compiler::{Compiler, Owner};
use crate::counters::ServiceCounters;
use crate::declared::{Declarations, Keeping, SessionRecord, SourceRecord};
use crate::hub::End;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::node::ServiceNode;
use crate::problem::Problem;
use crate::registry::{ModelEntry, Registry, imported};
use crate::session::{
    PreparedSession, PreparedSwap, SearchRoom, Session, SessionStart, SourceOf, Swapped, prepare_session,
};
use crate::source::control::CameraNames;
use crate::source::{self, Opened, Paused, Source, Taker};
use crate::store::{self, FolderError, MemoryStore, Store, StoreError};
use crate::thread;
use crate::turns::FairWorkers;
use crate::watchdog::OwnerWatch;
use crate::workshop::Workshop;
use standing::Standing;

/// The service without its network.
pub struct Service {
    /// The thread on which everything changes.
    pub compiler: Compiler,
    /// Where changes that take their time are prepared.
    pub workshop: Workshop,
    /// The models.
    pub registry: Registry,
    /// What is counted for all of it.
    pub counters: ServiceCounters,
    /// Whether that thread still answers.
    pub watch: OwnerWatch,
    node: ServiceNode,
    sources: Table<Source>,
    sessions: Table<Session>,
    declared_sources: Declarations<SourceRecord>,
    declared_sessions: Declarations<SessionRecord>,
    /// Declared, but not running.
    standing_sources: Standing,
    standing_sessions: Standing,
    searches: Arc<SearchRoom>,
    /// What it shares with other tenants.
    pub commons: Arc<Commons>,
    is_draining: AtomicBool,
}

type Table<T> = RwLock<BTreeMap<Name, Arc<T>>>;

fn get<T>(table: &Table<T>, what: &str, name: &str) -> Result<Arc<T>, Problem> {
    let table = table.read().unwrap_or_else(PoisonError::into_inner);
    let found = Name::parse(name).and_then(|name| table.get(&name).cloned());
    found.ok_or_else(|| Problem::unknown(what, name))
}

fn list<T>(table: &Table<T>) -> Vec<(Name, Arc<T>)> {
    let table = table.read().unwrap_or_else(PoisonError::into_inner);
    table.iter().map(|(name, one)| (name.clone(), one.clone())).collect()
}

fn insert<T>(table: &Table<T>, name: &Name, one: T) -> Option<Arc<T>> {
    table.write().unwrap_or_else(PoisonError::into_inner).insert(name.clone(), Arc::new(one))
}

fn remove<T>(table: &Table<T>, name: &Name) -> Option<Arc<T>> {
    table.write().unwrap_or_else(PoisonError::into_inner).remove(name)
}

/// Whether a PUT made something or replaced it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Put {
    /// 201
    Created,
    /// 200
    Replaced,
}

/// Why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The data folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// What is in it.
    #[error("the data folder cannot be read: {0}")]
    Store(#[from] StoreError),
    /// No thread.
    #[error("no thread for the compiler: {0}")]
    Thread(#[from] std::io::Error),
}

impl Service {
    /// Models are loaded, and what was declared is known, but nothing runs yet. It has a share of what all tenants have.
    pub fn open(data: Option<&Path>, commons: &Arc<Commons>) -> Result<Arc<Service>, OpenError> {
        let service = Arc::new(Service::of_store(store_of(data)?, commons.clone())?);
        let member: Weak<Service> = Arc::downgrade(&service);
        commons.join(member);
        Ok(service)
    }

    /// True while it stops.
    pub fn is_draining(&self) -> bool {
        self.is_draining.load(Ordering::SeqCst)
    }

    /// 503 while it stops, or when changes would wait for longer than anybody likes to.
    pub fn readiness(&self) -> Result<(), Problem> {
        self.refuse_when_draining()?;
        match self.watch.overdue() {
            Some(waited) => Err(Problem::not_ready(format!(
                "the thread that owns all changes has not answered for {:.1} s; what runs goes on, changes wait",
                waited.as_secs_f64()
            ))),
            None => Ok(()),
        }
    }

    /// The session of that name, if it runs.
    pub fn session(&self, name: &str) -> Result<Arc<Session>, Problem> {
        get(&self.sessions, "session", name).map_err(|unknown| self.standing_sessions.problem("session", name, unknown))
    }

    /// All sessions that run, by name.
    pub fn sessions(&self) -> Vec<(Name, Arc<Session>)> {
        list(&self.sessions)
    }

    /// The source of that name, if it could be opened.
    pub fn source(&self, name: &str) -> Result<Arc<Source>, Problem> {
        get(&self.sources, "source", name).map_err(|unknown| self.standing_sources.problem("source", name, unknown))
    }

    /// All named sources that could be opened, by name.
    pub fn sources(&self) -> Vec<(Name, Arc<Source>)> {
        list(&self.sources)
    }

    /// `PUT /v1/sources/{name}`, opened already where that takes its time.
    pub fn put_source(
        &self,
        owner: &mut Owner,
        name: &Name,
        document: SourceDocument,
        opened: Option<Opened>,
        keeping: Keeping,
    ) -> Result<Put, Problem> {
        let command = Command::PutSource { name: name.clone(), document: document.clone().into(), keeping };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            let before = get(&self.sources, "source", name.as_str()).ok();
            let is_known = before.is_some() || self.standing_sources.has(name);
            match &before {
                Some(source) if source.sessions() > 0 => return Err(source_in_use(name, source)),
                None if !is_known => {
                    self.commons.refuse_more("sources", LIMITS.sources, self.holding(), |of| of.sources)?;
                }
                _ => {}
            }
            let model = self.model_of_source(&document)?;
            let find = |name: &str| Ok(self.registry.get(name)?.model.clone());
            let mut opened = opened.map_or_else(|| source::open(&document, "", find), Ok)?;
            let held = opened.held.take();
            let source = Source::start(name.as_str(), document.clone(), opened)?;
            let kept = self.keep_source(owner, name, document, model, keeping);
            kept.inspect_err(|_| source.stop())?;
            tracing::info!(source = name.as_str(), kind = source.document().kind(), "source put");
            insert(&self.sources, name, source);
            self.standing_sources.remove(name);
            if let Some(before) = before {
                before.stop();
            }
            drop(held);
            Ok(if is_known { Put::Replaced } else { Put::Created })
        })
    }

    /// The camera of what is to be replaced is closed, so that it can be opened for what takes its place: one that its last session
    /// has left may still be open, and that of a session has one reader.
    pub fn let_go(&self, taker: &Taker) -> Result<Option<Paused>, Problem> {
        self.refuse_when_draining()?;
        Ok(match taker {
            Taker::Source(name) => match self.source(name.as_str()) {
                Ok(source) if source.sessions() > 0 => return Err(source_in_use(name, &source)),
                Ok(source) => source.pause(),
                Err(_) => None,
            },
            Taker::Session(name) => {
                let before = self.session(name.as_str()).ok().map(|session| session.source().source.clone());
                before.filter(|source| source.sessions() == 1).and_then(|source| source.pause())
            }
        })
    }

    /// Looks after cameras whose drivers do not come back.
    pub fn look_after_cameras(&self) {
        let now = Instant::now();
        self.sources().iter().for_each(|(_, source)| source.look_after(now));
        let sessions = self.sessions();
        let own = sessions.iter().map(|(_, session)| session.source()).filter(|source| source.is_own);
        own.for_each(|own| own.source.look_after(now));
    }

    /// `DELETE /v1/sources/{name}`.
    pub fn remove_source(&self, owner: &mut Owner, name: &Name) -> Result<(), Problem> {
        let command = Command::RemoveSource { name: name.clone() };
        owner.change(command, |owner| {
            let source = get(&self.sources, "source", name.as_str());
            if let (Err(unknown), false) = (&source, self.standing_sources.has(name)) {
                return Err(unknown.clone());
            }
            if let Some(source) = source.as_ref().ok().filter(|source| source.sessions() > 0) {
                return Err(source_in_use(name, source));
            }
            self.declared_sources.remove(owner, name).map_err(StoreError::problem)?;
            self.standing_sources.remove(name);
            remove(&self.sources, name);
            source.into_iter().for_each(|source| source.stop());
            tracing::info!(source = name.as_str(), "source removed");
            Ok(())
        })
    }

    /// What takes its time before [`Service::put_session`], and whether there is room for it beside what runs.
    pub fn prepare_session(
        &self,
        document: &SessionDocument,
        workers: &FairWorkers,
    ) -> Result<PreparedSession, Problem> {
        self.refuse_when_draining()?;
        let entry = self.registry.get(&document.model)?;
        let (running, own) = match &document.source {
            SourceReference::Named(source) => (Some(self.source(source)?), None),
            SourceReference::Own(document) => (None, Some(&**document)),
        };
        prepare_session(document, running.as_deref(), own, &entry, workers)
    }

    /// `PUT /v1/sessions/{name}`: the new session runs before the old one stops, which the receiver hears of. Its source may be
    /// opened already.
    pub fn put_session(
        &self,
        owner: &mut Owner,
        name: &Name,
        document: SessionDocument,
        opened: Option<Opened>,
        prepared: Option<&PreparedSession>,
        keeping: Keeping,
    ) -> Result<(Put, Option<oneshot::Receiver<()>>), Problem> {
        let command = Command::PutSession { name: name.clone(), document: document.clone().into(), keeping };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            let before = get(&self.sessions, "session", name.as_str()).ok();
            let is_known = before.is_some() || self.standing_sessions.has(name);
            if !is_known {
                self.commons.refuse_more("sessions", LIMITS.sessions, self.holding(), |of| of.sessions)?;
            }
            // Of what a source of its own costs nothing is known yet.
            if let Some(prepared) = prepared {
                self.admit(name, prepared)?;
            }
            let entry = self.registry.get(&document.model)?;
            let source_model = match &document.source {
                SourceReference::Own(source) => self.model_of_source(source)?,
                SourceReference::Named(_) => None,
            };
            let mut opened = opened;
            let held = opened.as_mut().and_then(|opened| opened.held.take());
            let declared = (keeping == Keeping::Declared).then(|| self.declared_now());
            let run = self.run(declared)?;
            let find = |name: &str| Ok(self.registry.get(name)?.model.clone());
            let source = self.source_of(name, &document.source, opened, find)?;
            let session = self.session_of(name, document.clone(), source, (&entry, &BTreeMap::new()), run)?;
            session.expect_cost(prepared.and_then(|prepared| prepared.fit_ms));
            let prepared_ms = prepared.map_or(0.0, |prepared| prepared.compile_ms);
            self.counters.compile_s.observe((prepared_ms + session.compile_ms()) / 1e3);
            let kept = self.keep_session(owner, name, document, &entry, source_model, declared);
            kept.inspect_err(|_| discarded(name, &session))?;
            session.begin();
            tracing::info!(session = name.as_str(), frame = 0, model = entry.id(), "session started");
            insert(&self.sessions, name, session);
            self.standing_sessions.remove(name);
            let put = if is_known { Put::Replaced } else { Put::Created };
            let Some(before) = before else { return Ok((put, None)) };
            let ended = ending(name, before);
            drop(held);
            Ok((put, Some(ended)))
        })
    }

    /// Ready, but without frames.
    fn session_of(
        &self,
        name: &Name,
        document: SessionDocument,
        source: SourceOf,
        model: (&ModelEntry, &BTreeMap<String, f64>),
        run: SessionStart,
    ) -> Result<Session, Problem> {
        Session::start(name.as_str(), document, source.clone(), model, run, &self.searches).inspect_err(|_| {
            if source.is_own {
                source.source.stop();
            }
        })
    }

    fn source_of(
        &self,
        name: &Name,
        reference: &SourceReference,
        opened: Option<Opened>,
        find: impl Fn(&str) -> Result<Arc<Model>, Problem>,
    ) -> Result<SourceOf, Problem> {
        match reference {
            SourceReference::Named(source) => Ok(SourceOf { source: self.source(source)?, is_own: false }),
            SourceReference::Own(document) => {
                let opened = opened.map_or_else(|| source::open(document, "source.", find), Ok)?;
                let source = Source::start(name.as_str(), (**document).clone(), opened)?;
                Ok(SourceOf { source: Arc::new(source), is_own: true })
            }
        }
    }

    /// `DELETE /v1/sessions/{name}`; the receiver hears when it has ended.
    pub fn remove_session(&self, owner: &mut Owner, name: &Name) -> Result<oneshot::Receiver<()>, Problem> {
        let command = Command::RemoveSession { name: name.clone() };
        owner.change(command, |owner| {
            let session = get(&self.sessions, "session", name.as_str());
            if let (Err(unknown), false) = (&session, self.standing_sessions.has(name)) {
                return Err(unknown.clone());
            }
            self.declared_sessions.remove(owner, name).map_err(StoreError::problem)?;
            self.standing_sessions.remove(name);
            remove(&self.sessions, name);
            match session {
                Ok(session) => Ok(ending(name, session)),
                Err(_) => Ok(oneshot::channel().1), // there is nothing to wait for
            }
        })
    }

    /// The second half of a hot swap: what was prepared is handed over.
    pub fn commit_swap(
        &self,
        owner: &mut Owner,
        name: &str,
        session: &Arc<Session>,
        entry: &ModelEntry,
        prepared: PreparedSwap,
    ) -> Result<oneshot::Receiver<Swapped>, Problem> {
        let command = match prepared.is_promotion() {
            true => Command::PromoteShadow { session: name.to_string() },
            false => Command::SwapModel { session: name.to_string(), model: entry.name.to_string() },
        };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            if !Arc::ptr_eq(&self.session(name)?, session) {
                return Err(Problem::conflict("not-applicable", "the session was replaced before it took the model"));
            }
            self.counters.compile_s.observe(prepared.compile_ms / 1e3);
            self.keep_swap(owner, name, entry, prepared.constants())?;
            session.commit_swap(owner, prepared)
        })
    }

    /// From now on nothing new is taken, and every stream ends.
    pub fn drain(&self) {
        if !self.is_draining.swap(true, Ordering::SeqCst) {
            tracing::info!("the service stops");
        }
        for (_, session) in self.sessions() {
            session.hub().end(End::ServiceStops);
        }
    }

    /// Ends all threads and waits for them together, for so long as for one: what does not end by then ends with the process.
    pub fn stop(&self) {
        self.drain();
        let until = Instant::now() + LIMITS.end_time;
        self.sessions().iter().for_each(|(_, session)| session.leave());
        self.compiler.stop(until);
        // What began while the compiler came to its end goes as well.
        let (sessions, sources) = (self.sessions(), self.sources());
        sessions.iter().for_each(|(_, session)| session.leave());
        sources.iter().for_each(|(_, source)| source.leave());
        sessions.iter().for_each(|(_, session)| session.wait(End::ServiceStops, until));
        sources.iter().for_each(|(_, source)| source.wait(until));
        self.lived();
    }

    fn refuse_when_draining(&self) -> Result<(), Problem> {
        if self.is_draining() { Err(Problem::stopping()) } else { Ok(()) }
    }
}

impl Member for Service {
    fn holding(&self) -> Holding {
        let sessions = self.sessions();
        Holding {
            sources: self.sources().len() + self.standing_sources.len(),
            sessions: sessions.len() + self.standing_sessions.len(),
            shadows: sessions.iter().filter(|(_, session)| session.shadow().is_ok()).count(),
            load: sessions.iter().filter_map(|(_, session)| session.load()).sum::<f64>() + self.load_of_sources(),
        }
    }

    fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem> {
        self.sources().iter().try_for_each(|(_, source)| source.refuse_others(camera))?;
        self.sessions().iter().try_for_each(|(_, session)| session.source().source.refuse_others(camera))
    }
}

/// Ends a session beside whoever has taken it out of the table: many that are at long fits end together.
fn ending(name: &Name, session: Arc<Session>) -> oneshot::Receiver<()> {
    session.leave();
    let said = name.to_string();
    let end = move || {
        session.wait(End::SessionStopped, Instant::now() + LIMITS.end_time);
        let counters = session.counters();
        let (frames, dropped) = (counters.frames.count(), counters.dropped.count());
        tracing::info!(session = said, frame = session.last_frame(), frames, dropped, "session stopped");
    };
    thread::beside(name.as_str(), end)
}

/// What a data folder keeps; in memory where there is none.
pub fn store_of(data: Option<&Path>) -> Result<Arc<dyn Store>, FolderError> {
    Ok(match data {
        Some(folder) => Arc::new(store::open(folder, imported)?),
        None => Arc::new(MemoryStore::default()),
    })
}

/// Ends a session that never had a frame.
fn discarded(name: &Name, session: &Session) {
    session.leave();
    session.wait(End::SessionFailed(format!("{name} was not stored")), Instant::now() + LIMITS.end_time);
}

fn source_in_use(name: &Name, source: &Source) -> Problem {
    Problem::conflict("in-use", format!("{} session(s) use the source `{name}`; stop them first", source.sessions()))
}
