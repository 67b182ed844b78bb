//! Prepares and makes a change in one blocking call.

use tokio::sync::oneshot;

use super::Service;
use crate::http::preconditions::Preconditions;
use crate::problem::Problem;
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::session::SlowModels;

impl Service {
    /// Makes a change, and waits until what it ends has ended and its swap is active. Costs that were measured for the original
    /// request are not measured again. Blocks; not for asynchronous callers.
    pub fn apply(&self, owner: &mut Owner, command: Command) -> Result<(), Problem> {
        let workers = self.workshop.at_once();
        match command {
            Command::PutModel { name, media, text } => {
                let prepared = self.check_model(&name, media, &text, &workers)?;
                self.put_model(owner, &name, &Preconditions::default(), prepared).map(drop)
            }
            Command::RollBackModel { name, version } => {
                let content = self.registry.version(&name, version)?;
                let prepared = self.check_model(&name, content.media, &content.text, &workers)?;
                self.roll_back_model(owner, &name, &Preconditions::default(), version, prepared).map(drop)
            }
            Command::RemoveModel { name } => self.remove_model(owner, &name, &Preconditions::default()),
            Command::PutSource { name, document, keeping } => {
                self.put_source(owner, &name, *document, None, keeping).map(drop)
            }
            Command::RemoveSource { name } => self.remove_source(owner, &name),
            Command::PutSession { name, document, keeping } => {
                let (_, ended) = self.put_session(owner, &name, *document, None, None, keeping)?;
                ended.into_iter().for_each(wait);
                Ok(())
            }
            Command::RemoveSession { name } => self.remove_session(owner, &name).map(wait),
            Command::SwapModel { session: name, model } => {
                let (session, entry) = (self.session(&name)?, self.registry.get(&model)?);
                let prepared = session.prepare_swap(&entry, SlowModels::Allowed, &workers)?;
                self.commit_swap(owner, &name, &session, &entry, prepared).map(wait)
            }
            Command::PutShadow { session: name, document } => {
                let (session, entry) = (self.session(&name)?, self.registry.get(&document.model)?);
                let prepared = session.prepare_shadow(entry, &document, &workers)?;
                self.put_shadow(owner, &name, &session, prepared).map(drop)
            }
            Command::DropShadow { session } => {
                let session = self.session(&session)?;
                self.drop_shadow(owner, &session, "the shadow was dropped")
            }
            Command::PromoteShadow { session: name } => {
                let session = self.session(&name)?;
                let entry = session.shadow()?.entry().clone();
                let prepared = session.prepare_promotion(&entry, &workers)?;
                self.commit_swap(owner, &name, &session, &entry, prepared).map(wait)
            }
        }
    }
}

/// Waits for the end; a dropped sender counts as one.
fn wait<T>(ended: oneshot::Receiver<T>) {
    ended.blocking_recv().ok();
}
