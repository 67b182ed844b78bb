//! Renders the expected value of every pixel of a model.
//!
//! A pixel's value is the mean of the intensity at samples² points, the centres of a grid of equal squares that fill the
//! pixel, over the points where it is a number: a root outside of its disc gives no light there. A slice of a stack is thin
//! and a volume of a series short: they are sampled at their z and w. One native pass ([`Kernel::render`]) adds one such
//! point for all pixels of a window; bands of rows keep the image in the L1 cache.
//!
//! Where the intensity is smooth, the mean follows from the centres alone. With u, v the offsets of the samples, mean u² =
//! (1 − 1/samples²)/12, so the mean of f is f + (1 − 1/samples²)/24 · (f_xx + f_yy) up to fourth-order terms, which are
//! below 1/100 of the fourth differences of the centres. This is used where those are below [`SMOOTH_DN`]; edges, kinks and
//! small spots are sampled, so a frame costs little more than its edges. (A feature that lies wholly between pixel centres,
//! smaller than 0.7 px across, can be missed.)

use isophote_jit::{Kernel, KernelOptions, PixelFormat, VectorWidth, Window};
use isophote_symbolic::{Bindings, Diagnostics, Lowering, Precision, Summand};

/// Rows rendered at a time: with 640 pixels per row, two planes of f32 fill at most 80 KiB, usually far less.
pub(crate) const BAND_ROWS: usize = 16;
/// Fourth differences up to this, in DN, count as smooth: the mean is then accurate to a thousandth of a DN.
const SMOOTH_DN: f32 = 0.1;
/// Centres needed around a band, px.
const MARGIN: usize = 2;
/// Up to this many smooth columns between two uneven ones are sampled with them.
const TILE_COLUMNS: usize = 16;
/// Most columns of one native pass: 16 KiB of f32.
const PASS_COLUMNS: usize = 256;

/// Renders one model.
pub(crate) struct Scene {
    kernel: Kernel,
    samples: usize,
}

/// Reusable buffers of one band.
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
    /// Compiles the model's rendering program, without fused multiply-add, so that frames are the same on all machines.
    pub fn new(summand: &Summand, samples: u32) -> Result<Scene, SceneFault> {
        let lowering = Lowering { fma: false, drop_saturated: false };
        let program = summand.rendering(lowering).map_err(SceneFault::Model)?;
        let formats = vec![PixelFormat::U8; program.channels()];
        let options = KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats, packed: true };
        let kernel = Kernel::compile(&program, &options).map_err(|error| SceneFault::Compile(error.to_string()))?;
        Ok(Scene { kernel, samples: samples as usize })
    }

    /// Renders the expected values of `band.width` × `band.height` pixels of one slice, in DN, into `means`.
    pub fn render(
        &self,
        numbers: &RenderedNumbers,
        band: Window,
        scratch: &mut Scratch,
        means: &mut [f32],
    ) -> Result<(), String> {
        if self.samples == 1 {
            return self.pass(numbers, band, [0.0, 0.0], means);
        }
        // Centres of the band and its margin: a window cannot start at −2, so the shift is negative.
        let padded = band.width + 2 * MARGIN;
        let around = Window { width: padded, height: band.height + 2 * MARGIN, ..band };
        scratch.centres.resize(padded * around.height, 0.0);
        self.pass(numbers, around, [-(MARGIN as f64); 2], &mut scratch.centres)?;
        scratch.uneven.clear();
        scratch.uneven.resize(band.width, false);
        let weight = (1.0 - 1.0 / (self.samples * self.samples) as f32) / 24.0;
        for (row, means) in means.chunks_exact_mut(band.width).enumerate() {
            let rows = std::array::from_fn(|i| &scratch.centres[(row + i) * padded..][..padded]);
            smooth(rows, weight, means, &mut scratch.uneven);
        }
        let mut x = 0;
        while let Some((from, to)) = next_uneven(&scratch.uneven, x) {
            self.sample(numbers, band, from, to, &mut scratch.sums, means)?;
            x = to;
        }
        Ok(())
    }

    /// Replaces the columns `from..to` of the band by the mean over all samples.
    fn sample(
        &self,
        numbers: &RenderedNumbers,
        band: Window,
        from: usize,
        to: usize,
        sums: &mut Vec<f32>,
        means: &mut [f32],
    ) -> Result<(), String> {
        let width = to - from;
        let window = Window { x: band.x + from, width, ..band };
        sums.clear();
        sums.resize(width * band.height, 0.0);
        for shift in self.shifts() {
            self.add(numbers, window, shift, sums)?;
        }
        let share = 1.0 / (self.samples * self.samples) as f32;
        if sums.iter().any(|sum| sum.is_nan()) {
            self.fill_undefined(numbers, window, sums)?;
        }
        for (row, sums) in sums.chunks_exact(width).enumerate() {
            let means = &mut means[row * band.width + from..row * band.width + to];
            for (mean, sum) in means.iter_mut().zip(sums) {
                *mean = sum * share;
            }
        }
        Ok(())
    }

    /// Offsets of the samples from the pixel's centre, px.
    fn shifts(&self) -> impl Iterator<Item = [f64; 2]> + use<> {
        let n = self.samples;
        let shift = move |i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        (0..n * n).map(move |k| [shift(k % n), shift(k / n)])
    }

    /// Replaces NaN sums by those of the defined samples, scaled to the full number of samples.
    fn fill_undefined(&self, numbers: &RenderedNumbers, window: Window, sums: &mut [f32]) -> Result<(), String> {
        let mut plane = vec![0.0; sums.len()];
        let mut found = vec![(0.0_f32, 0_u32); sums.len()];
        for shift in self.shifts() {
            self.pass(numbers, window, shift, &mut plane)?;
            for ((sum, count), value) in found.iter_mut().zip(&plane).filter(|(_, value)| !value.is_nan()) {
                *sum += value;
                *count += 1;
            }
        }
        for (sum, (known, count)) in sums.iter_mut().zip(found).filter(|(sum, _)| sum.is_nan()) {
            *sum = known / count as f32 * (self.samples * self.samples) as f32;
        }
        Ok(())
    }

    fn pass(
        &self,
        numbers: &RenderedNumbers,
        window: Window,
        shift: [f64; 2],
        plane: &mut [f32],
    ) -> Result<(), String> {
        plane.fill(0.0);
        self.add(numbers, window, shift, plane)
    }

    fn add(&self, numbers: &RenderedNumbers, window: Window, shift: [f64; 2], plane: &mut [f32]) -> Result<(), String> {
        let saturation = &vec![f64::INFINITY; self.kernel.program().channels()];
        let shift = [shift[0] + numbers.origin[0], shift[1] + numbers.origin[1]];
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

/// Inputs of a rendering.
pub(crate) struct RenderedNumbers<'a> {
    /// In document order.
    pub parameters: &'a [f64],
    /// In document order.
    pub constants: &'a [f64],
    /// Position of the frame's first pixel, px: left of and above (0, 0) if its surroundings are rendered as well.
    pub origin: [f64; 2],
}

/// Computes the means of a row as if it were smooth, from the centres of five rows around it, and marks uneven columns.
fn smooth(rows: [&[f32]; 5], weight: f32, means: &mut [f32], uneven: &mut [bool]) {
    let width = means.len();
    // One bounds check per row instead of one per pixel.
    let [above2, above, here, below, below2] = rows.map(|row| &row[..width + 2 * MARGIN]);
    for x in 0..width {
        let (c, i) = (here[x + MARGIN], x + MARGIN);
        let (left, right, up, down) = (here[i - 1], here[i + 1], above[i], below[i]);
        let (across, along) = (left + right - 2.0 * c, up + down - 2.0 * c);
        // δ⁴ in x and in y, and δ² in x of δ² in y.
        let fourth_x = here[i - 2] + here[i + 2] - 4.0 * (left + right) + 6.0 * c;
        let fourth_y = above2[i] + below2[i] - 4.0 * (up + down) + 6.0 * c;
        let corners = above[i - 1] + above[i + 1] + below[i - 1] + below[i + 1];
        let mixed = corners - 2.0 * (left + right + up + down) + 4.0 * c;
        let roughness = fourth_x.abs() + fourth_y.abs() + mixed.abs();
        means[x] = c + weight * (across + along);
        // NaN counts as uneven.
        uneven[x] |= !matches!(roughness.partial_cmp(&SMOOTH_DN), Some(std::cmp::Ordering::Less));
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

    /// Renders `width` pixels from five rows of centres.
    fn means_of(f: impl Fn(f32, f32) -> f32, width: usize, samples: f32) -> (Vec<f32>, Vec<bool>) {
        let centre = |row: usize, i: usize| f(i as f32 - MARGIN as f32, row as f32 - MARGIN as f32);
        let rows: Vec<Vec<f32>> = (0..5).map(|row| (0..width + 4).map(|i| centre(row, i)).collect()).collect();
        let (mut means, mut uneven) = (vec![0.0; width], vec![false; width]);
        let weight = (1.0 - 1.0 / (samples * samples)) / 24.0;
        smooth(std::array::from_fn(|i| rows[i].as_slice()), weight, &mut means, &mut uneven);
        (means, uneven)
    }

    /// Smooth images against the mean over all samples in f64: accurate to 0.001 DN wherever they are marked smooth.
    #[test]
    fn smooth_means_match_the_mean_of_all_samples() {
        let pictures: [fn(f64, f64) -> f64; 4] = [
            |x, y| 20.0 + 150.0 * (-((x - 30.0).powi(2) / 450.0 + (y - 3.0).powi(2) / 200.0)).exp(),
            |x, y| 20.0 + 220.0 * (-((x - 31.3).powi(2) + (y - 1.0).powi(2)) / 8.0).exp(),
            |x, y| 100.0 + 3.0 * x - 2.0 * y + 0.05 * x * x,
            |x, _| if x < 20.4 { 100.0 } else { 100.0 + 2.0 * (x - 20.4) },
        ];
        for (number, f) in pictures.into_iter().enumerate() {
            let (means, uneven) = means_of(|x, y| f(x.into(), y.into()) as f32, 60, 8.0);
            assert!(uneven.iter().filter(|u| !**u).count() > 40, "picture {number} is mostly smooth");
            for (x, mean) in means.iter().enumerate().filter(|(x, _)| !uneven[*x]) {
                let at = |i: u32| (f64::from(i) + 0.5) / 8.0 - 0.5;
                let samples = (0..64).map(|k| f(x as f64 + at(k % 8), at(k / 8)));
                let expected = samples.sum::<f64>() / 64.0;
                assert!((f64::from(*mean) - expected).abs() < 1e-3, "picture {number}, {x}: {mean} for {expected}");
            }
        }
    }

    /// A deviating centre or a NaN among the 3 × 3 around a pixel marks it uneven.
    #[test]
    fn a_deviating_centre_marks_its_neighbours_uneven() {
        for odd in [20.2, f32::NAN] {
            for (ox, oy) in (0..6).flat_map(|x| [-1.0, 0.0, 1.0].map(|y| (x as f32, y))) {
                let (_, uneven) = means_of(|x, y| if (x, y) == (ox, oy) { odd } else { 20.0 }, 6, 8.0);
                for (x, uneven) in uneven.iter().enumerate() {
                    let near = (x as f32 - ox).abs() <= 1.0;
                    assert!(*uneven || !near, "({ox}, {oy}) at {x}");
                }
            }
        }
    }

    /// At the rim of a disc, the formula is undefined for half of a pixel.
    #[test]
    fn undefined_samples_are_excluded() {
        let text = "name = \"half\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"c\"]\n[parameters]\nby = { start = 0.0 }\n\
                    [model]\nintensity = \"10 + sqrt(by - y) + 0*x\"\n[[stages]]\nparameters = [\"by\"]\nmethod = \"newton\"\n";
        let scene = Scene::new(&isophote_symbolic::Model::from_toml(text).unwrap().summands()[0], 8).unwrap();
        let numbers = RenderedNumbers { parameters: &[3.0], constants: &[], origin: [0.0, 0.0] };
        let mut means = [0.0; 3 * 6];
        let band = Window::whole(3, 6);
        scene.render(&numbers, band, &mut Scratch::default(), &mut means).unwrap();
        let offsets = [0.0625, 0.1875, 0.3125, 0.4375];
        let expected = 10.0 + offsets.iter().map(|x: &f32| x.sqrt()).sum::<f32>() / 4.0;
        for x in 0..3 {
            assert!((means[3 * 3 + x] - expected).abs() < 1e-4, "{means:?} for {expected}");
            assert!(means[2 * 3 + x] > expected && means[4 * 3 + x].is_nan(), "{means:?}");
        }
    }
}
