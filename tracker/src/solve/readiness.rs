//! `Readiness`: what of a frame's fits was prepared beside them, and was there.
//!
//! What comes in: shelves that somebody else fills at any time. What goes out: for one frame always the same answer, which can be
//! told again: the same frame, after the same ones, then has the same estimates.

use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

use super::compiled::Compiled;
use super::sampling::Sampling;
use crate::sight::view::PlaneLayout;

/// What a frame's fits could use beside the model's own kernels; absent where none of them asked for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameReadiness {
    /// Robust fits and other backgrounds.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub alternatives: Option<bool>,
    /// Finer sampling of pixels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sampling: Option<bool>,
    /// Kernels for rows that are off.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rows: Option<bool>,
}

/// One frame's.
#[derive(Debug, Default)]
pub(crate) struct Readiness {
    /// As it was for the same frame before.
    told: Option<FrameReadiness>,
    alternatives: OnceLock<bool>,
    sampling: OnceLock<bool>,
    rows: OnceLock<Option<bool>>,
}

impl Readiness {
    /// As it was told, else as it turns out.
    pub fn of(told: Option<FrameReadiness>) -> Readiness {
        Readiness { told, ..Readiness::default() }
    }

    /// Whether the kernels of robust fits and of other backgrounds were there when the frame first asked for them.
    pub fn robust(&self, compiled: &Compiled, layout: &PlaneLayout) -> bool {
        let told = self.told.map(|told| told.alternatives == Some(true));
        let is_ready = || told.unwrap_or_else(|| compiled.backgrounds_shelf().ready(layout).is_some());
        *self.alternatives.get_or_init(is_ready)
    }

    /// Finer sampling, where it was there when the frame first asked for it.
    pub fn sampling(&self, compiled: &Compiled, layout: &PlaneLayout) -> Option<Arc<Sampling>> {
        let told = self.told.map(|told| told.sampling == Some(true));
        let is_ready = || told.unwrap_or_else(|| compiled.sampling_shelf().ready(layout).is_some());
        let is_ready = *self.sampling.get_or_init(is_ready);
        is_ready.then(|| compiled.sampling())
    }

    /// Whether there are kernels for rows that are off; `None` where nobody had tried to make them when the frame first asked.
    pub fn rows(&self, compiled: &Compiled, layout: &PlaneLayout) -> Option<bool> {
        let told = self.told.map(|told| told.rows == Some(true));
        let found = || compiled.rows_shelf().ready(layout).map(|kernels| kernels.is_some());
        *self.rows.get_or_init(|| told.or_else(found))
    }

    /// As it turned out.
    pub fn found(&self) -> FrameReadiness {
        let [alternatives, sampling] = [&self.alternatives, &self.sampling].map(|found| found.get().copied());
        let rows = self.rows.get().copied().flatten();
        FrameReadiness { alternatives, sampling, rows }
    }
}
