//! Entity tags of sessions and sources. Read by everybody, checked on the compile thread, where what they stand for is changed.

use super::{Service, get};
use crate::name::Name;
use crate::preconditions::{EntityTag, Preconditions, digest};
use crate::problem::Problem;

impl Service {
    /// The tag of a session's document: another one after each `PUT`, swap and promotion, the same one after a restart. What the
    /// session does leaves it as it is.
    ///
    /// # Errors
    /// 404.
    pub fn session_tag(&self, name: &str) -> Result<EntityTag, Problem> {
        self.tag_of_session(name).ok_or_else(|| Problem::unknown("session", name))
    }

    /// The tag of a source's document with the scene that it shows: another one after each `PUT` of either.
    ///
    /// # Errors
    /// 404.
    pub fn source_tag(&self, name: &str) -> Result<EntityTag, Problem> {
        self.tag_of_source(name)?.ok_or_else(|| Problem::unknown("source", name))
    }

    fn tag_of_session(&self, name: &str) -> Option<EntityTag> {
        match Name::parse(name).and_then(|name| self.declared_sessions.tag(&name)) {
            Some(declared) => Some(EntityTag::new(declared)),
            None => get(&self.sessions, "session", name).ok().map(|session| session.tag()),
        }
    }

    fn tag_of_source(&self, name: &str) -> Result<Option<EntityTag>, Problem> {
        let key = Name::parse(name);
        let declared = key.as_ref().and_then(|key| self.declared_sources.tag(key));
        let known = match get(&self.sources, "source", name) {
            Ok(source) => Some((declared.unwrap_or_else(|| source.id().to_string()), source.document_now())),
            Err(_) => declared.zip(key.and_then(|key| self.declared_sources.get(&key)).map(|record| record.document)),
        };
        let Some((put, document)) = known else { return Ok(None) };
        let document = serde_json::to_vec(&document).map_err(|error| Problem::bug(error.to_string()))?;
        Ok(Some(EntityTag::new(format!("{put}-{}", digest(&document)))))
    }

    /// Before a change of a session.
    ///
    /// # Errors
    /// 412.
    pub fn check_session(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the session `{name}`"), self.tag_of_session(name).as_slice())
    }

    /// Before a change of a source.
    ///
    /// # Errors
    /// 412.
    pub fn check_source(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the source `{name}`"), self.tag_of_source(name)?.as_slice())
    }
}
