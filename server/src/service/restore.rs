//! Restores all declarations after a start of the service, with the models that they had. Those that fail are listed with a
//! reason; none keeps the service from starting.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use isophote_symbolic::Model;
use isophote_wire::{SourceDocument, SourceReference};

use super::table::{Entry, State, Table};
use super::{OpenError, Service};
use crate::counters::ServiceCounters;
use crate::http::preconditions::Preconditions;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{ModelFile, Registry, models_in};
use crate::service::compiler::{Compiler, Owner};
use crate::service::declared::{Declaration, SessionRecord, SourceRecord};
use crate::service::machine::Machine;
use crate::service::node::{LastStarts, ServiceNode};
use crate::service::watchdog::OwnerWatch;
use crate::service::workshop::Workshop;
use crate::source::{Opened, Source};
use crate::store::{Store, warn};

/// A source waiting to be opened, and the model that will fit its frames.
pub type Awaited = (SourceDocument, Option<Arc<Model>>);

impl Service {
    /// A service with the store's declarations, none of them running.
    pub(super) fn of_store(store: Arc<dyn Store>, machine: Arc<Machine>) -> Result<Service, OpenError> {
        let mut registry = Registry::open(store.clone(), machine.new_cache())?;
        let sources = Table::open(store.clone(), |_: &SourceRecord| None)?;
        let sessions = Table::open(store.clone(), |record: &SessionRecord| record.stopped.clone())?;
        if sources.has_unread() || sessions.has_unread() {
            registry.keep_all();
        }
        let runnable = sessions.all().into_iter().filter_map(|(name, entry)| Some((name, waiting(entry)?)));
        let runnable: Vec<(Name, SessionRecord)> = runnable.collect();
        let (node, before) = ServiceNode::open(store, runnable.len())?;
        let mut owner = Owner::new();
        if before == LastStarts::Died {
            stop(&mut owner, &sessions, runnable);
        }
        Ok(Service {
            registry,
            node,
            compiler: Compiler::start(owner)?,
            counters: ServiceCounters::default(),
            watch: OwnerWatch::default(),
            workshop: Workshop::new(machine.turns.clone()),
            searches: Arc::new(machine.searches()),
            machine,
            sources,
            sessions,
            is_draining: AtomicBool::new(false),
        })
    }

    /// `--models DIR`: puts new or changed documents under their file names. Reports wrong ones and goes on.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn put_folder(self: &Arc<Self>, folder: &Path) -> std::io::Result<()> {
        for file in models_in(folder)? {
            if let Err(why) = self.put_file(&file) {
                warn(&file.path, &format!("not put: {why}"));
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

    /// Named sources that wait to be started.
    pub fn awaited_sources(&self) -> BTreeMap<Name, Awaited> {
        let records = self.sources.all().into_iter().filter_map(|(name, entry)| Some((name, waiting(entry)?)));
        records.map(|(name, record)| (name, (record.document, None))).collect()
    }

    /// Sessions that wait to be started, with their own sources, if any.
    pub fn awaited_sessions(&self) -> BTreeMap<Name, Option<Awaited>> {
        let records = self.sessions.all().into_iter().filter_map(|(name, entry)| Some((name, waiting(entry)?)));
        let source = |record: SessionRecord| match record.document.source {
            SourceReference::Named(_) => None,
            SourceReference::Own(source) => {
                Some((*source, self.registry.pinned(&record.model).ok().map(|entry| entry.model.clone())))
            }
        };
        records.map(|(name, record)| (name, source(record))).collect()
    }

    /// Starts a waiting source, with `opened` if opening it may block.
    pub fn restore_source(&self, owner: &mut Owner, name: &Name, opened: Result<Option<Opened>, Problem>) {
        // Skipped if it was put or deleted in between.
        let Some(record) = self.sources.get(name.as_str()).and_then(waiting) else { return };
        let opened = opened.and_then(|opened| self.opened(&record.document, "", opened, record.model.as_ref()));
        match opened.and_then(|opened| Source::start(name.as_str(), record.document, opened)) {
            Ok(source) => self.sources.run(owner, name, None, Arc::new(source)),
            Err(problem) => self.source_failed(name, problem),
        }
    }

    /// Starts a waiting source ahead of its turn, unless opening it may block.
    pub fn restore_source_at_once(&self, owner: &mut Owner, name: &Name) {
        match self.sources.get(name.as_str()).and_then(waiting).map(|record| record.document) {
            None | Some(SourceDocument::Recording(_) | SourceDocument::Camera(_)) => {}
            Some(SourceDocument::Synthetic(_) | SourceDocument::Pushed(_)) => {
                self.restore_source(owner, name, Ok(None));
            }
        }
    }

    /// Marks a waiting source as failed.
    pub fn source_failed(&self, name: &Name, problem: Problem) {
        self.sources.not_started(name, State::Failed(reason(problem)));
    }

    /// Starts a waiting session, with its last active model.
    pub fn restore_session(&self, owner: &mut Owner, name: &Name, opened: Result<Option<Opened>, Problem>) {
        let Some(record) = self.sessions.get(name.as_str()).and_then(waiting) else { return };
        let started = || {
            let entry = self.registry.pinned(&record.model)?;
            let run = self.run(Some(record.declared))?;
            let source = self.source_of(name, &record.document.source, opened?, record.source_model.as_ref())?;
            let session = self.session_of(name, record.document, source, (&entry, &record.constants), run)?;
            session.begin();
            Ok(session)
        };
        match started() {
            Ok(session) => self.sessions.run(owner, name, None, Arc::new(session)),
            Err(problem) => self.session_failed(name, problem),
        }
    }

    /// Marks a waiting session as failed.
    pub fn session_failed(&self, name: &Name, problem: Problem) {
        self.sessions.not_started(name, State::Failed(reason(problem)));
    }

    /// Records that this start has not died early.
    pub fn lived(&self) {
        self.node.lived();
    }
}

/// The first diagnostic, if any, else the detail.
fn reason(problem: Problem) -> String {
    match problem.diagnostics.into_iter().next() {
        Some(fault) => fault.message,
        None => problem.detail,
    }
}

/// The declaration of something that waits to be started.
fn waiting<R: Declaration>(entry: Entry<R>) -> Option<R> {
    matches!(entry.state, State::Starting).then(|| entry.record().cloned()).flatten()
}

/// Stops the sessions, which may have killed the service.
fn stop(owner: &mut Owner, sessions: &Table<SessionRecord>, runnable: Vec<(Name, SessionRecord)>) {
    let (seconds, starts) = (LIMITS.start_time.as_secs(), LIMITS.starts_died);
    let why = format!("the service died within {seconds} s of each of its last {starts} starts");
    tracing::warn!("{why}: sessions that were declared stay stopped until they are put again");
    let reason = format!("{why}, so this session stays stopped; put it again to start it");
    for (name, record) in runnable {
        let stopped = SessionRecord { stopped: Some(reason.clone()), ..record };
        match sessions.commit(owner, &name, stopped, &[]) {
            Ok(stored) => sessions.declare(owner, &name, stored),
            Err(error) => tracing::warn!("that the session `{name}` is stopped is not kept: {error}"),
        }
        sessions.not_started(&name, State::Stopped(reason.clone()));
    }
}
