//! `Loops`: the kernels whose sums add up to those of a model.
//!
//! What comes in: one kernel for each of a model's summands. What goes out: their sums, added. It never knows what the sums
//! are for.

use std::sync::Arc;

use isophote_jit::{Kernel, PlaneView, Window};
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
    /// Those of another window as well.
    pub fn add(&mut self, other: Totals) {
        let add = |to: &mut [f64], from: Vec<f64>| to.iter_mut().zip(from).for_each(|(sum, value)| *sum += value);
        add(&mut self.outputs, other.outputs);
        add(&mut self.seen, other.seen);
        self.pixels += other.pixels;
        self.saturated += other.saturated;
    }
}

impl Loops {
    /// `None` when a kernel refuses the planes; they were made for it, so only a bug could.
    pub fn sums(&self, bindings: &Bindings, planes: &[PlaneView], window: Window) -> Option<Totals> {
        let mut totals = Totals::default();
        let run = |kernel: &Arc<Kernel>| kernel.sums(bindings, planes, window).ok();
        let add = |to: &mut Vec<f64>, from: Vec<f64>| match to.is_empty() {
            true => *to = from,
            false => to.iter_mut().zip(from).for_each(|(sum, value)| *sum += value),
        };
        for kernel in &self.seen {
            let sums = run(kernel)?;
            totals.pixels += sums.pixels;
            totals.saturated += sums.saturated;
            add(&mut totals.outputs, sums.outputs);
        }
        totals.seen.clone_from(&totals.outputs);
        // Where nothing was left out there is nothing to make up for.
        if totals.saturated > 0 {
            for kernel in &self.clipped {
                add(&mut totals.outputs, run(kernel)?.outputs);
            }
        }
        Some(totals)
    }
}
