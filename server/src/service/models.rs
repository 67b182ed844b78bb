//! Models of the registry: checked off the owner thread, put, rolled back and removed.

use std::sync::Arc;

use isophote_machine::monotonic_ns;
use isophote_symbolic::Precision;
use isophote_wire::ModelAnswer;

use super::{Put, Service};
use crate::http::preconditions::Preconditions;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{Media, ModelEntry, Placed};
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::service::turns::FairWorkers;

impl Service {
    /// Parses, compiles and reports a document, without storing it.
    pub fn check_model(
        &self,
        name: &Name,
        media: Media,
        text: &str,
        workers: &FairWorkers,
    ) -> Result<(ModelEntry, ModelAnswer), Problem> {
        let model = workers.piece(|| media.model(text)).map_err(Problem::wrong_document)?;
        let entry = ModelEntry::new(name.clone(), 0, model, media, text, self.registry.cache().clone());
        let kernels = entry.kernels_by(Precision::F32, workers)?;
        let report = workers.piece(|| kernels.report(&monotonic_ns))?;
        let compile_ms: f64 = report.stages.iter().map(|stage| stage.compile_ms).sum();
        self.counters.compile_s.observe(compile_ms / 1e3);
        Ok((entry, ModelAnswer { name: name.to_string(), version: 0, collected: Vec::new(), report }))
    }

    /// `PUT /v1/models/{name}`, prepared by [`Service::check_model`].
    pub fn put_model(
        &self,
        owner: &mut Owner,
        name: &Name,
        preconditions: &Preconditions,
        (entry, mut answer): (ModelEntry, ModelAnswer),
    ) -> Result<(Put, Arc<ModelEntry>, ModelAnswer), Problem> {
        let command = Command::PutModel { name: name.clone(), media: entry.media, text: entry.text.to_string() };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            let Placed { is_new, entry, collected } =
                self.registry.put(owner, name, preconditions, entry, &self.pinned())?;
            (answer.version, answer.collected) = (entry.version, collected);
            tracing::info!(model = name.as_str(), version = entry.version, digest = entry.model.digest(), "model put");
            Ok((if is_new { Put::Created } else { Put::Replaced }, entry, answer))
        })
    }

    /// `POST /v1/models/{name}:rollback`, prepared by [`Service::check_model`].
    pub fn roll_back_model(
        &self,
        owner: &mut Owner,
        name: &Name,
        preconditions: &Preconditions,
        version: u64,
        (entry, mut answer): (ModelEntry, ModelAnswer),
    ) -> Result<(Arc<ModelEntry>, ModelAnswer), Problem> {
        let command = Command::RollBackModel { name: name.clone(), version };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            let placed = self.registry.roll_back(owner, name, preconditions, entry, version, &self.pinned())?;
            answer.version = version;
            Ok((placed.entry, answer))
        })
    }

    /// `DELETE /v1/models/{name}`.
    pub fn remove_model(&self, owner: &mut Owner, name: &Name, preconditions: &Preconditions) -> Result<(), Problem> {
        let command = Command::RemoveModel { name: name.clone() };
        owner.change(command, |owner| {
            self.registry.get(name.as_str())?;
            if let Some((session, _)) = self.sessions().iter().find(|(_, session)| session.uses_model(name.as_str())) {
                return Err(Problem::conflict("in-use", format!("session `{session}` uses the model `{name}`")));
            }
            if let Some(session) = self.user_not_running(name) {
                let detail =
                    format!("session `{session}`, which does not run, uses the model `{name}`; delete it first");
                return Err(Problem::conflict("in-use", detail));
            }
            self.registry.remove(owner, name, preconditions, &self.pinned())?;
            tracing::info!(model = name.as_str(), "model removed");
            Ok(())
        })
    }
}
