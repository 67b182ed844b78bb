//! `Command`: a requested change of what runs or is declared. It is logged with its outcome, and
//! [`Service::apply`](crate::service::Service::apply) replays it.
//!
//! What a start of the service restores is no command: it follows from the declarations.

use isophote_wire::{SessionDocument, ShadowDocument, SourceDocument};
use serde::{Deserialize, Serialize};

use crate::name::Name;
use crate::problem::Problem;
use crate::registry::Media;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;

/// In the owner's order, the accepted commands lead from an empty service to its declarations. Preconditions (`If-Match`, free
/// capacity) are not part of a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "change", rename_all = "kebab-case")]
pub enum Command {
    /// Puts the first or another version of a model.
    PutModel {
        /// Its name.
        name: Name,
        /// Its media type.
        media: Media,
        /// As it was sent.
        text: String,
    },
    /// Makes a kept version the current one.
    RollBackModel {
        /// The model's name.
        name: Name,
        /// The version's number.
        version: u64,
    },
    /// Removes a model with all its versions.
    RemoveModel {
        /// The model's name.
        name: Name,
    },
    /// Creates or replaces a source.
    PutSource {
        /// Its name.
        name: Name,
        /// As put.
        document: Box<SourceDocument>,
        /// Whether it survives a restart.
        keeping: Keeping,
    },
    /// Removes a source.
    RemoveSource {
        /// The source's name.
        name: Name,
    },
    /// Creates or replaces a session.
    PutSession {
        /// Its name.
        name: Name,
        /// As put.
        document: Box<SessionDocument>,
        /// Whether it survives a restart.
        keeping: Keeping,
    },
    /// Removes a session.
    RemoveSession {
        /// The session's name.
        name: Name,
    },
    /// Swaps the model of a session.
    SwapModel {
        /// The session's name.
        session: String,
        /// The model's name.
        model: String,
    },
    /// Creates or replaces the shadow of a session.
    PutShadow {
        /// The session's name.
        session: String,
        /// As put.
        document: ShadowDocument,
    },
    /// Drops the shadow of a session.
    DropShadow {
        /// The session's name.
        session: String,
    },
    /// Swaps a session to the model and constants of its shadow.
    PromoteShadow {
        /// The session's name.
        session: String,
    },
}

impl Owner {
    /// Makes a change. Logs the command as JSON with `done` or the code of its refusal.
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
