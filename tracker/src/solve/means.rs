//! Means over a pixel by Gauss points, minus the value at its centre, as a plane.

use std::sync::{Arc, OnceLock};

use isophote_jit::{Kernel, KernelCache, KernelOptions, Window};
use isophote_symbolic::{Bindings, Diagnostics, Precision, Prediction, Quadrature, Summand};

use crate::solve::pixel_handling::{CompileFailure, PixelHandling, lowering};

/// Most points per side that one loop sums.
const POINTS_MAX: u32 = 6;
/// Most points of a pixel that one loop sums.
const PLACES_MAX: u32 = 36;
/// Points per side, in two dimensions, that are summed one by one: for a small target's sharp rim on a camera of little
/// noise.
const FINE: [u32; 3] = [8, 12, 16];

/// One entry of `observed`, and the kernels of mean minus centre, from two points per side on.
pub(crate) struct MeanKernels {
    summand: Summand,
    cache: Arc<KernelCache>,
    kernels: [OnceLock<Arc<Kernel>>; POINTS_MAX as usize - 1],
    /// The value at one point of a pixel.
    shifted: OnceLock<Arc<Kernel>>,
}

/// Available points per side for a model of this many coordinates, from one on.
pub(crate) fn levels(coordinates: usize) -> Vec<u32> {
    let most = (2..=POINTS_MAX).rev().find(|points| points.pow(coordinates as u32) <= PLACES_MAX).unwrap_or(2);
    (1..=most).chain(FINE.into_iter().filter(|_| coordinates == 2)).collect()
}

impl MeanKernels {
    pub fn new(summand: Summand, cache: &Arc<KernelCache>) -> MeanKernels {
        MeanKernels { summand, cache: cache.clone(), kernels: Default::default(), shifted: OnceLock::new() }
    }

    /// The mean by this many points per side minus the value at the centre; `None` where the kernel refuses.
    pub fn mean(
        &self,
        window: Window,
        constants: &[f64],
        at: &[f64],
        points: u32,
    ) -> Result<Option<Vec<f32>>, CompileFailure> {
        let mut plane = vec![0.0_f32; window.pixels()];
        if points < 2 {
            return Ok(Some(plane));
        }
        let kernel = self.kernel(points)?;
        let add = |plane: &mut [f32], shift: &[f64]| {
            let bindings = Bindings { parameters: at, entry: at, constants, saturation: &[], shift };
            kernel.render(&bindings, window, plane).is_ok()
        };
        if points <= POINTS_MAX {
            return Ok(add(&mut plane, &[]).then_some(plane));
        }
        let rule = Quadrature::rule(points as usize);
        let nodes = rule.iter().flat_map(|(x, wx)| rule.iter().map(move |(y, wy)| ([*x, *y], wx * wy)));
        let mut sums = vec![0.0; plane.len()];
        for (shift, weight) in nodes.chain([([0.0, 0.0], -1.0)]) {
            plane.fill(0.0);
            if !add(&mut plane, &shift) {
                return Ok(None);
            }
            sums.iter_mut().zip(&plane).for_each(|(sum, value)| *sum += weight * f64::from(*value));
        }
        Ok(Some(sums.into_iter().map(|sum| sum as f32).collect()))
    }

    /// The kernel for this many points, compiled now if need be: it sums all of them, or evaluates one.
    pub fn kernel(&self, points: u32) -> Result<Arc<Kernel>, CompileFailure> {
        let known = if points > POINTS_MAX { &self.shifted } else { &self.kernels[points as usize - 2] };
        if let Some(kernel) = known.get() {
            return Ok(kernel.clone());
        }
        let program = match points > POINTS_MAX {
            true => self.summand.rendering(lowering(PixelHandling::All)),
            // A model whose intensity reads a channel has no prediction.
            false => {
                let program =
                    self.summand.prediction(Prediction::Correction(points as usize), lowering(PixelHandling::All));
                program.unwrap_or_else(|| Err(Diagnostics::default()))
            }
        };
        let program = program.map_err(CompileFailure::Model)?;
        let options =
            KernelOptions { width: self.cache.width(), precision: Precision::F32, formats: Vec::new(), packed: true };
        let kernel = self.cache.get_or_compile_wide(&program, &options);
        let kernel = kernel.map_err(|error| CompileFailure::Kernel(Arc::new(error)))?;
        Ok(known.get_or_init(|| kernel).clone())
    }
}
