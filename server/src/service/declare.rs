//! Stores declarations together with their models, so that they run again after a restart.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use isophote_machine::{rfc3339, unix_ms};
use isophote_wire::{SessionDocument, SessionState, SessionView, SourceDocument, SourceState, SourceView};

use super::Service;
use super::table::{Entry, State, StoredRecord, Table};
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{ModelEntry, ModelText};
use crate::service::compiler::Owner;
use crate::service::declared::{Declaration, Declared, SessionRecord, SourceRecord};
use crate::session::SessionStart;
use crate::store::StoreError;

impl Service {
    /// Content keys of models that declarations need.
    pub(super) fn pinned(&self) -> BTreeSet<String> {
        self.sources.contents().into_iter().chain(self.sessions.contents()).collect()
    }

    /// Time and service start of a declaration made now.
    pub(super) fn declared_now(&self) -> Declared {
        Declared { unix_ms: unix_ms(), start: self.node.start() }
    }

    /// A new start of a session.
    pub(super) fn run(&self, declared: Option<Declared>) -> Result<SessionStart, Problem> {
        Ok(SessionStart {
            node: self.node.id().clone(),
            epoch: self.node.next_epoch().map_err(StoreError::problem)?,
            started_at: rfc3339(unix_ms()),
            declared_at: declared.map(|declared| rfc3339(declared.unix_ms)),
            restarts: declared.map_or(0, |declared| self.node.start().saturating_sub(declared.start)),
        })
    }

    /// The model that a synthetic source renders.
    pub(super) fn model_of_source(&self, document: &SourceDocument) -> Result<Option<Arc<ModelEntry>>, Problem> {
        match document {
            SourceDocument::Synthetic(synthetic) => Ok(Some(self.registry.get(&synthetic.model)?)),
            _ => Ok(None),
        }
    }

    /// Stores the new active model of a declared session.
    pub(super) fn keep_swap(
        &self,
        owner: &mut Owner,
        name: &str,
        model: &ModelEntry,
        constants: &BTreeMap<String, f64>,
    ) -> Result<(), Problem> {
        let (Some(name), Some(entry)) = (Name::parse(name), self.sessions.get(name)) else { return Ok(()) };
        let Some(record) = entry.record().cloned() else { return Ok(()) };
        let record = SessionRecord { model: model.pin(), constants: constants.clone(), ..record };
        let stored = self.keep(owner, &self.sessions, &name, record, [model])?;
        self.sessions.declare(owner, &name, stored);
        Ok(())
    }

    /// Stores a declaration together with the models that it pins.
    pub(super) fn keep<'a, R: Declaration>(
        &self,
        owner: &mut Owner,
        table: &Table<R>,
        name: &Name,
        record: R,
        models: impl IntoIterator<Item = &'a ModelEntry>,
    ) -> Result<StoredRecord<R>, Problem> {
        let contents = models.into_iter().filter_map(|entry| self.registry.unkept(entry));
        let contents: Vec<ModelText> = contents.collect();
        let stored = table.commit(owner, name, record, &contents).map_err(StoreError::problem)?;
        self.registry.kept(&contents);
        Ok(stored)
    }

    /// A session that does not run and would use that model.
    pub(super) fn user_not_running(&self, model: &Name) -> Option<Name> {
        let uses = |record: &SessionRecord| record.model.name == *model || record.document.model == model.as_str();
        let mut entries = self.sessions.all().into_iter();
        let found = entries.find(|(_, entry)| entry.running().is_none() && entry.record().is_some_and(uses));
        found.map(|(name, _)| name)
    }

    /// `GET /v1/sessions/{name}`
    pub fn session_view(&self, name: &str) -> Result<SessionView, Problem> {
        let view = self.sessions.get(name).and_then(|entry| self.view_of_session(name, &entry));
        view.ok_or_else(|| Problem::unknown("session", name))
    }

    /// `GET /v1/sessions`
    pub fn session_views(&self) -> Vec<SessionView> {
        let entries = self.sessions.all();
        entries.iter().filter_map(|(name, entry)| self.view_of_session(name.as_str(), entry)).collect()
    }

    fn view_of_session(&self, name: &str, entry: &Entry<SessionRecord>) -> Option<SessionView> {
        let (state, reason) = match &entry.state {
            State::Running(session) => return Some(session.view()),
            State::Starting => (SessionState::Starting, None),
            State::Stopped(reason) => (SessionState::Stopped, Some(reason.clone())),
            State::Failed(reason) => (SessionState::Failed, Some(reason.clone())),
            State::Unread => return None,
        };
        let record = entry.record()?.clone();
        let model = record.model.name.to_string();
        let mut document = SessionDocument { model: model.clone(), ..record.document };
        document.constants.extend(record.constants);
        Some(SessionView {
            name: name.to_string(),
            document,
            state,
            reason,
            warnings: Vec::new(),
            requested_model: model.clone(),
            active_model: model,
            active_digest: record.model.digest,
            active_since_frame: 0,
            vector_width: 8 * self.registry.cache().width().bytes(),
            frames: 0,
            dropped: 0,
            rate_hz: 0.0,
            node: self.node.id().to_string(),
            epoch: None,
            declared_at: Some(rfc3339(record.declared.unix_ms)),
            started_at: None,
            restarts: self.node.start().saturating_sub(record.declared.start),
            frame_budget_ms: None,
            search_budget_ms: None,
            over_budget: 0,
            searches: 0,
            searches_postponed: 0,
            cost_ms: None,
            exposure_control: None,
            shadow: None,
            recording: None,
            source_camera: None,
            last: None,
        })
    }

    /// `GET /v1/sources/{name}`
    pub fn source_view(&self, name: &str) -> Result<SourceView, Problem> {
        let view = self.sources.get(name).and_then(|entry| view_of_source(name, &entry));
        view.ok_or_else(|| Problem::unknown("source", name))
    }

    /// `GET /v1/sources`
    pub fn source_views(&self) -> Vec<SourceView> {
        self.sources.all().iter().filter_map(|(name, entry)| view_of_source(name.as_str(), entry)).collect()
    }
}

fn view_of_source(name: &str, entry: &Entry<SourceRecord>) -> Option<SourceView> {
    let declared_at = entry.record().map(|record| rfc3339(record.declared.unix_ms));
    let (state, reason) = match &entry.state {
        State::Running(source) => return Some(SourceView { declared_at, ..source.view(name) }),
        State::Starting => (SourceState::Idle, None),
        State::Stopped(reason) | State::Failed(reason) => (SourceState::Failed, Some(reason.clone())),
        State::Unread => return None,
    };
    Some(SourceView {
        name: name.to_string(),
        document: entry.record()?.document.clone(),
        state,
        reason,
        declared_at,
        frames: 0,
        unread: 0,
        sessions: 0,
        position: None,
        playback: None,
        control: None,
        camera: None,
    })
}
