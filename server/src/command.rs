//! A change of what runs or is declared, as it is asked for: on the log with what came of it, and replayed by
//! [`Service::apply`](crate::service::Service::apply).
//!
//! What a start of the service does by itself is none: it follows from what is declared.

use isophote_wire::{SessionDocument, ShadowDocument, SourceDocument};
use serde::{Deserialize, Serialize};

use crate::compiler::Owner;
use crate::declared::Keeping;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::Media;

/// In the order in which the owner makes them, those that were made lead from an empty service to what is declared. What else
/// has to be right when one is asked for (an `If-Match`, room on the machine) is no part of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "change", rename_all = "kebab-case")]
pub enum Command {
    /// Another version of a model, or the first.
    PutModel {
        /// Its own.
        name: Name,
        /// How it was sent.
        media: Media,
        /// As it was sent.
        text: String,
    },
    /// The name means a version that is kept.
    RollBackModel {
        /// The model's.
        name: Name,
        /// Which one.
        version: u64,
    },
    /// With all its versions.
    RemoveModel {
        /// The model's.
        name: Name,
    },
    /// A source, or another in its place.
    PutSource {
        /// Its own.
        name: Name,
        /// As put.
        document: Box<SourceDocument>,
        /// Whether it is there after a restart.
        keeping: Keeping,
    },
    /// It ends.
    RemoveSource {
        /// The source's.
        name: Name,
    },
    /// A session, or another in its place.
    PutSession {
        /// Its own.
        name: Name,
        /// As put.
        document: Box<SessionDocument>,
        /// Whether it is there after a restart.
        keeping: Keeping,
    },
    /// It ends.
    RemoveSession {
        /// The session's.
        name: Name,
    },
    /// A session goes on with another model.
    SwapModel {
        /// The session's.
        session: String,
        /// The model's.
        model: String,
    },
    /// Another model beside that of a session.
    PutShadow {
        /// The session's.
        session: String,
        /// As put.
        document: ShadowDocument,
    },
    /// It ends.
    DropShadow {
        /// The session's.
        session: String,
    },
    /// A session goes on with the model of its shadow, and with its constants.
    PromoteShadow {
        /// The session's.
        session: String,
    },
}

impl Owner {
    /// Makes a change. The log has it as JSON, and `done` or why it was refused.
    pub fn change<T>(
        &mut self,
        command: Command,
        work: impl FnOnce(&mut Owner) -> Result<T, Problem>,
    ) -> Result<T, Problem> {
        let result = work(self);
        let outcome = || result.as_ref().map_or_else(|problem| problem.code, |_| "done");
        tracing::debug!(command = serde_json::to_string(&command).ok(), outcome = outcome(), "change");
        result
    }
}
