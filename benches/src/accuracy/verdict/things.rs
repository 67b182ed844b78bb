//! Objects other than targets, of kinds that share various features with one, as light between 0 and 1.

use std::f64::consts::{PI, TAU};

use crate::accuracy::search::scene::Random;

/// Kind of object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Kind {
    Nothing,
    Square,
    Bar,
    Disc,
    Ring,
    Triangle,
    Bump,
    Cross,
    Crescent,
    Strokes,
    Checker,
    Streak,
    Arcs,
    Double,
    Leaves,
    Blocks,
}

impl Kind {
    /// All of them.
    pub const ALL: [Kind; 16] = [
        Kind::Nothing,
        Kind::Square,
        Kind::Bar,
        Kind::Disc,
        Kind::Ring,
        Kind::Triangle,
        Kind::Bump,
        Kind::Cross,
        Kind::Crescent,
        Kind::Strokes,
        Kind::Checker,
        Kind::Streak,
        Kind::Arcs,
        Kind::Double,
        Kind::Leaves,
        Kind::Blocks,
    ];

    /// Name in the tables.
    pub fn name(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

/// Light by pixel, row by row.
pub struct Light {
    /// Pixels along x.
    pub width: usize,
    /// Pixels along y.
    pub height: usize,
    /// DN.
    pub values: Vec<f64>,
}

/// Sub-pixel samples per side.
const SAMPLES: usize = 3;

/// An object of size 1: its value at (u, v).
type Shape = Box<dyn Fn(f64, f64) -> f64>;

impl Light {
    /// The same value everywhere.
    pub fn even(width: usize, height: usize, value: f64) -> Light {
        Light { width, height, values: vec![value; width * height] }
    }

    /// Adds a rotated shape of that size at a centre, times `scale`, blurred by a Gaussian of `sigma` px.
    pub fn add(&mut self, shape: &Shape, centre: [f64; 2], size: f64, angle: f64, scale: f64, sigma: f64) {
        let (sin, cos) = angle.sin_cos();
        let own = Light::even(self.width, self.height, 0.0);
        let mut own = own.filled(|x, y| {
            let (dx, dy) = ((x - centre[0]) / size, (y - centre[1]) / size);
            let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
            if u.hypot(v) < 3.5 { shape(u, v) } else { 0.0 }
        });
        if sigma > 0.05 {
            own.blur(sigma);
        }
        self.values.iter_mut().zip(&own.values).for_each(|(value, own)| *value += scale * own);
    }

    /// Fills with the mean of `value` over each pixel's square.
    pub fn filled(mut self, value: impl Fn(f64, f64) -> f64) -> Light {
        let offset = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
        for (pixel, own) in self.values.iter_mut().enumerate() {
            let (x, y) = ((pixel % self.width) as f64, (pixel / self.width) as f64);
            let samples = (0..SAMPLES * SAMPLES).map(|i| value(x + offset(i % SAMPLES), y + offset(i / SAMPLES)));
            *own = samples.sum::<f64>() / (SAMPLES * SAMPLES) as f64;
        }
        self
    }

    /// Blurs by a Gaussian, replicating the border.
    pub fn blur(&mut self, sigma: f64) {
        let reach = (3.0 * sigma).ceil() as i64;
        let weight = |i: i64| (-0.5 * (i as f64 / sigma).powi(2)).exp();
        let sum: f64 = (-reach..=reach).map(weight).sum();
        for [step, length, rows, next] in
            [[1, self.width, self.height, self.width], [self.width, self.height, self.width, 1]]
        {
            let before = self.values.clone();
            for (row, at) in (0..rows).flat_map(|row| (0..length).map(move |at| (row, at))) {
                let value = |i: i64| before[row * next + (at as i64 + i).clamp(0, length as i64 - 1) as usize * step];
                self.values[row * next + at * step] = (-reach..=reach).map(|i| weight(i) * value(i)).sum::<f64>() / sum;
            }
        }
    }

    /// Noise of mean 0 and unit variance, smoothed to a scale of `sigma` px, or 1/f without one.
    pub fn texture(width: usize, height: usize, sigma: Option<f64>, random: &mut Random) -> Light {
        let mut sum = Light::even(width, height, 0.0);
        let sigmas = sigma.map_or_else(|| (0..5).map(|octave| f64::from(1 << octave)).collect(), |sigma| vec![sigma]);
        for sigma in sigmas {
            let mut own = Light::even(width, height, 0.0);
            own.values.iter_mut().for_each(|value| *value = random.normal());
            own.blur(sigma);
            own.standardise();
            sum.values.iter_mut().zip(&own.values).for_each(|(value, own)| *value += own);
        }
        sum.standardise();
        sum
    }

    /// Scales to mean 0 and variance 1.
    pub fn standardise(&mut self) {
        let n = self.values.len() as f64;
        let mean = self.values.iter().sum::<f64>() / n;
        let deviation = (self.values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
        self.values.iter_mut().for_each(|value| *value = (*value - mean) / deviation.max(1e-9));
    }

    /// Adds an object of a kind.
    pub fn add_thing(&mut self, kind: Kind, centre: [f64; 2], size: f64, scale: f64, random: &mut Random) {
        let angle = random.within(0.0, TAU);
        let sigma = if random.uniform() < 0.5 { 0.0 } else { random.within(1.0, 4.0) };
        self.add(&shape(kind, random), centre, size, angle, scale, sigma);
    }

    /// Overlapping discs and squares of all sizes and grey levels, as in photographs ("dead leaves").
    pub fn leaves(width: usize, height: usize, random: &mut Random) -> Light {
        let mut light = Light::even(width, height, 0.0);
        for _ in 0..400 {
            let centre = [random.within(0.0, width as f64), random.within(0.0, height as f64)];
            // Sizes as 1/r³, as in nature.
            let size = (random.within(40.0_f64.powi(-2), 2.0_f64.powi(-2))).powf(-0.5);
            let (grey, square, slope) = (random.uniform(), random.uniform() < 0.4, random.within(-0.3, 0.3));
            let (sin, cos) = random.within(0.0, TAU).sin_cos();
            for (pixel, value) in light.values.iter_mut().enumerate() {
                let (dx, dy) = ((pixel % width) as f64 - centre[0], (pixel / width) as f64 - centre[1]);
                let (u, v) = ((cos * dx + sin * dy) / size, (cos * dy - sin * dx) / size);
                let is_inside = if square { u.abs().max(v.abs()) < 1.0 } else { u.hypot(v) < 1.0 };
                if is_inside {
                    *value = grey + slope * u;
                }
            }
        }
        light.blur(random.within(0.5, 1.2));
        light
    }

    /// Simulates compression in blocks of 8 × 8 px: quantises cosine coefficients with a step that grows with
    /// frequency.
    pub fn compress(&mut self, step: f64) {
        let basis = |k: usize, i: usize| {
            let norm = if k == 0 { 0.125_f64.sqrt() } else { 0.5 };
            norm * (PI * (i as f64 + 0.5) * k as f64 / 8.0).cos()
        };
        let table: Vec<f64> = (0..64).map(|at| basis(at / 8, at % 8)).collect();
        for (row, column) in (0..self.height / 8).flat_map(|row| (0..self.width / 8).map(move |column| (row, column))) {
            let at = |i: usize, j: usize| (8 * row + i) * self.width + 8 * column + j;
            let mut coefficients = [0.0; 64];
            for (k, l) in (0..8).flat_map(|k| (0..8).map(move |l| (k, l))) {
                let sum: f64 =
                    (0..64).map(|p| table[8 * k + p / 8] * table[8 * l + p % 8] * self.values[at(p / 8, p % 8)]).sum();
                let own = step * (1.0 + 0.8 * (k + l) as f64);
                coefficients[8 * k + l] = (sum / own).round() * own;
            }
            for (i, j) in (0..8).flat_map(|i| (0..8).map(move |j| (i, j))) {
                self.values[at(i, j)] =
                    (0..64).map(|q| table[8 * (q / 8) + i] * table[8 * (q % 8) + j] * coefficients[q]).sum();
            }
        }
    }
}

fn within(value: f64, low: f64, high: f64) -> f64 {
    f64::from(u8::from(value >= low && value <= high))
}

/// A shape of a kind, of size 1.
fn shape(kind: Kind, random: &mut Random) -> Shape {
    let mut uniform = |low: f64, high: f64| random.within(low, high);
    match kind {
        Kind::Square => {
            let aspect = uniform(0.7, 1.0);
            Box::new(move |u, v| within(u.abs(), 0.0, 1.0) * within(v.abs(), 0.0, aspect))
        }
        Kind::Bar => {
            let aspect = uniform(0.1, 0.4);
            Box::new(move |u, v| within(u.abs(), 0.0, 1.5) * within(v.abs(), 0.0, aspect))
        }
        Kind::Disc => Box::new(|u, v| within(u.hypot(v), 0.0, 1.0)),
        Kind::Ring => {
            let hole = uniform(0.4, 0.8);
            Box::new(move |u, v| within(u.hypot(v), hole, 1.0))
        }
        Kind::Triangle => {
            let lean = uniform(-0.3, 0.3);
            Box::new(move |u, v| within(v, -0.5, 1.0) * within(3.0_f64.sqrt() * (u - lean * v).abs() + v, -9.0, 1.0))
        }
        Kind::Bump | Kind::Double => {
            let count = if kind == Kind::Double { 2 } else { uniform(2.0, 6.0) as usize };
            let spread = if kind == Kind::Double { 0.8 } else { 0.5 };
            let parts: Vec<[f64; 4]> = (0..count)
                .map(|_| [uniform(-spread, spread), uniform(-spread, spread), uniform(0.2, 0.6), uniform(0.3, 1.0)])
                .collect();
            Box::new(move |u, v| {
                let part = |[x, y, s, k]: &[f64; 4]| k * (-0.5 * ((u - x).powi(2) + (v - y).powi(2)) / (s * s)).exp();
                parts.iter().map(part).sum()
            })
        }
        Kind::Cross => {
            let width = uniform(0.15, 0.4);
            Box::new(move |u, v| within(u.abs().min(v.abs()), 0.0, width) * within(u.abs().max(v.abs()), 0.0, 1.0))
        }
        Kind::Crescent => {
            let shift = uniform(0.3, 0.8);
            Box::new(move |u, v| within(u.hypot(v), 0.0, 1.0) * (1.0 - within((u - shift).hypot(v), 0.0, 1.0)))
        }
        Kind::Strokes => {
            let width = uniform(0.08, 0.25);
            let points: Vec<[f64; 2]> =
                (0..uniform(3.0, 6.0) as usize).map(|_| [uniform(-1.0, 1.0), uniform(-1.0, 1.0)]).collect();
            Box::new(move |u, v| {
                let near = points.windows(2).any(|two| {
                    let [x, y] = [two[1][0] - two[0][0], two[1][1] - two[0][1]];
                    let along = (((u - two[0][0]) * x + (v - two[0][1]) * y) / (x * x + y * y)).clamp(0.0, 1.0);
                    (u - two[0][0] - along * x).hypot(v - two[0][1] - along * y) < width
                });
                f64::from(u8::from(near))
            })
        }
        Kind::Checker => {
            let count = uniform(2.0, 5.0).floor();
            Box::new(move |u, v| {
                let cell = |at: f64| ((at + 1.0) * 0.5 * count).floor();
                let is_odd = (cell(u) + cell(v)).rem_euclid(2.0) > 0.5;
                within(u.abs().max(v.abs()), 0.0, 1.0) * f64::from(u8::from(is_odd))
            })
        }
        Kind::Streak => {
            let width = uniform(0.1, 0.5);
            Box::new(move |u, v| {
                let beyond = (u.abs() - 1.0).max(0.0);
                (-0.5 * (beyond * beyond + v * v) / (width * width)).exp()
            })
        }
        Kind::Arcs => {
            let (hole, gap, parts) = (uniform(0.3, 0.7), uniform(0.3, 1.2), uniform(1.0, 4.0).floor());
            Box::new(move |u, v| {
                let angle = v.atan2(u).rem_euclid(TAU / parts);
                within(u.hypot(v), hole, 1.0) * within(angle, gap, TAU)
            })
        }
        Kind::Nothing | Kind::Leaves | Kind::Blocks => Box::new(|_, _| 0.0),
    }
}
