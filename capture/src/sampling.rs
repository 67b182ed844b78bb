//! The scene: a model and its numbers in, the expected value of every pixel out.
//!
//! A pixel's value is the mean of the intensity at samples² points, the centres of a grid of equal squares that fill the
//! pixel. One native pass ([`Kernel::render`]) adds one such point for all pixels of a window, so the image is
//! made in bands of rows that stay in the first-level cache.
//!
//! Where the intensity is the same at a pixel's centre and at its eight neighbours' centres it is taken as constant over the
//! pixel: one sample is enough. So the cost of a spot on even ground is the spot's. (A feature that lies wholly between
//! pixel centres, smaller than 0.7 px across, can be missed.)

use std::sync::Arc;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, Window};
use isophote_symbolic::{Bindings, Diagnostics, Lowering, Model, Precision};

/// Rows rendered at a time: with 640 pixels a row two planes of f32 fill 80 KiB at most and usually far less.
pub(crate) const BAND_ROWS: usize = 16;
/// Columns that are looked at together for unevenness.
const TILE_COLUMNS: usize = 16;
/// Columns of one native pass at most: 16 KiB of f32.
const PASS_COLUMNS: usize = 256;

/// Renders one model.
pub(crate) struct Scene {
    kernel: Kernel,
    samples: usize,
}

/// Memory of one band, reused.
#[derive(Default)]
pub(crate) struct Scratch {
    centres: Vec<f32>,
    sums: Vec<f32>,
    uneven: Vec<bool>,
}

/// Why a model cannot be rendered.
#[derive(Debug)]
pub(crate) enum SceneFault {
    /// The model has no rendering program.
    Model(Diagnostics),
    /// The program does not compile: a bug.
    Compile(String),
}

impl Scene {
    /// Compiles the model's rendering program. Fused multiply-add stays out of it, so that frames are the same on all machines.
    pub fn new(model: &Arc<Model>, samples: u32) -> Result<Scene, SceneFault> {
        let lowering = Lowering { fma: false, drop_saturated: false };
        let program = model.rendering(lowering).map_err(SceneFault::Model)?;
        let formats = vec![PixelFormat::U8; program.channels()];
        let options = KernelOptions { precision: Precision::F32, formats, packed: true };
        let kernel = Kernel::compile(&program, &options).map_err(|error| SceneFault::Compile(error.to_string()))?;
        Ok(Scene { kernel, samples: samples as usize })
    }

    /// The expected values of `band.width` × `band.height` pixels, in DN, into `means`.
    pub fn render(&self, numbers: &Numbers, band: Window, scratch: &mut Scratch, means: &mut [f32]) -> Result<(), String> {
        if self.samples == 1 {
            return self.pass(numbers, band, [0.0, 0.0], means);
        }
        // Centres of the band and of one pixel around it: the window cannot start at −1, so the shift does.
        let (width, padded) = (band.width, band.width + 2);
        let around = Window { width: padded, height: band.height + 2, ..band };
        scratch.centres.resize(padded * around.height, 0.0);
        self.pass(numbers, around, [-1.0, -1.0], &mut scratch.centres)?;
        for (row, means) in means.chunks_exact_mut(width).enumerate() {
            let first = (row + 1) * padded + 1;
            means.copy_from_slice(&scratch.centres[first..first + width]);
        }
        uneven_columns(&scratch.centres, padded, band.height, &mut scratch.uneven);
        let mut x = 0;
        while let Some((from, to)) = next_uneven(&scratch.uneven, x) {
            self.sample(numbers, band, from, to, &mut scratch.sums, means)?;
            x = to;
        }
        Ok(())
    }

    /// Replaces columns `from..to` of the band by the mean over all samples.
    fn sample(
        &self, numbers: &Numbers, band: Window, from: usize, to: usize, sums: &mut Vec<f32>, means: &mut [f32],
    ) -> Result<(), String> {
        let width = to - from;
        let window = Window { x: band.x + from, y: band.y, width, height: band.height };
        sums.clear();
        sums.resize(width * band.height, 0.0);
        let n = self.samples;
        let shift = |i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        for j in 0..n {
            for i in 0..n {
                self.add(numbers, window, [shift(i), shift(j)], sums)?;
            }
        }
        let share = 1.0 / (n * n) as f32;
        for (row, sums) in sums.chunks_exact(width).enumerate() {
            let means = &mut means[row * band.width + from..row * band.width + to];
            for (mean, sum) in means.iter_mut().zip(sums) {
                *mean = sum * share;
            }
        }
        Ok(())
    }

    fn pass(&self, numbers: &Numbers, window: Window, shift: [f64; 2], plane: &mut [f32]) -> Result<(), String> {
        plane.fill(0.0);
        self.add(numbers, window, shift, plane)
    }

    fn add(&self, numbers: &Numbers, window: Window, shift: [f64; 2], plane: &mut [f32]) -> Result<(), String> {
        let saturation = &vec![f64::INFINITY; self.kernel.program().channels()];
        let bindings = Bindings {
            parameters: numbers.parameters,
            entry: numbers.parameters,
            constants: numbers.constants,
            saturation,
            shift: &shift,
        };
        self.kernel.render(&bindings, window, plane).map_err(|error| error.to_string())
    }
}

/// What a frame is rendered from.
pub(crate) struct Numbers<'a> {
    /// In document order.
    pub parameters: &'a [f64],
    /// In document order.
    pub constants: &'a [f64],
}

/// Marks the columns (of the band, without the margin) that have a pixel whose 3 × 3 neighbourhood of centres is uneven.
fn uneven_columns(centres: &[f32], padded: usize, rows: usize, uneven: &mut Vec<bool>) {
    let width = padded - 2;
    uneven.clear();
    uneven.resize(width, false);
    // An edge between rows r and r+1, or between columns x and x+1, makes the pixels on both sides uneven.
    for row in 0..rows + 2 {
        let here = &centres[row * padded..][..padded];
        for (x, flag) in uneven.iter_mut().enumerate() {
            *flag |= (here[x] != here[x + 1]) | (here[x + 1] != here[x + 2]);
        }
        if row < rows + 1 {
            let below = &centres[(row + 1) * padded..][..padded];
            for (x, flag) in uneven.iter_mut().enumerate() {
                *flag |= (here[x] != below[x]) | (here[x + 1] != below[x + 1]) | (here[x + 2] != below[x + 2]);
            }
        }
    }
}

/// The next run of tiles with an uneven column at or after `x`, at most [`PASS_COLUMNS`] wide.
fn next_uneven(uneven: &[bool], x: usize) -> Option<(usize, usize)> {
    let from = x + uneven[x..].iter().position(|flag| *flag)?;
    let limit = uneven.len().min(from + PASS_COLUMNS);
    let mut to = from + 1;
    while to < limit {
        let tile = to..limit.min(to + TILE_COLUMNS);
        let Some(last) = uneven[tile.clone()].iter().rposition(|flag| *flag) else { break };
        to = tile.start + last + 1;
    }
    Some((from, to))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_cover_all_uneven_columns_and_end() {
        let mut uneven = vec![false; 700];
        for x in [0, 3, 20, 21, 100, 699] {
            uneven[x] = true;
        }
        uneven[300..650].fill(true);
        let (mut x, mut covered, mut runs) = (0, vec![false; 700], Vec::new());
        while let Some((from, to)) = next_uneven(&uneven, x) {
            assert!(from >= x && to > from && to - from <= PASS_COLUMNS);
            covered[from..to].fill(true);
            runs.push((from, to));
            x = to;
        }
        assert!(uneven.iter().zip(&covered).all(|(uneven, covered)| !uneven || *covered));
        assert_eq!(runs, [(0, 4), (20, 22), (100, 101), (300, 556), (556, 650), (699, 700)]);
    }

    #[test]
    fn one_odd_centre_marks_its_neighbours() {
        for odd in 0..7 * 5 {
            let mut centres = vec![20.0; 7 * 5];
            centres[odd] = 21.0;
            let mut uneven = Vec::new();
            uneven_columns(&centres, 7, 3, &mut uneven);
            let expected: Vec<bool> = (0..5).map(|x| (odd % 7).abs_diff(x + 1) <= 1).collect();
            assert_eq!(uneven, expected, "{odd}");
        }
    }
}
