//! After a start of the service: what was declared runs again, each with the models that it had. What cannot says why and is
//! listed; nothing keeps the service itself from starting.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use isophote_symbolic::Model;
use isophote_wire::{SourceDocument, SourceReference};

use super::standing::{Standing, Why};
use super::{OpenError, Service, Table, get, insert};
use crate::commons::Commons;
use crate::compiler::{Compiler, Owner};
use crate::counters::ServiceCounters;
use crate::declared::{Declarations, SessionRecord};
use crate::limits::LIMITS;
use crate::name::Name;
use crate::node::{LastStarts, ServiceNode};
use crate::preconditions::Preconditions;
use crate::problem::Problem;
use crate::registry::{ModelFile, Registry, models_in};
use crate::source::{self, Opened, Source};
use crate::store::{RecordTable, Store, said};
use crate::watchdog::OwnerWatch;
use crate::workshop::Workshop;

/// A source that waits to be opened, and the model that will look at its frames.
pub type Awaited = (SourceDocument, Option<Arc<Model>>);

impl Service {
    /// Everything that a store knows, and nothing that runs.
    pub(super) fn of_store(store: Arc<dyn Store>, commons: Arc<Commons>) -> Result<Service, OpenError> {
        let mut registry = Registry::open(store.clone(), commons.new_cache())?;
        let declared_sources = Declarations::open(store.clone(), RecordTable::Sources)?;
        let declared_sessions: Declarations<SessionRecord> = Declarations::open(store.clone(), RecordTable::Sessions)?;
        if declared_sources.has_unread() || declared_sessions.has_unread() {
            registry.keep_all();
        }
        let runnable = declared_sessions.all().into_iter().filter(|(_, record)| record.stopped.is_none());
        let runnable: Vec<(Name, SessionRecord)> = runnable.collect();
        let (node, before) = ServiceNode::open(store, runnable.len())?;
        let mut owner = Owner::new();
        let reason = (before == LastStarts::Died).then(|| stop(&mut owner, &declared_sessions, runnable));
        let sources = declared_sources.all().into_iter().map(|(name, _)| (name, Why::Starting));
        let sessions =
            declared_sessions.all().into_iter().map(|(name, record)| match record.stopped.or(reason.clone()) {
                Some(reason) => (name, Why::Stopped(reason)),
                None => (name, Why::Starting),
            });
        Ok(Service {
            standing_sources: Standing::of(sources),
            standing_sessions: Standing::of(sessions),
            registry,
            node,
            declared_sources,
            declared_sessions,
            compiler: Compiler::start(owner)?,
            counters: ServiceCounters::default(),
            watch: OwnerWatch::default(),
            workshop: Workshop::new(commons.turns.clone()),
            searches: Arc::new(commons.searches()),
            commons,
            sources: Table::default(),
            sessions: Table::default(),
            is_draining: AtomicBool::new(false),
        })
    }

    /// `--models DIR`: documents under the names of their files, those that are new or changed. One that is wrong is said.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn put_folder(self: &Arc<Self>, folder: &Path) -> std::io::Result<()> {
        for file in models_in(folder)? {
            if let Err(why) = self.put_file(&file) {
                said(&file.path, &format!("not put: {why}"));
            }
        }
        Ok(())
    }

    fn put_file(self: &Arc<Self>, file: &ModelFile) -> Result<(), String> {
        let (name, text) = file.read()?;
        let present = self.registry.get(name.as_str()).ok();
        if present.is_some_and(|entry| entry.media == file.media && *entry.text == *text) {
            return Ok(());
        }
        let prepared = self.check_model(&name, file.media, &text, &self.workshop.at_once());
        let service = self.clone();
        let put = prepared.and_then(|prepared| {
            let put =
                move |owner: &mut Owner| service.put_model(owner, &name, &Preconditions::default(), prepared).map(drop);
            self.compiler.run_blocking(put)
        });
        put.map_err(|problem| match problem.diagnostics.first() {
            Some(fault) => format!("{} ({}:{})", fault.message, fault.line, fault.column),
            None => problem.detail,
        })
    }

    /// Sources of their own names that wait to be started.
    pub fn awaited_sources(&self) -> BTreeMap<Name, Awaited> {
        let awaited = self.standing_sources.all().into_iter().filter(|(_, why)| *why == Why::Starting);
        let document = |name: Name| Some((self.declared_sources.get(&name)?.document, name));
        awaited.filter_map(|(name, _)| document(name)).map(|(document, name)| (name, (document, None))).collect()
    }

    /// Sessions that wait to be started, with their sources where these are their own.
    pub fn awaited_sessions(&self) -> BTreeMap<Name, Option<Awaited>> {
        let awaited = self.standing_sessions.all().into_iter().filter(|(_, why)| *why == Why::Starting);
        let source = |record: SessionRecord| match record.document.source {
            SourceReference::Named(_) => None,
            SourceReference::Own(source) => {
                Some((*source, self.registry.pinned(&record.model).ok().map(|entry| entry.model.clone())))
            }
        };
        awaited.filter_map(|(name, _)| Some((name.clone(), source(self.declared_sessions.get(&name)?)))).collect()
    }

    /// Starts a source that waits, opened already where that takes its time.
    pub fn restore_source(&self, _owner: &mut Owner, name: &Name, opened: Result<Option<Opened>, Problem>) {
        // Whoever put or deleted it in between was faster.
        if self.standing_sources.why(name) != Some(Why::Starting) {
            return;
        }
        let started = || {
            let Some(record) = self.declared_sources.get(name) else { return Ok(()) };
            let find = |name: &str| match &record.model {
                Some(pin) => Ok(self.registry.pinned(pin)?.model.clone()),
                None => Ok(self.registry.get(name)?.model.clone()),
            };
            let opened = opened?.map_or_else(|| source::open(&record.document, "", find), Ok)?;
            insert(&self.sources, name, Source::start(name.as_str(), record.document, opened)?);
            Ok(())
        };
        match started() {
            Ok(()) => self.standing_sources.remove(name),
            Err(problem) => self.source_failed(name, problem),
        }
    }

    /// Starts a source that waits, before its turn, unless opening it takes its time.
    pub fn restore_source_at_once(&self, owner: &mut Owner, name: &Name) {
        match self.declared_sources.get(name).map(|record| record.document) {
            None | Some(SourceDocument::Recording(_) | SourceDocument::Camera(_)) => {}
            Some(SourceDocument::Synthetic(_) | SourceDocument::Pushed(_)) => {
                self.restore_source(owner, name, Ok(None));
            }
        }
    }

    /// A source that waited is not started, for that reason.
    pub fn source_failed(&self, name: &Name, problem: Problem) {
        self.standing_sources.set(name, Why::Failed(reason(problem)));
    }

    /// The same for a session, with the model that it had last.
    pub fn restore_session(&self, _owner: &mut Owner, name: &Name, opened: Result<Option<Opened>, Problem>) {
        if self.standing_sessions.why(name) != Some(Why::Starting) {
            return;
        }
        let started = || {
            let Some(record) = self.declared_sessions.get(name) else { return Ok(()) };
            let entry = self.registry.pinned(&record.model)?;
            let find = |name: &str| match &record.source_model {
                Some(pin) => Ok(self.registry.pinned(pin)?.model.clone()),
                None => Ok(self.registry.get(name)?.model.clone()),
            };
            let run = self.run(Some(record.declared))?;
            let source = self.source_of(name, &record.document.source, opened?, find)?;
            let session = self.session_of(name, record.document, source, (&entry, &record.constants), run)?;
            session.begin();
            insert(&self.sessions, name, session);
            Ok(())
        };
        match started() {
            Ok(()) => self.standing_sessions.remove(name),
            Err(problem) => self.session_failed(name, problem),
        }
    }

    /// The same of a session.
    pub fn session_failed(&self, name: &Name, problem: Problem) {
        self.standing_sessions.set(name, Why::Failed(reason(problem)));
    }

    /// Whether a source of that name runs or is declared.
    pub fn has_source(&self, name: &Name) -> bool {
        self.standing_sources.has(name) || get(&self.sources, "source", name.as_str()).is_ok()
    }

    /// The same of a session.
    pub fn has_session(&self, name: &Name) -> bool {
        self.standing_sessions.has(name) || get(&self.sessions, "session", name.as_str()).is_ok()
    }

    /// This start has not died early.
    pub fn lived(&self) {
        self.node.lived();
    }
}

/// The first fault where there are some: a document that was right once is wrong for a reason.
fn reason(problem: Problem) -> String {
    match problem.diagnostics.into_iter().next() {
        Some(fault) => fault.message,
        None => problem.detail,
    }
}

/// What may have killed the service is not started by it again; says why.
fn stop(owner: &mut Owner, declared: &Declarations<SessionRecord>, sessions: Vec<(Name, SessionRecord)>) -> String {
    let (seconds, starts) = (LIMITS.start_time.as_secs(), LIMITS.starts_died);
    let why = format!("the service died within {seconds} s of each of its last {starts} starts");
    tracing::warn!("{why}: sessions that were declared stay stopped until they are put again");
    let reason = format!("{why}, so this session stays stopped; put it again to start it");
    for (name, record) in sessions {
        let stopped = SessionRecord { stopped: Some(reason.clone()), ..record };
        if let Err(error) = declared.put(owner, &name, stopped, &[]) {
            tracing::warn!("that the session `{name}` is stopped is not kept: {error}");
        }
    }
    reason
}
