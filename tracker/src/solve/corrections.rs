//! `Corrections`: what means over pixels have beyond pixels' centres, as planes that are added to predictions.
//!
//! What comes in: what they are made for. What goes out: whether they serve a window. It never knows kernels: who has them fills
//! the planes.

use std::sync::{Arc, OnceLock};

use isophote_jit::{Slices, Window};
use serde::{Deserialize, Serialize};

use crate::estimate::Sampled;
use crate::sight::gaps::overlap;
use crate::solve::exact;

/// They are larger than what a fit looks at by so many px on each side.
const ROOM_PX: usize = 2;

/// Something of a window's pixels, one plane for each entry.
pub(crate) type Planes = Vec<Vec<f32>>;

/// By what they were made for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Corrections {
    #[serde(with = "exact")]
    pub at: Vec<f64>,
    pub sampled: Sampled,
    /// Its pixels: the first one's place, and how many along each coordinate.
    window: [[usize; 4]; 2],
    /// They follow from the rest.
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

    /// Points a side of the means, and of those that they are beyond; 1 where there are none.
    pub fn terms(&self) -> [u32; 2] {
        let Sampled { points, slopes } = self.sampled;
        if points > slopes { [points, slopes] } else { [1, 1] }
    }

    /// Whether it has all of a window's pixels, and not many more.
    pub fn serves(&self, sampled: Sampled, window: Window) -> bool {
        let is_tight = (0..4).all(|axis| self.window[1][axis] <= window.size()[axis] + 4 * ROOM_PX);
        self.sampled == sampled && is_tight && overlap(self.window(), window) == Some(window)
    }
}

/// A window and some pixels more, inside of another one.
pub(crate) fn roomy(window: Window, whole: Window) -> Window {
    let (mut first, mut size) = (window.first(), window.size());
    let (from, count) = (whole.first(), whole.size());
    for axis in 0..4 {
        let end = (first[axis] + size[axis] + ROOM_PX).min(from[axis] + count[axis]);
        first[axis] = first[axis].saturating_sub(ROOM_PX).max(from[axis]);
        size[axis] = end - first[axis];
    }
    window_of(first, size)
}

fn window_of([x, y, z, w]: [usize; 4], [width, height, depth, length]: [usize; 4]) -> Window {
    Window { x, y, width, height, slices: Slices { first: [z, w], count: [depth, length] } }
}

/// Fine means less coarse ones.
pub(crate) fn less(mut fine: Planes, coarse: &Planes) -> Planes {
    for (fine, coarse) in fine.iter_mut().zip(coarse) {
        fine.iter_mut().zip(coarse).for_each(|(fine, coarse)| *fine -= coarse);
    }
    fine
}
