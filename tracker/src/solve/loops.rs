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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use isophote_jit::{KernelOptions, PixelFormat, VectorWidth, has_fma};
    use isophote_symbolic::{Lowering, Method, Model, ParameterId, Precision};

    use super::*;

    /// Derivatives of `v0 · x / w` by v0 and w, over the pixels of a domain.
    fn kernel(domain: &str) -> Arc<Kernel> {
        let text = format!(
            "name = \"ramp\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nv0 = {{ start = 1.0 }}\n\
             w = {{ start = 1.0 }}\n[model]\nintensity = \"v0 * x / w\"\ndomain = \"{domain}\"\n"
        );
        let model = Model::from_toml(&text).unwrap();
        let objective = model.objective(&[ParameterId(0), ParameterId(1)], Method::GaussNewton).unwrap();
        let program = objective.program(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
        let options = KernelOptions {
            precision: Precision::F32,
            width: VectorWidth::Bits128,
            formats: vec![PixelFormat::U8],
            packed: true,
        };
        Arc::new(Kernel::compile(&program, &options).unwrap())
    }

    #[test]
    fn a_summand_without_pixels_adds_nothing() {
        let pixels: Vec<u8> = (0..64).collect();
        let plane = PlaneView::new(PixelFormat::U8, &pixels, 8, 8, 8, 1).unwrap();
        let window = Window::whole(8, 8);
        // w = 0: what is taken out of the sums has no value.
        let bindings = Bindings { parameters: &[1.0, 0.0], entry: &[1.0, 0.0], ..Bindings::default() };
        let empty = kernel("x < 0");
        let alone = empty.sums(&bindings, &[plane], window).unwrap();
        assert!(alone.pixels == 0 && alone.outputs.iter().any(|sum| sum.is_nan()), "{alone:?}");
        let mut totals = Totals::default();
        for clipped in [vec![], vec![empty.clone()]] {
            let loops = Loops { seen: vec![empty.clone()], clipped };
            loops.sums(&bindings, &[plane], &[window; 2], &mut totals).unwrap();
            assert_eq!((totals.outputs.as_slice(), totals.pixels), (&vec![0.0; alone.outputs.len()][..], 0));
        }
        // And with w = 1, beside one that has pixels.
        let bindings = Bindings { parameters: &[1.0, 1.0], entry: &[1.0, 1.0], ..Bindings::default() };
        let full = kernel("x >= 0");
        let loops = Loops { seen: vec![empty, full.clone()], clipped: vec![] };
        loops.sums(&bindings, &[plane], &[window], &mut totals).unwrap();
        let full = full.sums(&bindings, &[plane], window).unwrap();
        assert_eq!((totals.outputs, totals.pixels), (full.outputs, 64));
    }
}
