//! What is put is declared: written with the models that it has, so that it runs again after a restart.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use isophote_machine::{rfc3339, unix_ms};
use isophote_wire::{SessionDocument, SessionState, SessionView, SourceDocument, SourceState, SourceView};

use super::standing::Why;
use super::{Service, get};
use crate::compiler::Owner;
use crate::declared::{Declared, Keeping, SessionRecord, SourceRecord};
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{ModelEntry, ModelText, Pin};
use crate::session::SessionStart;
use crate::store::StoreError;

impl Service {
    /// Keys of the contents of models that something declared needs.
    pub(super) fn pinned(&self) -> BTreeSet<String> {
        self.declared_sources.contents().into_iter().chain(self.declared_sessions.contents()).collect()
    }

    /// What is declared is declared now.
    pub(super) fn declared_now(&self) -> Declared {
        Declared { unix_ms: unix_ms(), start: self.node.start() }
    }

    /// A start of a session.
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

    pub(super) fn keep_source(
        &self,
        owner: &mut Owner,
        name: &Name,
        document: SourceDocument,
        model: Option<Arc<ModelEntry>>,
        keeping: Keeping,
    ) -> Result<(), Problem> {
        if keeping == Keeping::Passing {
            return Ok(());
        }
        let contents = self.unkept(model.as_deref(), None);
        let record = SourceRecord { document, model: pin(model), declared: self.declared_now() };
        self.declared_sources.put(owner, name, record, &contents).map_err(StoreError::problem)?;
        self.registry.kept(&contents);
        Ok(())
    }

    pub(super) fn keep_session(
        &self,
        owner: &mut Owner,
        name: &Name,
        document: SessionDocument,
        model: &ModelEntry,
        source_model: Option<Arc<ModelEntry>>,
        declared: Option<Declared>,
    ) -> Result<(), Problem> {
        let Some(declared) = declared else { return Ok(()) };
        let contents = self.unkept(Some(model), source_model.as_deref());
        let record = SessionRecord {
            document,
            model: model.pin(),
            constants: BTreeMap::new(),
            source_model: pin(source_model),
            declared,
            stopped: None,
        };
        self.declared_sessions.put(owner, name, record, &contents).map_err(StoreError::problem)?;
        self.registry.kept(&contents);
        Ok(())
    }

    /// A session that is declared has another model from now on.
    pub(super) fn keep_swap(
        &self,
        owner: &mut Owner,
        name: &str,
        model: &ModelEntry,
        constants: &BTreeMap<String, f64>,
    ) -> Result<(), Problem> {
        let Some(name) = Name::parse(name) else { return Ok(()) };
        let Some(record) = self.declared_sessions.get(&name) else { return Ok(()) };
        let contents = self.unkept(Some(model), None);
        let record = SessionRecord { model: model.pin(), constants: constants.clone(), ..record };
        self.declared_sessions.put(owner, &name, record, &contents).map_err(StoreError::problem)?;
        self.registry.kept(&contents);
        Ok(())
    }

    fn unkept(&self, model: Option<&ModelEntry>, other: Option<&ModelEntry>) -> Vec<ModelText> {
        model.into_iter().chain(other).filter_map(|entry| self.registry.unkept(entry)).collect()
    }

    /// A session that does not run, and would use that model.
    pub(super) fn standing_user(&self, model: &Name) -> Option<Name> {
        let uses = |record: &SessionRecord| record.model.name == *model || record.document.model == model.as_str();
        let standing = self.standing_sessions.all().into_iter().map(|(name, _)| name);
        standing.into_iter().find(|name| self.declared_sessions.get(name).is_some_and(|record| uses(&record)))
    }

    /// `GET /v1/sessions/{name}`
    pub fn session_view(&self, name: &str) -> Result<SessionView, Problem> {
        match get(&self.sessions, "session", name) {
            Ok(session) => Ok(session.view()),
            Err(unknown) => Name::parse(name).and_then(|name| self.standing_session(&name)).ok_or(unknown),
        }
    }

    /// `GET /v1/sessions`
    pub fn session_views(&self) -> Vec<SessionView> {
        let mut views: Vec<SessionView> = self.sessions().iter().map(|(_, session)| session.view()).collect();
        views.extend(self.standing_sessions.all().iter().filter_map(|(name, _)| self.standing_session(name)));
        views.sort_by(|one, other| one.name.cmp(&other.name));
        views.dedup_by(|one, other| one.name == other.name); // one that began to run in between
        views
    }

    fn standing_session(&self, name: &Name) -> Option<SessionView> {
        let (why, record) = (self.standing_sessions.why(name)?, self.declared_sessions.get(name)?);
        let (state, reason) = match why {
            Why::Starting => (SessionState::Starting, None),
            Why::Stopped(reason) => (SessionState::Stopped, Some(reason)),
            Why::Failed(reason) => (SessionState::Failed, Some(reason)),
        };
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
        let declared = Name::parse(name).and_then(|name| self.declared_sources.get(&name));
        let declared_at = declared.as_ref().map(|record| rfc3339(record.declared.unix_ms));
        match get(&self.sources, "source", name) {
            Ok(source) => Ok(SourceView { declared_at, ..source.view(name) }),
            Err(unknown) => {
                let why = Name::parse(name).and_then(|name| self.standing_sources.why(&name));
                let (Some(why), Some(record)) = (why, declared) else { return Err(unknown) };
                let (state, reason) = match why {
                    Why::Starting => (SourceState::Idle, None),
                    Why::Stopped(reason) | Why::Failed(reason) => (SourceState::Failed, Some(reason)),
                };
                let name = name.to_string();
                let document = record.document;
                let (position, playback, control, camera) = (None, None, None, None);
                let view = SourceView {
                    name,
                    document,
                    state,
                    reason,
                    declared_at,
                    frames: 0,
                    unread: 0,
                    sessions: 0,
                    position,
                    playback,
                    control,
                    camera,
                };
                Ok(view)
            }
        }
    }

    /// `GET /v1/sources`
    pub fn source_views(&self) -> Vec<SourceView> {
        let running = self.sources().into_iter().map(|(name, _)| name);
        let standing = self.standing_sources.all().into_iter().map(|(name, _)| name);
        let names: BTreeSet<Name> = running.chain(standing).collect();
        names.iter().filter_map(|name| self.source_view(name.as_str()).ok()).collect()
    }
}

fn pin(model: Option<Arc<ModelEntry>>) -> Option<Pin> {
    model.map(|entry| entry.pin())
}
