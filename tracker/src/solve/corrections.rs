//! `Corrections`: the difference between the mean over a pixel and the value at its centre, as planes added to predictions.
//!
//! Callers with kernels fill the planes.

use std::sync::{Arc, OnceLock};

use isophote_jit::{Slices, Window};
use serde::{Deserialize, Serialize};

use crate::estimate::Sampled;
use crate::sight::gaps::overlap;
use crate::solve::exact;

/// Margin of the planes around the fitted window, px on each side.
const MARGIN_AROUND_PX: usize = 2;

/// One plane over a window per entry of `observed`.
pub(crate) type Planes = Vec<Vec<f32>>;

/// Corrections with the parameters, sampling and window that they hold for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Corrections {
    #[serde(with = "exact")]
    pub at: Vec<f64>,
    pub sampled: Sampled,
    /// The window: its first pixel, and its size along each coordinate.
    window: [[usize; 4]; 2],
    /// Derived from the other fields.
    #[serde(skip)]
    pub planes: Arc<OnceLock<Planes>>,
}

impl Corrections {
    pub fn of(at: &[f64], sampled: Sampled, window: Window) -> Corrections {
        Corrections { at: at.to_vec(), sampled, window: [window.first(), window.size()], planes: Arc::default() }
    }

    pub fn window(&self) -> Window {
        let [first, size] = self.window;
        window_of(first, size)
    }

    /// Points per side of the fine and of the coarse means; 1 where there are no corrections.
    pub fn terms(&self) -> [u32; 2] {
        let Sampled { points, slopes } = self.sampled;
        if points > slopes { [points, slopes] } else { [1, 1] }
    }

    /// Whether it covers a window without being much larger.
    pub fn covers(&self, sampled: Sampled, window: Window) -> bool {
        let is_tight = (0..4).all(|axis| self.window[1][axis] <= window.size()[axis] + 4 * MARGIN_AROUND_PX);
        self.sampled == sampled && is_tight && overlap(self.window(), window) == Some(window)
    }
}

/// A window with a margin, clipped to another one.
pub(crate) fn with_margin(window: Window, bounds: Window) -> Window {
    let (mut first, mut size) = (window.first(), window.size());
    let (from, count) = (bounds.first(), bounds.size());
    for axis in 0..4 {
        let end = (first[axis] + size[axis] + MARGIN_AROUND_PX).min(from[axis] + count[axis]);
        first[axis] = first[axis].saturating_sub(MARGIN_AROUND_PX).max(from[axis]);
        size[axis] = end - first[axis];
    }
    window_of(first, size)
}

fn window_of([x, y, z, w]: [usize; 4], [width, height, depth, length]: [usize; 4]) -> Window {
    Window { x, y, width, height, slices: Slices { first: [z, w], count: [depth, length] } }
}

/// Fine means minus coarse ones.
pub(crate) fn less(mut fine: Planes, coarse: &Planes) -> Planes {
    for (fine, coarse) in fine.iter_mut().zip(coarse) {
        fine.iter_mut().zip(coarse).for_each(|(fine, coarse)| *fine -= coarse);
    }
    fine
}
