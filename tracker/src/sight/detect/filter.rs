//! `Filter`: correlates an octave's picture with templates, tile by tile, by Fourier transforms, with zeros beyond the
//! border.
//!
//! Tiles overlap by a template's width, so that wrapped values are not used (overlap-save). They fit into a processor's
//! cache, and two of them form one complex picture: a template is real, so they do not mix.

use std::sync::Arc;

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::level::Octave;
use super::template::{HALF_PX, Template};

/// Available tile sides, and the cost of transforms of that length per pixel, ns: lengths with dedicated code in `rustfft`.
const SIDES: [(usize, f64); 6] = [(64, 0.47), (72, 0.44), (128, 0.57), (192, 0.70), (256, 0.61), (288, 0.76)];
/// Overlap of neighbouring tiles.
const OVERLAP: usize = 2 * HALF_PX as usize;
/// Block side of a transposition, pixels.
const BLOCK: usize = 16;

/// Planned Fourier transforms, and the maps of the last octave.
#[derive(Default)]
pub(super) struct Filter {
    planner: Option<FftPlanner<f32>>,
    maps: Vec<Vec<f32>>,
}

/// The tiling along one axis.
struct Axis {
    side: usize,
    tiles: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

/// The transforms of a tile, with buffers.
struct Transform {
    x: Axis,
    y: Axis,
    turned: Vec<Complex<f32>>,
    upright: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

impl Filter {
    /// One map per template, as large as the octave's picture.
    pub fn maps(&mut self, level: &Octave, templates: &[&Template]) -> &[Vec<f32>] {
        let mut transform = self.transform(level.width, level.height);
        let spectra: Vec<Vec<Complex<f32>>> =
            templates.iter().map(|template| transform.spectrum(&template.kernel)).collect();
        // Every pixel is written.
        self.maps.resize_with(templates.len(), Vec::new);
        self.maps.iter_mut().for_each(|map| map.resize(level.values.len(), 0.0));
        let mut tile = vec![Complex::default(); transform.x.side * transform.y.side];
        let mut product = tile.clone();
        let corners = transform.corners();
        for two in corners.chunks(2) {
            transform.read(level, two, &mut tile);
            transform.forward(&mut tile);
            for (spectrum, map) in spectra.iter().zip(&mut self.maps) {
                let factors = transform.turned.iter().zip(spectrum);
                product.iter_mut().zip(factors).for_each(|(product, (a, b))| *product = a * b);
                transform.inverse(&mut product);
                transform.write(two, level, map);
            }
        }
        &self.maps
    }

    fn transform(&mut self, width: usize, height: usize) -> Transform {
        let planner = self.planner.get_or_insert_with(FftPlanner::new);
        let mut axis = |length: usize| {
            let tiles = |side: usize| length.div_ceil(side - OVERLAP);
            let cost = |(side, cost): &(usize, f64)| (tiles(*side) * side) as f64 * cost;
            let (side, _) = SIDES.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(SIDES[0]);
            let (forward, inverse) = (planner.plan_fft_forward(side), planner.plan_fft_inverse(side));
            Axis { side, tiles: tiles(side), forward, inverse }
        };
        let (x, y) = (axis(width), axis(height));
        let plans = [&x.forward, &x.inverse, &y.forward, &y.inverse];
        let scratch = plans.iter().map(|plan| plan.get_inplace_scratch_len()).max().unwrap_or(0);
        let turned = vec![Complex::default(); x.side * y.side];
        let upright = turned.clone();
        Transform { x, y, turned, upright, scratch: vec![Complex::default(); scratch] }
    }
}

impl Transform {
    /// The first pixels of all tiles' results.
    fn corners(&self) -> Vec<[usize; 2]> {
        let of_row = |row: usize| (0..self.x.tiles).map(move |column| [column, row]);
        let place = |[column, row]: [usize; 2]| [column * (self.x.side - OVERLAP), row * (self.y.side - OVERLAP)];
        (0..self.y.tiles).flat_map(of_row).map(place).collect()
    }

    /// The factors for a transformed tile, transposed like it, with the scale of two transforms.
    fn spectrum(&mut self, kernel: &[f32]) -> Vec<Complex<f32>> {
        let (width, height) = (self.x.side, self.y.side);
        let mut tile = vec![Complex::default(); width * height];
        let side = (2 * HALF_PX + 1) as usize;
        let half = HALF_PX as usize;
        for (row, line) in kernel.chunks_exact(side).enumerate() {
            for (column, value) in line.iter().enumerate() {
                let (x, y) = ((column + width - half) % width, (row + height - half) % height);
                tile[y * width + x] = Complex::new(*value, 0.0);
            }
        }
        self.forward(&mut tile);
        let share = 1.0 / (width * height) as f32;
        self.turned.iter().map(|value| value.conj() * share).collect()
    }

    /// Reads two tiles, as real and imaginary part.
    fn read(&self, level: &Octave, corners: &[[usize; 2]], tile: &mut [Complex<f32>]) {
        tile.fill(Complex::default());
        let half = HALF_PX as usize;
        for (part, [left, top]) in corners.iter().enumerate() {
            for row in 0..self.y.side {
                let Some(y) = (top + row).checked_sub(half).filter(|y| *y < level.height) else { continue };
                let first = half.saturating_sub(*left);
                let from = left + first - half;
                let count = (self.x.side - first).min(level.width.saturating_sub(from));
                let line = &level.values[y * level.width + from..][..count];
                let cells = &mut tile[row * self.x.side + first..][..count];
                match part {
                    0 => cells.iter_mut().zip(line).for_each(|(cell, value)| cell.re = *value),
                    _ => cells.iter_mut().zip(line).for_each(|(cell, value)| cell.im = *value),
                }
            }
        }
    }

    fn write(&self, corners: &[[usize; 2]], level: &Octave, map: &mut [f32]) {
        let half = HALF_PX as usize;
        for (part, [left, top]) in corners.iter().enumerate() {
            let count = (self.x.side - OVERLAP).min(level.width - left);
            for row in 0..(self.y.side - OVERLAP).min(level.height - top) {
                let cells = &self.upright[(row + half) * self.x.side + half..][..count];
                let line = &mut map[(top + row) * level.width + left..][..count];
                match part {
                    0 => line.iter_mut().zip(cells).for_each(|(value, cell)| *value = cell.re),
                    _ => line.iter_mut().zip(cells).for_each(|(value, cell)| *value = cell.im),
                }
            }
        }
    }

    /// Transforms into `turned`, which is transposed.
    fn forward(&mut self, tile: &mut [Complex<f32>]) {
        self.x.forward.process_with_scratch(tile, &mut self.scratch[..self.x.forward.get_inplace_scratch_len()]);
        transpose(tile, &mut self.turned, self.x.side);
        let scratch = &mut self.scratch[..self.y.forward.get_inplace_scratch_len()];
        self.y.forward.process_with_scratch(&mut self.turned, scratch);
    }

    /// Transforms a transposed product back, into `upright`.
    fn inverse(&mut self, product: &mut [Complex<f32>]) {
        self.y.inverse.process_with_scratch(product, &mut self.scratch[..self.y.inverse.get_inplace_scratch_len()]);
        transpose(product, &mut self.upright, self.y.side);
        let scratch = &mut self.scratch[..self.x.inverse.get_inplace_scratch_len()];
        self.x.inverse.process_with_scratch(&mut self.upright, scratch);
    }
}

/// Transposes rows of `width`.
fn transpose(from: &[Complex<f32>], to: &mut [Complex<f32>], width: usize) {
    let height = from.len() / width;
    for top in (0..height).step_by(BLOCK) {
        for left in (0..width).step_by(BLOCK) {
            for x in left..(left + BLOCK).min(width) {
                for y in top..(top + BLOCK).min(height) {
                    to[x * height + y] = from[y * width + x];
                }
            }
        }
    }
}
