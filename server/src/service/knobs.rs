//! Knobs of cameras that are set past their sources.

use super::Service;
use crate::problem::Problem;
use crate::source::control::CameraNames;

impl Service {
    /// 409 where a source of that camera has a lease on its knobs.
    pub fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem> {
        self.sources().iter().try_for_each(|(_, source)| source.refuse_others(camera))?;
        self.sessions().iter().try_for_each(|(_, session)| session.source().source.refuse_others(camera))
    }
}
