//! `Kernels` and `RenderedLight`: rendered predictions of a model for each channel, and their Fisher information about
//! its parameters.
//!
//! Of the camera only the clipping value is used.

use std::sync::Arc;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction, Summand};
use nalgebra::DMatrix;

use crate::sight::grey::Mixture;
use crate::sight::view::PlaneLayout;
use crate::solve::loops::{Loops, Totals};
use crate::solve::stage_kernels::{Job, PixelHandling, lowering};
use crate::track::solver::Solver;

/// Largest rendered window, pixels.
pub(super) const PIXELS_MAX: usize = 1 << 20;
/// Largest frame up to the end of the window, pixels.
const FRAME_PIXELS_MAX: usize = 1 << 26;

/// Kernels that render the model and sum its Fisher information.
pub(crate) struct Kernels {
    /// A kernel for each distinct picture.
    render: Vec<Arc<Kernel>>,
    /// Index of the picture of each channel.
    seen: Vec<usize>,
    information: Loops,
}

/// Rendered pictures of a window.
pub(crate) struct RenderedLight {
    /// Pixels of each picture, row by row; NaN outside the domain.
    pictures: Vec<Vec<f32>>,
    /// The same pixels in frames that end with the window.
    frames: Vec<Vec<u8>>,
    sides: [usize; 4],
    window: Window,
}

/// The channel of each entry of `observed`; `None` when an entry mixes several channels, or two share one.
pub(super) fn channels_as_they_are(model: &Model, constants: &[f64]) -> Option<Vec<usize>> {
    let entries = model.summands().into_iter().filter(|summand| !summand.is_clipped());
    let channel = |summand: Summand| {
        let Mixture { weights, constant } = Mixture::of_summand(&summand, constants)?;
        let is_alone = constant == 0.0 && weights.iter().filter(|weight| **weight != 0.0).count() == 1;
        weights.iter().position(|weight| *weight == 1.0).filter(|_| is_alone)
    };
    let channels: Vec<usize> = entries.map(channel).collect::<Option<_>>()?;
    let is_twice = |(i, channel): (usize, &usize)| channels[..i].contains(channel);
    (!channels.iter().enumerate().any(is_twice)).then_some(channels)
}

impl Kernels {
    /// Compiles for this precision. `None` when a kernel fails to compile, or the prediction reads a frame.
    pub fn compile(solver: &Solver, precision: Precision) -> Option<Kernels> {
        let model = solver.model();
        if model.needs_a_frame() {
            return None;
        }
        let options = KernelOptions {
            width: VectorWidth::Bits128,
            precision: Precision::F32,
            formats: vec![PixelFormat::F32; model.channels().len()],
            packed: true,
        };
        let kernel = |summand: &Summand| {
            let program = summand.prediction(Prediction::Intensity, lowering(PixelHandling::All))?.ok()?;
            Kernel::compile(&program, &options).ok().map(Arc::new)
        };
        let mut entries = model.summands().into_iter().filter(|summand| !summand.is_clipped());
        let mut seen = vec![0; model.channels().len()];
        let render = match channels_as_they_are(model, &solver.constants) {
            Some(channels) => {
                channels.into_iter().enumerate().for_each(|(entry, channel)| seen[channel] = entry);
                entries.map(|summand| kernel(&summand)).collect::<Option<_>>()?
            }
            // Unknown mixtures: every channel sees the same picture.
            None => vec![kernel(&entries.next()?)?],
        };
        let pixel = [0u8; 4];
        let plane = PlaneView::new(PixelFormat::F32, &pixel, 1, 1, 4, 4).ok()?;
        let layout = PlaneLayout::of(&vec![plane; seen.len()]);
        let information =
            solver.compiled.loops_in(precision, Job::Covariance, PixelHandling::SkipSaturated, &layout).ok()?;
        Some(Kernels { render, seen, information })
    }

    /// The bounding box of the model's domain in a window; `None` when it is empty.
    pub fn domain(&self, solver: &Solver, parameters: &[f64], whole: Window) -> Option<Window> {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for y in (whole.y..whole.y + whole.height).step_by(ROWS) {
            let strip = Window { y, height: ROWS.min(whole.y + whole.height - y), ..whole };
            for picture in self.pictures(solver, parameters, strip)? {
                for (i, _) in picture.iter().enumerate().filter(|(_, pixel)| !pixel.is_nan()) {
                    let at = [whole.x + i % strip.width, y + i / strip.width % strip.height];
                    low = std::array::from_fn(|axis| low[axis].min(at[axis]));
                    high = std::array::from_fn(|axis| high[axis].max(at[axis]));
                }
            }
        }
        let [width, height] = std::array::from_fn(|axis| (high[axis] + 1).saturating_sub(low[axis]));
        (low[0] != usize::MAX).then_some(Window { x: low[0], y: low[1], width, height, ..whole })
    }

    fn pictures(&self, solver: &Solver, parameters: &[f64], window: Window) -> Option<Vec<Vec<f32>>> {
        let bindings = bindings(solver, parameters, &[f64::INFINITY], &[0.0; 4]);
        let picture = |kernel: &Arc<Kernel>| {
            let mut pixels = vec![0f32; window.pixels()];
            kernel.render(&bindings, window, &mut pixels).ok().map(|()| pixels)
        };
        self.render.iter().map(picture).collect()
    }

    /// The Fisher information about the parameters of the last stage, with the sums; pixels at the limit are dropped or
    /// censored, as in the model.
    pub fn information(
        &self,
        solver: &Solver,
        parameters: &[f64],
        light: &RenderedLight,
        limit: f64,
    ) -> Option<(DMatrix<f64>, Totals)> {
        let planes: Vec<PlaneView> = self.seen.iter().map(|picture| light.plane(*picture)).collect::<Option<_>>()?;
        let limits = vec![limit; planes.len()];
        let bindings = bindings(solver, parameters, &limits, &[]);
        let mut sums = Totals::default();
        self.information.sums(&bindings, &planes, &[light.window], &[], &[], &mut sums)?;
        let n = solver.compiled.last_parameters().len();
        let upper = sums.outputs.get(1 + n..).filter(|upper| upper.len() == n * (n + 1) / 2)?;
        let mut information = DMatrix::zeros(n, n);
        let mut entries = upper.iter();
        for (i, j) in (0..n).flat_map(|i| (i..n).map(move |j| (i, j))) {
            let entry = 0.5 * entries.next()?;
            information[(i, j)] = entry;
            information[(j, i)] = entry;
        }
        Some((information, sums))
    }
}

/// Rows rendered at a time to find the domain.
const ROWS: usize = 64;

impl RenderedLight {
    /// Renders the model's pictures of a window. `None` when it is too large, or the prediction reads a frame.
    pub fn of(solver: &Solver, kernels: &Kernels, parameters: &[f64], window: Window) -> Option<RenderedLight> {
        let sides: [usize; 4] = std::array::from_fn(|axis| window.first()[axis] + window.size()[axis]);
        let count = sides.iter().try_fold(1usize, |count, side| count.checked_mul(*side))?;
        if count > FRAME_PIXELS_MAX || window.pixels() > PIXELS_MAX {
            return None;
        }
        let pictures = kernels.pictures(solver, parameters, window)?;
        let frames = pictures.iter().map(|pixels| framed(pixels, window, sides)).collect();
        Some(RenderedLight { pictures, frames, sides, window })
    }

    /// Pixel values of all pictures; NaN outside the domain.
    pub fn pixels(&self) -> impl Iterator<Item = f32> + '_ {
        self.pictures.iter().flatten().copied()
    }

    fn plane(&self, picture: usize) -> Option<PlaneView<'_>> {
        let [width, height, depth, _] = self.sides;
        let strides = [4, 4 * width, 4 * width * height, 4 * width * height * depth];
        PlaneView::stack(PixelFormat::F32, self.frames.get(picture)?, self.sides, strides).ok()
    }
}

/// Copies a window into a frame that ends with it; pixels before the window are never read.
fn framed(pixels: &[f32], window: Window, sides: [usize; 4]) -> Vec<u8> {
    let mut bytes = vec![0; 4 * sides.iter().product::<usize>()];
    let ([x, y, z, w], [_, height, depth, _]) = (window.first(), window.size());
    for (row, values) in pixels.chunks_exact(window.width).enumerate() {
        let (at_y, at_z, at_w) = (y + row % height, z + row / height % depth, w + row / height / depth);
        let first = 4 * (((at_w * sides[2] + at_z) * sides[1] + at_y) * sides[0] + x);
        for (four, value) in bytes[first..].chunks_exact_mut(4).zip(values) {
            four.copy_from_slice(&if value.is_nan() { [0; 4] } else { value.to_ne_bytes() });
        }
    }
    bytes
}

fn bindings<'a>(solver: &'a Solver, parameters: &'a [f64], saturation: &'a [f64], shift: &'a [f64]) -> Bindings<'a> {
    Bindings { parameters, entry: parameters, constants: &solver.constants, saturation, shift }
}
