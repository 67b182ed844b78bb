//! Knobs of cameras that are set past their sources.

use super::Service;
use crate::problem::Problem;

impl Service {
    /// 409 where a source of that camera, which is named by its path or identity, has a lease on its knobs.
    pub fn refuse_control(&self, device: &str) -> Result<(), Problem> {
        self.sources().iter().try_for_each(|(_, source)| source.refuse_others(device))?;
        self.sessions().iter().try_for_each(|(_, session)| session.source().source.refuse_others(device))
    }
}
