//! Entity tags of sessions and sources. Read by everybody, checked on the compile thread, where what they stand for is changed.

use super::{Service, get};
use crate::name::Name;
use crate::preconditions::{EntityTag, Preconditions, digest};
use crate::problem::Problem;

impl Service {
    /// The tag of a session's document: another one after each `PUT`, swap and promotion, the same one after a restart. What the
    /// session does leaves it as it is.
    pub fn session_tag(&self, name: &str) -> Option<EntityTag> {
        match Name::parse(name).and_then(|name| self.declared_sessions.tag(&name)) {
            Some(declared) => Some(EntityTag::new(declared)),
            None => get(&self.sessions, "session", name).ok().map(|session| session.tag()),
        }
    }

    /// The tag of a source's document with the scene that it shows: another one after each `PUT` of either.
    pub fn source_tag(&self, name: &str) -> Option<EntityTag> {
        let key = Name::parse(name)?;
        let (put, document) = match get(&self.sources, "source", name) {
            Ok(source) => {
                let put = self.declared_sources.tag(&key).unwrap_or_else(|| source.id().to_string());
                (put, source.document_now())
            }
            Err(_) => (self.declared_sources.tag(&key)?, self.declared_sources.get(&key)?.document),
        };
        let document = serde_json::to_vec(&document).unwrap_or_default();
        Some(EntityTag::new(format!("{put}-{}", digest(&document))))
    }

    /// Before a change of a session.
    ///
    /// # Errors
    /// 412.
    pub fn check_session(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the session `{name}`"), self.session_tag(name).as_slice())
    }

    /// Before a change of a source.
    ///
    /// # Errors
    /// 412.
    pub fn check_source(&self, name: &str, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check(&format!("the source `{name}`"), self.source_tag(name).as_slice())
    }
}
