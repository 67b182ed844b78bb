//! `Readiness`: which prepared kernels a frame's fits found ready.
//!
//! Other threads fill the prepared parts at any time; one frame always gets the same answer. The answers can be
//! recorded and replayed, so that the same sequence of frames has the same estimates.

use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

use super::compiled::Compiled;
use super::sampling::Sampling;
use crate::sight::view::PlaneLayout;

/// The prepared kernels that a frame's fits used beside the model's own; absent where no fit asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameReadiness {
    /// Robust fits and other backgrounds.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub alternatives: Option<bool>,
    /// Finer sampling of pixels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sampling: Option<bool>,
    /// Kernels for rows with offsets.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rows: Option<bool>,
}

/// The readiness of one frame.
#[derive(Debug, Default)]
pub(crate) struct Readiness {
    /// The recorded answers, when a frame is replayed.
    recorded: Option<FrameReadiness>,
    alternatives: OnceLock<bool>,
    sampling: OnceLock<bool>,
    rows: OnceLock<Option<bool>>,
}

impl Readiness {
    /// Replays the recorded answers, else records new ones.
    pub fn of(recorded: Option<FrameReadiness>) -> Readiness {
        Readiness { recorded, ..Readiness::default() }
    }

    /// Whether the kernels of robust fits and other backgrounds were ready when the frame first asked.
    pub fn robust(&self, compiled: &Compiled, layout: &PlaneLayout) -> bool {
        let recorded = self.recorded.map(|recorded| recorded.alternatives == Some(true));
        let is_ready = || recorded.unwrap_or_else(|| compiled.prepared_backgrounds().ready(layout).is_some());
        *self.alternatives.get_or_init(is_ready)
    }

    /// Finer sampling, where it was ready when the frame first asked.
    pub fn sampling(&self, compiled: &Compiled, layout: &PlaneLayout) -> Option<Arc<Sampling>> {
        let recorded = self.recorded.map(|recorded| recorded.sampling == Some(true));
        let is_ready = || recorded.unwrap_or_else(|| compiled.prepared_sampling().ready(layout).is_some());
        let is_ready = *self.sampling.get_or_init(is_ready);
        is_ready.then(|| compiled.sampling())
    }

    /// Whether there are kernels for rows with offsets; `None` where no one had tried to compile them when the frame first
    /// asked.
    pub fn rows(&self, compiled: &Compiled, layout: &PlaneLayout) -> Option<bool> {
        let recorded = self.recorded.map(|recorded| recorded.rows == Some(true));
        let found = || compiled.prepared_rows().ready(layout).map(|kernels| kernels.is_some());
        *self.rows.get_or_init(|| recorded.or_else(found))
    }

    /// The answers given so far.
    pub fn found(&self) -> FrameReadiness {
        let [alternatives, sampling] = [&self.alternatives, &self.sampling].map(|found| found.get().copied());
        let rows = self.rows.get().copied().flatten();
        FrameReadiness { alternatives, sampling, rows }
    }
}
