//! `ExposureKnob`: sets the exposure of a session's source to the session's own advice, while it holds the lease on the
//! source's controls.
//!
//! While another holder has the lease, the session reports that; it takes the lease as soon as it is free.

use std::sync::Arc;
use std::time::Instant;

use isophote_capture::Exposure;
use isophote_tracker::{ControllerOptions, Estimate, ExposureController, Tracker};
use isophote_wire::{ControlCommand, ExposureControl, SessionOptions, SourceDocument};

use crate::problem::Problem;
use crate::source::{LeaseId, Source};

/// A controller and the exposure that it sets.
pub struct ExposureKnob {
    controller: ExposureController,
    exposure: Exposure,
    source: Arc<Source>,
    owner: String,
    id: LeaseId,
}

/// Why a model's sessions cannot control the exposure.
pub const UNADVISED: &str = "the model's exposure cannot be controlled: that needs the role `brightness`, for the goal `centre` \
    a centre or a position, and channels that are fitted as they are, not mixed in `observed`";

impl ExposureKnob {
    /// The knob of a session that asks for exposure control, in its start `epoch`; fails if the source has no exposure to set
    /// or the model advises none.
    pub fn of(
        (session, epoch): (&str, u64),
        options: &SessionOptions,
        source: &Arc<Source>,
        tracker: &Tracker,
    ) -> Result<Option<ExposureKnob>, Problem> {
        if !options.exposure.control {
            return Ok(None);
        }
        if !tracker.advises_exposure() {
            return Err(Problem::wrong_key("not-applicable", "options.exposure.control", UNADVISED));
        }
        let message = "the source has no exposure that could be set";
        let absent = || Problem::wrong_key("not-applicable", "options.exposure.control", message);
        let exposure = source.exposure().ok_or_else(absent)?.clone();
        let mut options = ControllerOptions::default();
        match source.document() {
            SourceDocument::Synthetic(synthetic) => options.latency = u64::from(synthetic.exposure_latency),
            SourceDocument::Camera(camera) => options.latency = u64::from(camera.exposure_latency),
            SourceDocument::Recording(_) | SourceDocument::Pushed(_) => {}
        }
        options.range = exposure.range().unwrap_or(options.range);
        let (controller, source) = (ExposureController::new(options), source.clone());
        let (owner, id) = (format!("session `{session}`"), LeaseId::Session(epoch));
        Ok(Some(ExposureKnob { controller, exposure, source, owner, id }))
    }

    /// Follows the advice of a frame if the session holds the lease.
    pub fn follow(&mut self, estimate: &Estimate) -> ExposureControl {
        self.controller.took(self.exposure.taken());
        let (lease, now) = (self.source.lease(), Instant::now());
        if let Err(whose) = lease.take(&self.owner, &self.id, None, now) {
            return ExposureControl { held: false, reason: Some(whose) };
        }
        if let Some(factor) = self.controller.step(estimate) {
            let command = ControlCommand { exposure: Some(factor), ..ControlCommand::default() };
            let turn = || {
                self.exposure.set(factor);
                self.source.shown_from()
            };
            lease.turn(&self.id, command, now, turn);
        }
        ExposureControl { held: true, reason: None }
    }
}

impl Drop for ExposureKnob {
    /// Resets the exposure for the next holder, if the session still holds the lease.
    fn drop(&mut self) {
        let turn_back = || {
            if self.controller.factor() != 1.0 {
                self.exposure.set(1.0);
            }
        };
        self.source.lease().release(&self.id, Instant::now(), turn_back);
    }
}
