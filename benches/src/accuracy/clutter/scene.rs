//! Frames full of things that are no target: shapes, texture and 1/f noise, with or without a target among them.
//!
//! The camera is that of [`crate::accuracy::search::scene`]: 8 bit, 5000 electrons at 255 DN, 15 electrons of read noise.

use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};

use crate::accuracy::search::scene::{BACKGROUND, GAIN, READ_NOISE_E, Random, over_pixel};

/// Pixels of a frame.
pub const SIZE: [usize; 2] = [640, 480];
/// Shapes in a frame.
const SHAPES: [f64; 2] = [1.0, 6.0];

/// What a frame is full of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Turned squares.
    Squares,
    /// Bars, 3 to 12 times as long as wide.
    Bars,
    /// Rings.
    Rings,
    /// Triangles.
    Triangles,
    /// White noise that was blurred.
    Texture,
    /// Noise whose power goes as 1/f², the amplitude as 1/f.
    Pink,
    /// Nothing but the camera's noise.
    Nothing,
}

impl Kind {
    /// All of them.
    pub const ALL: [Kind; 7] =
        [Kind::Squares, Kind::Bars, Kind::Rings, Kind::Triangles, Kind::Texture, Kind::Pink, Kind::Nothing];

    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Squares => "squares",
            Kind::Bars => "bars",
            Kind::Rings => "rings",
            Kind::Triangles => "triangles",
            Kind::Texture => "texture",
            Kind::Pink => "1/f noise",
            Kind::Nothing => "nothing",
        }
    }
}

/// How the edges of shapes are, and how fine texture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    /// A pixel sees the mean over its square.
    Sharp,
    /// By a Gaussian of 1 to 4 px.
    Blurred,
}

impl Edges {
    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            Edges::Sharp => "sharp",
            Edges::Blurred => "blurred",
        }
    }
}

/// Light of a frame without a target, DN.
pub fn light(kind: Kind, edges: Edges, seed: u64) -> Vec<f64> {
    let is_blurred = edges == Edges::Blurred;
    let mut random = Random::new(seed);
    let mut light = vec![0.0; SIZE[0] * SIZE[1]];
    match kind {
        Kind::Squares | Kind::Bars | Kind::Rings | Kind::Triangles => {
            for _ in 0..random.within(SHAPES[0], SHAPES[1]) as usize {
                shape(kind, &mut random, &mut light);
            }
        }
        Kind::Texture => {
            light.iter_mut().for_each(|value| *value = random.normal());
            let sigma = if is_blurred { random.within(3.0, 8.0) } else { random.within(0.7, 2.0) };
            light = blurred(&light, sigma);
            scale(&mut light, random.within(5.0, 40.0));
        }
        Kind::Pink => {
            for octave in 0..7 {
                let step = if is_blurred { 4 } else { 2 } << octave;
                lattice(step, 2.0_f64.powi(octave), &mut random, &mut light);
            }
            scale(&mut light, random.within(5.0, 40.0));
        }
        Kind::Nothing => {}
    }
    if is_blurred && !matches!(kind, Kind::Texture | Kind::Pink | Kind::Nothing) {
        light = blurred(&light, random.within(1.0, 4.0));
    }
    light.iter_mut().for_each(|value| *value += BACKGROUND);
    light
}

/// The share of its height that a target of `document` has at s.
pub fn share(document: &str, s: f64) -> f64 {
    match document {
        "gaussian" => (-2.0 * s).exp(),
        _ if s > 1.0 => 0.0,
        _ => 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s,
    }
}

/// Adds a target as `document` describes it, with these semi-axes, angle and height.
pub fn add_target(light: &mut [f64], document: &str, centre: [f64; 2], half: [f64; 2], angle: f64, height: f64) {
    let (sin, cos) = angle.sin_cos();
    for (i, value) in light.iter_mut().enumerate() {
        let (dx, dy) = ((i % SIZE[0]) as f64 - centre[0], (i / SIZE[0]) as f64 - centre[1]);
        if dx.hypot(dy) > 4.0 * half[0].max(half[1]) {
            continue;
        }
        *value += height
            * over_pixel(|x, y| {
                let (dx, dy) = (dx + x, dy + y);
                let s = ((cos * dx + sin * dy) / half[0]).powi(2) + ((cos * dy - sin * dx) / half[1]).powi(2);
                share(document, s)
            });
    }
}

/// What the camera makes of it.
pub fn frame(light: &[f64], seed: u64) -> Frame {
    let mut random = Random::new(seed ^ 0x5EED_0000_0000);
    let read = READ_NOISE_E * GAIN;
    let bytes = light.iter().map(|mean| {
        let deviation = (mean.max(0.0) * GAIN + read * read).sqrt();
        (mean + deviation * random.normal()).round().clamp(0.0, 255.0) as u8
    });
    Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes.collect(), SIZE[0])]).unwrap()
}

fn shape(kind: Kind, random: &mut Random, light: &mut [f64]) {
    let centre = [random.within(0.0, SIZE[0] as f64), random.within(0.0, SIZE[1] as f64)];
    let (sin, cos) = random.within(0.0, std::f64::consts::PI).sin_cos();
    let (half, height) = (random.within(3.0, 40.0), random.within(25.0, 300.0));
    let (aspect, hole) = (random.within(3.0, 12.0), random.within(0.3, 0.8));
    let inside = |u: f64, v: f64| match kind {
        Kind::Squares => u.abs().max(v.abs()) <= half,
        Kind::Bars => u.abs() <= half && v.abs() * aspect <= half,
        Kind::Rings => (hole * half..=half).contains(&u.hypot(v)),
        _ => v >= -0.5 * half && u.abs() * 3.0_f64.sqrt() + v <= half,
    };
    let reach = 1.5 * half + 1.0;
    let range = |axis: usize| {
        let last = SIZE[axis] as f64 - 1.0;
        (centre[axis] - reach).clamp(0.0, last) as usize..=(centre[axis] + reach).clamp(0.0, last) as usize
    };
    for y in range(1) {
        for x in range(0) {
            let covered = over_pixel(|sx, sy| {
                let (dx, dy) = (x as f64 + sx - centre[0], y as f64 + sy - centre[1]);
                f64::from(u8::from(inside(cos * dx + sin * dy, cos * dy - sin * dx)))
            });
            light[y * SIZE[0] + x] += height * covered;
        }
    }
}

/// To this standard deviation about a mean of 0.
fn scale(light: &mut [f64], deviation: f64) {
    let n = light.len() as f64;
    let mean = light.iter().sum::<f64>() / n;
    let spread = (light.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
    // The ground lies low enough under what stands out of it.
    light.iter_mut().for_each(|value| *value = (*value - mean) * deviation / spread + 2.0 * deviation);
}

/// Random numbers every `step` pixels, with straight lines between them.
fn lattice(step: usize, amplitude: f64, random: &mut Random, light: &mut [f64]) {
    let columns = SIZE[0] / step + 2;
    let nodes: Vec<f64> = (0..columns * (SIZE[1] / step + 2)).map(|_| random.normal()).collect();
    for (i, value) in light.iter_mut().enumerate() {
        let (x, y) = (i % SIZE[0], i / SIZE[0]);
        let (column, row) = (x / step, y / step);
        let (fx, fy) = ((x % step) as f64 / step as f64, (y % step) as f64 / step as f64);
        let node = |dx: usize, dy: usize| nodes[(row + dy) * columns + column + dx];
        let above = node(0, 0) * (1.0 - fx) + node(1, 0) * fx;
        let below = node(0, 1) * (1.0 - fx) + node(1, 1) * fx;
        *value += amplitude * (above * (1.0 - fy) + below * fy);
    }
}

/// With a Gaussian of `sigma` px.
fn blurred(light: &[f64], sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let [width, height] = SIZE.map(|n| n as i64);
    let pass = |from: &[f64], [dx, dy]: [i64; 2]| -> Vec<f64> {
        let at = |x: i64, y: i64| from[(y.clamp(0, height - 1) * width + x.clamp(0, width - 1)) as usize];
        let one = |i: i64| {
            let (x, y) = (i % width, i / width);
            let terms = (-reach..=reach).zip(&weights).map(|(k, weight)| weight * at(x + k * dx, y + k * dy));
            terms.sum::<f64>() / sum
        };
        (0..width * height).map(one).collect()
    };
    pass(&pass(light, [1, 0]), [0, 1])
}
