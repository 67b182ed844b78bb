//! Entity tags of sessions and sources. Read by everybody, checked on the compile thread, where what they stand for is changed.

use axum::http::StatusCode;

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
        match Name::parse(name).and_then(|name| self.declared_sessions.tag(&name)) {
            Some(declared) => Ok(EntityTag::new(declared)),
            None => Ok(get(&self.sessions, "session", name)?.tag()),
        }
    }

    /// The tag of a source's document with the scene that it shows: another one after each `PUT` of either.
    ///
    /// # Errors
    /// 404.
    pub fn source_tag(&self, name: &str) -> Result<EntityTag, Problem> {
        let key = Name::parse(name);
        let declared = key.as_ref().and_then(|key| self.declared_sources.tag(key));
        let (put, document) = match get(&self.sources, "source", name) {
            Ok(source) => (declared.unwrap_or_else(|| source.id().to_string()), source.document_now()),
            Err(unknown) => {
                let record = key.and_then(|key| self.declared_sources.get(&key));
                declared.zip(record.map(|record| record.document)).ok_or(unknown)?
            }
        };
        let document = serde_json::to_vec(&document).map_err(|error| Problem::bug(error.to_string()))?;
        Ok(EntityTag::new(format!("{put}-{}", digest(&document))))
    }

    /// Before a change of a session.
    ///
    /// # Errors
    /// 412.
    pub fn check_session(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the session `{name}`"), present(self.session_tag(name))?.as_slice())
    }

    /// Before a change of a source.
    ///
    /// # Errors
    /// 412.
    pub fn check_source(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the source `{name}`"), present(self.source_tag(name))?.as_slice())
    }
}

/// Of what is absent there is no tag.
fn present(tag: Result<EntityTag, Problem>) -> Result<Option<EntityTag>, Problem> {
    match tag {
        Err(problem) if problem.status == StatusCode::NOT_FOUND => Ok(None),
        tag => tag.map(Some),
    }
}
