//! `Grey`: the pixel values of a window as f64, for all image analysis before a fit.

use isophote_frame::{Frame, Plane};
use isophote_jit::{PixelFormat, PlaneView, Window};
use isophote_symbolic::{Model, Summand};

use crate::sight::gaps::fill_parts;
use crate::statistics::median;

/// Weights that combine planes into one picture: a document's `observed`, if it is linear in the channels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Mixture {
    /// The weight of each plane.
    pub weights: Vec<f64>,
    pub constant: f64,
}

impl Mixture {
    /// The mean of the planes.
    pub fn mean(planes: usize) -> Mixture {
        Mixture { weights: vec![1.0 / planes.max(1) as f64; planes], constant: 0.0 }
    }

    /// `observed` of a model; the mean where that is not linear.
    pub fn observed(model: &Model, constants: &[f64]) -> Mixture {
        Mixture::linear(model, constants).unwrap_or_else(|| Mixture::mean(model.channels().len()))
    }

    /// `observed` of a model, when it is linear.
    pub fn linear(model: &Model, constants: &[f64]) -> Option<Mixture> {
        Mixture::of(model.channels().len(), &|pixel| model.observed(pixel, constants))
    }

    /// The same for one entry of `observed`.
    pub fn of_summand(summand: &Summand, constants: &[f64]) -> Option<Mixture> {
        Mixture::of(summand.model().channels().len(), &|pixel| summand.observed(pixel, constants))
    }

    fn of(channels: usize, observed: &dyn Fn(&[f64]) -> f64) -> Option<Mixture> {
        let at = |value: &dyn Fn(usize) -> f64| observed(&(0..channels).map(value).collect::<Vec<f64>>());
        let constant = at(&|_| 0.0);
        let weight = |channel: usize| (at(&|i| if i == channel { PROBE } else { 0.0 }) - constant) / PROBE;
        let mixture = Mixture { weights: (0..channels).map(weight).collect(), constant };
        let probe = |i: usize| PROBE / 3.0 + 7.0 * i as f64;
        let (is, should) = (at(&probe), mixture.at((0..channels).map(probe)));
        let is_linear = (is - should).abs() <= 1e-9 * (is.abs() + PROBE);
        is_linear.then_some(mixture)
    }

    /// `observed` of a pixel saturated in all planes.
    fn limit(&self, saturation: &[f64]) -> f64 {
        self.at(saturation.iter().zip(&self.weights).map(|(l, w)| if *w > 0.0 { *l } else { 0.0 }))
    }

    /// The mixture of one pixel, from its value in each plane.
    pub fn at(&self, values: impl Iterator<Item = f64>) -> f64 {
        self.weights.iter().zip(values).map(|(weight, value)| weight * value).sum::<f64>() + self.constant
    }
}

/// Pixel value at which `observed` is evaluated.
const PROBE: f64 = 100.0;

/// All planes of a window combined into one picture.
#[derive(Clone, Debug)]
pub(crate) struct Grey {
    /// Row by row, slice by slice.
    pub values: Vec<f64>,
    /// Pixels along x, y, z, w.
    pub size: [usize; 4],
    /// Values at or above it are saturated.
    pub saturation: f64,
    /// The step between two pixel values; 0 for fractions.
    pub step: f64,
}

impl Grey {
    /// Reads a window inside the planes; `saturation`: one limit per plane. A pixel saturated in any plane reads as the
    /// largest possible value.
    pub fn read(planes: &[PlaneView], window: Window, saturation: &[f64], mixture: &Mixture) -> Grey {
        let mut grey = Grey::read_with_nan(planes, window, saturation, mixture);
        fill(planes, &mut grey);
        grey
    }

    /// Like [`Grey::read`], with NaN for unknown pixels.
    pub fn read_with_nan(planes: &[PlaneView], window: Window, saturation: &[f64], mixture: &Mixture) -> Grey {
        let limit = mixture.limit(saturation);
        let mut values = Vec::with_capacity(window.pixels());
        let size = window.size();
        for row in 0..size[1..].iter().product() {
            read_row(planes, window, row, saturation, mixture, &mut values);
        }
        Grey { values, size, saturation: limit, step: step(planes, mixture) }
    }

    /// Reads at half the resolution along x and y, each cell the mean of four pixels: for a coarse search in a large
    /// picture.
    pub fn read_halved(planes: &[PlaneView], window: Window, saturation: &[f64], mixture: &Mixture) -> Grey {
        let [width, height, depth, length] = window.size();
        let size = [width / 2, height / 2, depth, length];
        let mut values = Vec::with_capacity(size.iter().product());
        let (mut upper, mut lower) = (Vec::with_capacity(width), Vec::with_capacity(width));
        for slice in 0..depth * length {
            for y in 0..size[1] {
                upper.clear();
                lower.clear();
                read_row(planes, window, slice * height + 2 * y, saturation, mixture, &mut upper);
                read_row(planes, window, slice * height + 2 * y + 1, saturation, mixture, &mut lower);
                let cells = upper.chunks_exact(2).zip(lower.chunks_exact(2));
                values.extend(cells.map(|(above, below)| 0.25 * (above[0] + above[1] + below[0] + below[1])));
            }
        }
        let (saturation, step) = (mixture.limit(saturation), 0.5 * step(planes, mixture));
        let mut grey = Grey { values, size, saturation, step };
        fill(planes, &mut grey);
        grey
    }

    /// Sets parts of the window to NaN.
    pub fn blank(&mut self, window: Window, parts: &[Window]) {
        fill_parts(&mut self.values, window, parts, f64::NAN);
    }

    /// The largest magnitude that adjacent pixels share: all four of a square, in a single row both of a pair. Ignores lone
    /// pixels, lines of them, and unknown ones; 0 where all are unknown.
    pub fn reached(&self) -> f64 {
        let (width, height) = (self.size[0], self.size[1]);
        // NaN propagates.
        let least = |a: f64, b: f64| if a.is_nan() || a.abs() < b.abs() { a.abs() } else { b.abs() };
        let mut reached = 0.0_f64;
        let mut above: Vec<f64> = Vec::new();
        for (number, row) in self.values.chunks_exact(width).enumerate() {
            let pairs = row.windows(2.min(width)).map(|pair| least(pair[0], pair[pair.len() - 1]));
            let pairs: Vec<f64> = pairs.collect();
            match (height, number % height) {
                (1, _) => reached = pairs.iter().copied().fold(reached, f64::max),
                (_, 0) => {}
                _ => {
                    reached = pairs.iter().zip(&above).map(|(here, above)| least(*here, *above)).fold(reached, f64::max)
                }
            }
            above = pairs;
        }
        reached
    }

    /// Number of dimensions with extent, at least one: 1 for a single row, 2 for a single slice.
    pub fn dimensions(&self) -> usize {
        self.size.iter().rposition(|n| *n > 1).map_or(1, |axis| axis + 1)
    }

    /// Position of pixel `i` of `values`, in window coordinates.
    pub fn place(&self, i: usize) -> [f64; 4] {
        place_of(i, self.size)
    }

    /// All rows with their y, z, w.
    pub fn rows(&self) -> impl Iterator<Item = ([f64; 3], &[f64])> + '_ {
        let rows = self.values.chunks_exact(self.size[0]).enumerate();
        rows.map(|(row, values)| (outer_of(row, self.size).map(|at| at as f64), values))
    }

    /// All pixels with their positions, in window coordinates.
    pub fn pixels(&self) -> impl Iterator<Item = ([f64; 4], f64)> + '_ {
        self.values.iter().enumerate().map(|(i, &value)| (self.place(i), value))
    }

    /// Number of saturated pixels.
    pub fn saturated(&self) -> usize {
        self.values.iter().filter(|&&value| value >= self.saturation).count()
    }

    /// Number of saturated pixels in a box, in the first slice.
    pub fn saturated_about(&self, centre: [f64; 4], half: [f64; 4]) -> usize {
        let range = |axis: usize| {
            let (first, last) = (centre[axis] - half[axis], centre[axis] + half[axis]);
            (first.max(0.0) as usize).min(self.size[axis])..((last.max(-1.0) + 1.0) as usize).min(self.size[axis])
        };
        let of_row = |y: usize| range(0).filter(move |x| self.values[y * self.size[0] + x] >= self.saturation).count();
        range(1).map(of_row).sum()
    }

    /// The mean over 3 pixels along each dimension, fewer at the border: in a picture it reduces noise by 3, single hot
    /// pixels by 9.
    pub fn smoothed(&self) -> Vec<f64> {
        let width = self.size[0];
        let mut along = self.values.clone();
        for (row, from) in along.chunks_exact_mut(width).zip(self.values.chunks_exact(width)) {
            for (mean, three) in row.iter_mut().skip(1).zip(from.windows(3)) {
                *mean = (three[0] + three[1] + three[2]) * (1.0 / 3.0);
            }
            if let [first, second, ..] = *from {
                row[0] = 0.5 * (first + second);
            }
            if let [.., second, last] = *from {
                row[width - 1] = 0.5 * (second + last);
            }
        }
        let mut stride = width;
        for axis in 1..self.dimensions() {
            along = smoothed_across(&along, stride, self.size[axis]);
            stride *= self.size[axis];
        }
        along
    }
}

/// The step between two values of the mixture; 0 for fractions.
fn step(planes: &[PlaneView], mixture: &Mixture) -> f64 {
    let is_integer = planes.iter().all(|plane| matches!(plane.format(), PixelFormat::U8 | PixelFormat::U16));
    let largest = mixture.weights.iter().fold(0.0, |largest: f64, weight| largest.max(weight.abs()));
    if is_integer { largest } else { 0.0 }
}

/// Whether pixels may be NaN, which marks unknown ones.
pub(crate) fn may_be_nan(planes: &[PlaneView]) -> bool {
    planes.iter().any(|plane| matches!(plane.format(), PixelFormat::F32 | PixelFormat::F64))
}

/// A lone pixel brighter than adjacent ones by this factor is no light: it exceeds any camera's range.
const LONE: f64 = 65_536.0;

/// The largest plausible magnitude of a pixel in a floating-point picture; infinite for all others, and for a single row,
/// where a line may be one sample wide.
pub(crate) fn brightest(frame: &Frame) -> f64 {
    let is_whole = |plane: &Plane| matches!(plane.format, PixelFormat::U8 | PixelFormat::U16);
    if frame.planes().iter().any(is_whole) || frame.rows() == 1 {
        return f64::INFINITY;
    }
    let of_plane = |channel: usize| {
        let whole = Window::of_size(frame.sides());
        Grey::read_with_nan(&[frame.plane_view(channel)], whole, &[f64::INFINITY], &Mixture::mean(1)).reached()
    };
    let reached = (0..frame.planes().len()).map(of_plane).fold(0.0, f64::max);
    if reached > 0.0 { LONE * reached } else { f64::INFINITY }
}

/// Replaces unknown pixels, and lone ones that are far too bright, by the median of the others.
fn fill(planes: &[PlaneView], grey: &mut Grey) {
    if !may_be_nan(planes) {
        return;
    }
    let reached = LONE * grey.reached();
    let is_known = |value: f64| if reached > 0.0 { value.abs() <= reached } else { !value.is_nan() };
    if grey.values.iter().all(|value| is_known(*value)) {
        return;
    }
    let mut known: Vec<f64> = grey.values.iter().copied().filter(|value| is_known(*value)).collect();
    let median = median(&mut known).unwrap_or(0.0);
    grey.values.iter_mut().filter(|value| !is_known(**value)).for_each(|value| *value = median);
}

/// Appends one row of the window.
fn read_row(
    planes: &[PlaneView],
    window: Window,
    row: usize,
    saturation: &[f64],
    mixture: &Mixture,
    values: &mut Vec<f64>,
) {
    let [y, z, w] = outer_of(row, window.size());
    let [x0, y0, z0, w0] = window.first();
    if let ([plane], [weight], [limit]) = (planes, &mixture.weights[..], saturation)
        && *weight == 1.0
        && mixture.constant == 0.0
        && *limit >= f64::from(u8::MAX)
        && let Some(bytes) = plane.bytes_of_row([x0, y0 + y, z0 + z, w0 + w], window.width)
    {
        values.extend(bytes.iter().map(|byte| f64::from(*byte)));
        return;
    }
    let largest = mixture.limit(saturation);
    if let ([plane], [weight], [limit]) = (planes, &mixture.weights[..], saturation)
        && let Some(bytes) = plane.words_of_row([x0, y0 + y, z0 + z, w0 + w], window.width)
    {
        let (weight, limit) = (*weight, if *weight == 0.0 { f64::INFINITY } else { *limit });
        values.extend(bytes.chunks_exact(2).map(|word| {
            let value = f64::from(u16::from_ne_bytes([word[0], word[1]]));
            let sum = mixture.constant + weight * value;
            if value >= limit { sum.max(largest) } else { sum }
        }));
        return;
    }
    for x in x0..x0 + window.width {
        let (mut sum, mut clipped) = (mixture.constant, false);
        for ((plane, limit), weight) in planes.iter().zip(saturation).zip(&mixture.weights) {
            let value = plane.pixel_at([x, y0 + y, z0 + z, w0 + w]);
            clipped |= value >= *limit && *weight != 0.0;
            sum += weight * value;
        }
        values.push(if clipped { sum.max(largest) } else { sum });
    }
}

/// y, z, w of row number `row`.
fn outer_of(row: usize, [_, height, depth, _]: [usize; 4]) -> [usize; 3] {
    [row % height, row / height % depth, row / height / depth]
}

/// x, y, z, w of pixel number `i`.
pub(crate) fn place_of(i: usize, size: [usize; 4]) -> [f64; 4] {
    let [y, z, w] = outer_of(i / size[0], size);
    [i % size[0], y, z, w].map(|at| at as f64)
}

/// The mean over 3 adjacent blocks (rows, slices, volumes) of `stride` values, `count` per group.
fn smoothed_across(values: &[f64], stride: usize, count: usize) -> Vec<f64> {
    let mut smooth = vec![0.0; values.len()];
    for (group, from) in smooth.chunks_exact_mut(stride * count).zip(values.chunks_exact(stride * count)) {
        for (at, block) in group.chunks_exact_mut(stride).enumerate() {
            let blocks = at.saturating_sub(1)..(at + 2).min(count);
            let share = 1.0 / blocks.len() as f64;
            for near in from[blocks.start * stride..blocks.end * stride].chunks_exact(stride) {
                for (mean, value) in block.iter_mut().zip(near) {
                    *mean += share * value;
                }
            }
        }
    }
    smooth
}

/// The variance of row offsets in each entry of `observed`, relative to that in a plane; empty where there are no separate
/// rows, or where no noise formula weighs pixels against their row.
pub(crate) fn row_shares(model: &Model, constants: &[f64]) -> Vec<f64> {
    if !model.has_noise() || model.coordinates().len() < 2 {
        return Vec::new();
    }
    let entries = model.summands().into_iter().filter(|summand| !summand.is_clipped());
    let share = |summand: Summand| Some(Mixture::of_summand(&summand, constants)?.weights.iter().map(|m| m * m).sum());
    entries.map(share).collect::<Option<_>>().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixtures_follow_linear_observed_formulas() {
        let model = |observed: &str| {
            let text = format!(
                "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"r\", \"g\"]\n[constants]\nc = 0.25\n[parameters]\nv = {{ start = 1.0 }}\n\
                 [model]\nobserved = \"{observed}\"\nintensity = \"v\"\n"
            );
            Model::from_toml(&text).unwrap_or_else(|d| panic!("{}", d[0].render("test")))
        };
        let close = |mixture: Mixture, weights: [f64; 2], constant: f64| {
            let is = mixture.weights.iter().zip(weights).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(is && (mixture.constant - constant).abs() < 1e-12, "{mixture:?}");
        };
        close(Mixture::observed(&model("r - c * g + 3"), &[0.5]), [1.0, -0.5], 3.0);
        close(Mixture::observed(&model("g"), &[0.5]), [0.0, 1.0], 0.0);
        for curved in ["sqrt(r * g)", "r^2 + g", "log(r) + g", "max(r, g)"] {
            close(Mixture::observed(&model(curved), &[0.5]), [0.5, 0.5], 0.0);
        }
    }

    #[test]
    fn smoothing_averages_the_neighbours_inside() {
        for size in [
            [1, 1, 1, 1],
            [2, 1, 1, 1],
            [5, 1, 1, 1],
            [1, 4, 1, 1],
            [5, 4, 1, 1],
            [3, 4, 5, 1],
            [3, 2, 1, 4],
            [2, 3, 4, 3],
        ] {
            let count: usize = size.iter().product();
            let values = (0..count).map(|i| ((i * i) % 17) as f64).collect();
            let grey = Grey { values, size, saturation: 255.0, step: 1.0 };
            for (i, mean) in grey.smoothed().into_iter().enumerate() {
                let here = grey.place(i);
                let is_near = |done: &[f64; 4]| here.iter().zip(done).all(|(a, b)| (a - b).abs() <= 1.0);
                let near: Vec<f64> = grey.pixels().filter(|(done, _)| is_near(done)).map(|(_, value)| value).collect();
                let should = near.iter().sum::<f64>() / near.len() as f64;
                assert!((mean - should).abs() < 1e-12, "{size:?}, {i}: {mean} {should}");
            }
        }
    }
}
