//! The service of one tenant: its models, sources and sessions. Changes run on its compile thread, one after the other, from
//! work prepared on other threads; reads come from any thread. A PUT prepares, stores, and only then replaces: acknowledged
//! means durable, refused means that nothing changed.

mod admission;
mod apply;
pub mod capacity;
pub mod command;
pub mod compiler;
mod declare;
pub mod declared;
pub mod demo;
#[cfg(test)]
mod drawn;
#[cfg(test)]
mod hanging_tests;
pub mod machine;
mod models;
mod node;
#[cfg(test)]
mod replay;
mod restore;
mod shadows;
#[cfg(test)]
mod simulation;
mod table;
mod tags;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trouble_tests;
pub mod turns;
pub mod watchdog;
pub mod workshop;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Instant;

use isophote_wire::{SessionDocument, SourceDocument, SourceReference};
use tokio::sync::oneshot;

use crate::counters::ServiceCounters;
use crate::hub::End;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{ModelEntry, Pin, Registry, imported};
use crate::service::command::Command;
use crate::service::compiler::{Compiler, Owner};
use crate::service::declared::{Keeping, SessionRecord, SourceRecord};
use crate::service::machine::{Holding, Machine, Member};
use crate::service::node::ServiceNode;
use crate::service::turns::FairWorkers;
use crate::service::watchdog::OwnerWatch;
use crate::service::workshop::Workshop;
use crate::session::{
    PreparedSession, PreparedSwap, SearchQuota, Session, SessionStart, SourceOf, Swapped, prepare_session,
};
use crate::source::control::CameraNames;
use crate::source::{self, Opened, Paused, Source, Taker};
use crate::store::{self, FolderError, MemoryStore, Store, StoreError};
use crate::thread;
use table::{Entry, Table};

/// The service without its network.
pub struct Service {
    /// The thread of all changes.
    pub compiler: Compiler,
    /// Prepares slow changes on other threads.
    pub workshop: Workshop,
    /// The models.
    pub registry: Registry,
    /// Counters of the whole service.
    pub counters: ServiceCounters,
    /// Watches that the compile thread answers.
    pub watch: OwnerWatch,
    node: ServiceNode,
    sources: Table<SourceRecord>,
    sessions: Table<SessionRecord>,
    searches: Arc<SearchQuota>,
    /// Resources shared with other tenants.
    pub machine: Arc<Machine>,
    is_draining: AtomicBool,
}

/// Whether a PUT created or replaced.
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
    /// Its contents.
    #[error("the data folder cannot be read: {0}")]
    Store(#[from] StoreError),
    /// The compile thread.
    #[error("no thread for the compiler: {0}")]
    Thread(#[from] std::io::Error),
}

impl Service {
    /// Loads models and declarations; runs nothing yet. Joins the machine, of which it gets a share.
    pub fn open(data: Option<&Path>, machine: &Arc<Machine>) -> Result<Arc<Service>, OpenError> {
        let service = Arc::new(Service::of_store(store_of(data)?, machine.clone())?);
        let member: Weak<Service> = Arc::downgrade(&service);
        machine.join(member);
        Ok(service)
    }

    /// Whether it is stopping.
    pub fn is_draining(&self) -> bool {
        self.is_draining.load(Ordering::SeqCst)
    }

    /// 503 while it stops, or while the compile thread does not answer in time.
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
        self.sessions.running(name)
    }

    /// All sessions that run, by name.
    pub fn sessions(&self) -> Vec<(Name, Arc<Session>)> {
        self.sessions.all_running()
    }

    /// The source of that name, if it could be opened.
    pub fn source(&self, name: &str) -> Result<Arc<Source>, Problem> {
        self.sources.running(name)
    }

    /// All named sources that could be opened, by name.
    pub fn sources(&self) -> Vec<(Name, Arc<Source>)> {
        self.sources.all_running()
    }

    /// `PUT /v1/sources/{name}`; slow sources are `opened` already.
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
            let before = self.sources.get(name.as_str());
            let running = before.as_ref().and_then(Entry::running);
            if before.is_none() {
                self.machine.refuse_more("sources", LIMITS.sources, self.holding(), |of| of.sources)?;
            }
            if let Some(source) = running.filter(|source| source.sessions() > 0) {
                return Err(source_in_use(name, source));
            }
            let model = self.model_of_source(&document)?;
            let mut opened = self.opened(&document, "", opened, None)?;
            let held = opened.held.take();
            let source = Source::start(name.as_str(), document.clone(), opened)?;
            let record = (keeping == Keeping::Declared).then(|| SourceRecord {
                document,
                model: model.as_deref().map(ModelEntry::pin),
                declared: self.declared_now(),
            });
            let kept = record.map(|record| self.keep(owner, &self.sources, name, record, model.as_deref()));
            let stored = kept.transpose().inspect_err(|_| source.stop())?;
            tracing::info!(source = name.as_str(), kind = source.document().kind(), "source put");
            self.sources.run(owner, name, stored, Arc::new(source));
            running.into_iter().for_each(|source| source.stop());
            drop(held);
            Ok(if before.is_some() { Put::Replaced } else { Put::Created })
        })
    }

    /// Closes the camera of the source or session to be replaced, so that the new one can open it: it may still be open after
    /// its last session left, and that of a session has one reader.
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

    /// Checks cameras whose drivers do not return.
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
            let entry = self.sources.get(name.as_str()).ok_or_else(|| Problem::unknown("source", name.as_str()))?;
            if let Some(source) = entry.running().filter(|source| source.sessions() > 0) {
                return Err(source_in_use(name, source));
            }
            self.sources.remove(owner, name).map_err(StoreError::problem)?;
            entry.running().into_iter().for_each(|source| source.stop());
            tracing::info!(source = name.as_str(), "source removed");
            Ok(())
        })
    }

    /// Compiles and measures for [`Service::put_session`]; runs off the compile thread.
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

    /// `PUT /v1/sessions/{name}`: the new session runs before the old one stops; the receiver resolves when that has ended. Its
    /// source may be opened already.
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
            let before = self.sessions.get(name.as_str());
            if before.is_none() {
                self.machine.refuse_more("sessions", LIMITS.sessions, self.holding(), |of| of.sessions)?;
            }
            // The cost of a source of its own is not known yet.
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
            let source = self.source_of(name, &document.source, opened, None)?;
            let session = self.session_of(name, document.clone(), source, (&entry, &BTreeMap::new()), run)?;
            session.expect_cost(prepared.and_then(|prepared| prepared.fit_ms));
            let prepared_ms = prepared.map_or(0.0, |prepared| prepared.compile_ms);
            self.counters.compile_s.observe((prepared_ms + session.compile_ms()) / 1e3);
            let record = declared.map(|declared| SessionRecord {
                document,
                model: entry.pin(),
                constants: BTreeMap::new(),
                source_model: source_model.as_deref().map(ModelEntry::pin),
                declared,
                stopped: None,
            });
            let models = [&*entry].into_iter().chain(source_model.as_deref());
            let kept = record.map(|record| self.keep(owner, &self.sessions, name, record, models));
            let stored = kept.transpose().inspect_err(|_| discarded(name, &session))?;
            session.begin();
            tracing::info!(session = name.as_str(), frame = 0, model = entry.id(), "session started");
            self.sessions.run(owner, name, stored, Arc::new(session));
            let ended = before.as_ref().and_then(Entry::running).map(|before| ending(name, before.clone()));
            drop(held);
            Ok((if before.is_some() { Put::Replaced } else { Put::Created }, ended))
        })
    }

    /// A session that is ready but takes no frames yet.
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
        pin: Option<&Pin>,
    ) -> Result<SourceOf, Problem> {
        match reference {
            SourceReference::Named(source) => Ok(SourceOf { source: self.source(source)?, is_own: false }),
            SourceReference::Own(document) => {
                let opened = self.opened(document, "source.", opened, pin)?;
                let source = Source::start(name.as_str(), (**document).clone(), opened)?;
                Ok(SourceOf { source: Arc::new(source), is_own: true })
            }
        }
    }

    /// Opens a source that is not `opened` yet. A synthetic one renders its pinned model, else the present one of that name.
    fn opened(
        &self,
        document: &SourceDocument,
        prefix: &str,
        opened: Option<Opened>,
        pin: Option<&Pin>,
    ) -> Result<Opened, Problem> {
        let find = |name: &str| match pin {
            Some(pin) => Ok(self.registry.pinned(pin)?.model.clone()),
            None => Ok(self.registry.get(name)?.model.clone()),
        };
        opened.map_or_else(|| source::open(document, prefix, find), Ok)
    }

    /// `DELETE /v1/sessions/{name}`; the receiver resolves when the session has ended.
    pub fn remove_session(&self, owner: &mut Owner, name: &Name) -> Result<oneshot::Receiver<()>, Problem> {
        let command = Command::RemoveSession { name: name.clone() };
        owner.change(command, |owner| {
            let entry = self.sessions.get(name.as_str()).ok_or_else(|| Problem::unknown("session", name.as_str()))?;
            self.sessions.remove(owner, name).map_err(StoreError::problem)?;
            match entry.running() {
                Some(session) => Ok(ending(name, session.clone())),
                None => Ok(oneshot::channel().1), // there is nothing to wait for
            }
        })
    }

    /// The second half of a hot swap: hands the prepared model to the session.
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

    /// Refuses further changes and ends every stream.
    pub fn drain(&self) {
        if !self.is_draining.swap(true, Ordering::SeqCst) {
            tracing::info!("the service stops");
        }
        for (_, session) in self.sessions() {
            session.hub().end(End::ServiceStops);
        }
    }

    /// Ends all threads and joins them within the deadline of one; threads that do not end in time end with the process.
    pub fn stop(&self) {
        self.drain();
        let until = Instant::now() + LIMITS.end_time;
        self.sessions().iter().for_each(|(_, session)| session.leave());
        self.compiler.stop(until);
        // Sessions that began while the compiler ended are stopped too.
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
            sources: self.sources.count(),
            sessions: self.sessions.count(),
            shadows: sessions.iter().filter(|(_, session)| session.shadow().is_ok()).count(),
            load: sessions.iter().filter_map(|(_, session)| session.load()).sum::<f64>() + self.load_of_sources(),
        }
    }

    fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem> {
        self.sources().iter().try_for_each(|(_, source)| source.refuse_others(camera))?;
        self.sessions().iter().try_for_each(|(_, session)| session.source().source.refuse_others(camera))
    }
}

/// Ends a session that was removed from the table, on a thread of its own, so that many sessions with long fits end
/// concurrently.
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

/// The store of a data folder, or one in memory.
pub fn store_of(data: Option<&Path>) -> Result<Arc<dyn Store>, FolderError> {
    Ok(match data {
        Some(folder) => Arc::new(store::open(folder, imported)?),
        None => Arc::new(MemoryStore::default()),
    })
}

/// Ends a session that never took a frame.
fn discarded(name: &Name, session: &Session) {
    session.leave();
    session.wait(End::SessionFailed(format!("{name} was not stored")), Instant::now() + LIMITS.end_time);
}

fn source_in_use(name: &Name, source: &Source) -> Problem {
    Problem::conflict("in-use", format!("{} session(s) use the source `{name}`; stop them first", source.sessions()))
}
