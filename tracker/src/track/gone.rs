//! Whether a target's light is missing where the target should be: then there is nothing to fit, and it is looked for elsewhere.
//!
//! What comes in: a frame, and parameters that say what should be seen in it. What goes out: true where its place is as even as
//! noise is. It never knows why, nor for how long.

use isophote_jit::Window;

use super::solver::Solver;
use crate::outline::half_widths;
use crate::sight::view::View;
use crate::solve::residuals::{Over, Residual};

/// What is at most so many half widths of the outline away is the target's place.
const REACH: f64 = 1.5;
/// So many pixels are looked at, a few more or less, in whole rows, …
const PIXELS: usize = 4096;
/// … and at least so many.
const PIXELS_MIN: f64 = 64.0;
/// They vary by less than this share of what they would with the target's light; fewer than that share are saturated; …
const MISSING: f64 = 0.125;
/// … and they vary by no more than so many times what the next but one says that noise is: neighbours share what a camera made of
/// several, or belong to another amplifier or colour.
const EVEN: f64 = 1.35;

/// Sums over rows, each about its own mean.
#[derive(Default)]
struct Variations {
    /// Degrees of freedom.
    freedom: f64,
    /// Of what is seen.
    seen: f64,
    /// Of what should be.
    expected: f64,
    /// Differences of a pixel and the next but one, squared, and how many.
    steps: [f64; 2],
    /// Pixels.
    saturated: f64,
}

impl Solver {
    /// True where nothing is left in a view of the light of a target with these parameters. False for poses, for what is not observed
    /// in one value, and in any doubt: a target that is faint, was moved by less than its size, is covered in part, or may be
    /// where pixels are saturated.
    pub fn is_gone(&self, view: &View, parameters: &[f64]) -> bool {
        let ([roles], 2) = (self.model().roles(), self.model().coordinates().len()) else { return false };
        let half = half_widths(roles, 2, parameters).filter(|_| !self.fits_pose() && roles.centre.len() == 2);
        let (Some(half), Some(predictions)) = (half, self.compiled.predictions()) else { return false };
        let half: Vec<f64> = half.map(|half| REACH * half).collect();
        let part = |axis: usize| {
            let (centre, first) = (parameters[roles.centre[axis].index()], view.window.first()[axis]);
            let end = first + view.window.size()[axis];
            let at = |place: f64| (place.max(0.0) as usize).clamp(first, end);
            at((centre - half[axis]).floor())..at((centre + half[axis]).ceil() + 1.0)
        };
        let (columns, rows) = (part(0), part(1));
        let apart = (columns.len() * rows.len() / PIXELS).max(1);
        let row = |y: usize| Window { x: columns.start, width: columns.len(), y, height: 1, ..view.window };
        let mut all = Variations::default();
        for row in rows.skip(apart / 2).step_by(apart).filter(|_| !columns.is_empty()).map(row) {
            let seen = predictions.residuals(&view.narrowed(row), parameters, &self.constants, Over::Domain);
            let Some(Ok([seen])) = seen.map(<[_; 1]>::try_from) else { return false };
            all.add(&seen.residuals);
        }
        all.freedom >= PIXELS_MIN
            && all.saturated <= MISSING * all.freedom
            && all.seen <= MISSING * all.expected
            && all.seen / all.freedom <= EVEN * all.steps[0] / all.steps[1].max(1.0)
    }
}

impl Variations {
    fn add(&mut self, row: &[Residual]) {
        let pixels: Vec<(usize, [f64; 2])> = row
            .iter()
            .filter(|residual| !residual.saturated)
            .map(|one| (one.pixel, [one.predicted + one.whitened * one.deviation, one.predicted]))
            .collect();
        let count = pixels.len() as f64;
        let variation = |which: usize| {
            let mean = pixels.iter().map(|(_, values)| values[which]).sum::<f64>() / count;
            pixels.iter().map(|(_, values)| (values[which] - mean).powi(2)).sum::<f64>()
        };
        self.saturated += (row.len() - pixels.len()) as f64;
        if pixels.len() < 2 {
            return;
        }
        self.freedom += count - 1.0;
        self.seen += variation(0);
        self.expected += variation(1);
        for three in pixels.windows(3).filter(|three| three[0].0 + 2 == three[2].0) {
            self.steps[0] += 0.5 * (three[2].1[0] - three[0].1[0]).powi(2);
            self.steps[1] += 1.0;
        }
    }
}
