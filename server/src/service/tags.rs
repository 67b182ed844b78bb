//! Entity tags of sessions and sources: read by all threads, checked on the compile thread, where the tagged state is changed.

use super::Service;
use crate::http::preconditions::{EntityTag, Preconditions, digest};
use crate::problem::Problem;

impl Service {
    /// The tag of a session's document: new after each `PUT`, swap and promotion, kept over a restart and while the session
    /// runs.
    ///
    /// # Errors
    /// 404.
    pub fn session_tag(&self, name: &str) -> Result<EntityTag, Problem> {
        self.tag_of_session(name).ok_or_else(|| Problem::unknown("session", name))
    }

    /// The tag of a source's document with its current scene: new after each `PUT` of either.
    ///
    /// # Errors
    /// 404.
    pub fn source_tag(&self, name: &str) -> Result<EntityTag, Problem> {
        self.tag_of_source(name)?.ok_or_else(|| Problem::unknown("source", name))
    }

    fn tag_of_session(&self, name: &str) -> Option<EntityTag> {
        let entry = self.sessions.entry(name)?;
        match entry.tag() {
            Some(declared) => Some(EntityTag::new(declared)),
            None => entry.running().map(|session| session.tag()),
        }
    }

    fn tag_of_source(&self, name: &str) -> Result<Option<EntityTag>, Problem> {
        let Some(entry) = self.sources.entry(name) else { return Ok(None) };
        let known = match entry.running() {
            Some(source) => Some((entry.tag().unwrap_or_else(|| source.id().to_string()), source.document_now())),
            None => entry.tag().zip(entry.record().map(|record| record.document.clone())),
        };
        let Some((put, document)) = known else { return Ok(None) };
        let document = serde_json::to_vec(&document).map_err(|error| Problem::bug(error.to_string()))?;
        Ok(Some(EntityTag::new(format!("{put}-{}", digest(&document)))))
    }

    /// Checks the preconditions of a change of a session.
    ///
    /// # Errors
    /// 412.
    pub fn check_session(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the session `{name}`"), self.tag_of_session(name).as_slice())
    }

    /// Checks the preconditions of a change of a source.
    ///
    /// # Errors
    /// 412.
    pub fn check_source(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the source `{name}`"), self.tag_of_source(name)?.as_slice())
    }
}
