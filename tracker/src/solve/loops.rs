//! `Loops`: the kernels whose sums add up to those of a model.
//!
//! What comes in: one kernel for each of a model's summands. What goes out: their sums, added. It never knows what the sums
//! are for.

use std::sync::Arc;

use isophote_jit::{Kernel, PlaneView, Sums, Window};
use isophote_symbolic::Bindings;

/// One kernel a summand; those of pixels at their limit come after those of the others.
#[derive(Clone)]
pub(crate) struct Loops {
    pub seen: Vec<Arc<Kernel>>,
    pub clipped: Vec<Arc<Kernel>>,
}

/// What a pass over all of them sums.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// All outputs.
    pub outputs: Vec<f64>,
    /// Those of pixel values below their limit alone.
    pub seen: Vec<f64>,
    /// Pixel values below their limit, of all that the model observes.
    pub pixels: u64,
    /// Pixel values at their limit.
    pub saturated: u64,
}

impl Totals {
    fn clear(&mut self) {
        self.outputs.clear();
        self.seen.clear();
        (self.pixels, self.saturated) = (0, 0);
    }
}

/// Without a pixel there is nothing to add: a parameter's factor that has no value makes NaN of an empty sum.
fn add(to: &mut Vec<f64>, from: &Sums) {
    to.resize(from.outputs.len(), 0.0);
    if from.pixels > 0 {
        to.iter_mut().zip(&from.outputs).for_each(|(sum, value)| *sum += value);
    }
}

impl Loops {
    /// The sums over windows without a common pixel, into `totals`, whatever was in there. `None` when a kernel refuses the
    /// planes; they were made for it, so only a bug could.
    pub fn sums(
        &self,
        bindings: &Bindings,
        planes: &[PlaneView],
        windows: &[Window],
        totals: &mut Totals,
    ) -> Option<()> {
        totals.clear();
        for window in windows {
            let mut saturated = 0;
            for kernel in &self.seen {
                let sums = kernel.sums(bindings, planes, *window).ok()?;
                totals.pixels += sums.pixels;
                saturated += sums.saturated;
                add(&mut totals.seen, &sums);
                add(&mut totals.outputs, &sums);
            }
            totals.saturated += saturated;
            // Where nothing was left out there is nothing to make up for.
            for kernel in self.clipped.iter().filter(|_| saturated > 0) {
                add(&mut totals.outputs, &kernel.sums(bindings, planes, *window).ok()?);
            }
        }
        Some(())
    }
}
