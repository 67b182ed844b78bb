//! The scene: target, pinhole lens, noisy camera, and frames.
//!
//! f = 600 px, 640 × 480 pixels of 8 bit, 255 DN are 5000 electrons, 15 electrons of read noise, background 20; the
//! profile is `(1 − s)² (1 + s/2)`, each pixel the mean of 8 × 8 samples.

use isophote_jit::PixelFormat;
use isophote_tracker::geometry::Rigid;
use isophote_tracker::{Camera, Distortion, Frame, Intrinsics, Plane, Target, TargetSpot};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

pub const WIDTH: usize = 640;
pub const HEIGHT: usize = 480;
pub const RADIUS_MM: f64 = 30.0;
pub const BACKGROUND: f64 = 20.0;
pub const LIMIT: f64 = 255.0;
const ELECTRONS_PER_DN: f64 = 5000.0 / 255.0;
const READ_NOISE_E: f64 = 15.0;
const FOCAL_PX: f64 = 600.0;
const NAMES: [&str; 3] = ["red", "green", "blue"];

/// The camera document for the tracker.
pub fn camera() -> Camera {
    Camera {
        saturation: Some(LIMIT),
        black: 0.0,
        electrons_per_dn: Some(ELECTRONS_PER_DN),
        read_noise_e: Some(READ_NOISE_E),
        row_noise_e: None,
        defects: None,
        defect_map: None,
        response: None,
        intrinsics: Some(lens()),
    }
}

/// The lens.
pub fn lens() -> Intrinsics {
    Intrinsics {
        width: WIDTH as u32,
        height: HEIGHT as u32,
        fx: FOCAL_PX,
        fy: FOCAL_PX,
        cx: 319.5,
        cy: 239.5,
        model: Distortion::None,
        coefficients: Vec::new(),
        covariance: None,
    }
}

/// The triangle of the notes; `raised_mm` raises the red spot towards the camera.
pub fn target(raised_mm: f64) -> Target {
    let at = [[0.0, 80.0, -raised_mm], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]];
    let spot = |(name, position_mm): (&&str, [f64; 3])| TargetSpot {
        name: (*name).to_string(),
        position_mm,
        radius_mm: RADIUS_MM,
    };
    Target { name: "triangle".into(), spots: NAMES.iter().zip(at).map(spot).collect(), mixing: None }
}

/// The variance of a pixel with that mean.
pub fn variance(mean: f64) -> f64 {
    mean.max(0.0) / ELECTRONS_PER_DN + (READ_NOISE_E / ELECTRONS_PER_DN).powi(2) + 1.0 / 12.0
}

/// Profile of a spot: `1 + k1 s + k2 s² − (1 + k1 + k2) s³`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rim {
    pub k1: f64,
    pub k2: f64,
}

/// Zero slope at the rim: `(1 − s)² (1 + s/2)`.
pub const SOFT: Rim = Rim { k1: -1.5, k2: 0.0 };
/// The thesis' profile, with a kink at the rim.
pub const SHARP: Rim = Rim { k1: -0.5, k2: -0.3 };
/// Flat top, with a kink nearly twice as steep: `1 − s³`.
pub const STEEP: Rim = Rim { k1: 0.0, k2: 0.0 };

impl Rim {
    /// f(s).
    pub fn at(self, s: f64) -> f64 {
        let Rim { k1, k2 } = self;
        if s < 1.0 { 1.0 + s * (k1 + s * (k2 - (1.0 + k1 + k2) * s)) } else { 0.0 }
    }

    /// The brightness that saturates this share of a spot's area; 200 for none.
    pub fn brightness(self, saturated: f64) -> f64 {
        if saturated > 0.0 { (LIMIT - BACKGROUND) / self.at(saturated) } else { 200.0 }
    }
}

/// Seeded random numbers.
pub struct Random(Pcg64Mcg);

impl Random {
    /// The stream of a frame.
    pub fn of(seed: u64) -> Random {
        Random(Pcg64Mcg::seed_from_u64(seed))
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// The noisy value of a pixel.
    pub fn read_out(&mut self, mean: f64) -> u8 {
        let electrons: f64 = Poisson::new(mean * ELECTRONS_PER_DN).unwrap().sample(&mut self.0);
        let noise: f64 = StandardNormal.sample(&mut self.0);
        ((electrons + READ_NOISE_E * noise) / ELECTRONS_PER_DN).round().clamp(0.0, LIMIT) as u8
    }
}

/// Tilted by that many degrees towards a random side, spun at random, slightly off the axis.
pub fn random_pose(random: &mut Random, distance_mm: f64, tilt_degrees: (f64, f64)) -> Rigid {
    let tilt = random.between(tilt_degrees.0, tilt_degrees.1).to_radians();
    let side = random.between(0.0, std::f64::consts::TAU);
    let spin = random.between(-std::f64::consts::PI, std::f64::consts::PI);
    let tilted = Rotation3::new(Vector3::new(side.cos(), side.sin(), 0.0) * tilt);
    let rotation = tilted * Rotation3::from_axis_angle(&Vector3::z_axis(), spin);
    let (x, y) = (random.between(-0.1, 0.1), random.between(-0.06, 0.06));
    Rigid { rotation: rotation.into_inner(), translation: Vector3::new(x, y, 1.0) * distance_mm }
}

/// The part of the picture with a rendered spot, row by row.
#[derive(Clone)]
pub struct Patch {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
    /// Mean of f(s) over each pixel.
    pub shares: Vec<f64>,
}

/// Bounds of the spot, with a margin of 3 px and 35 %; `None` if they leave the picture.
pub fn place(pose: &Rigid, spot: &TargetSpot) -> Option<[usize; 4]> {
    let [x, y, w, h] = isophote_tracker::geometry::bounds(&lens(), pose, spot)?;
    let (w, h) = (1.35 * w + 3.0, 1.35 * h + 3.0);
    let inside = x - w >= 0.0 && y - h >= 0.0 && x + w < WIDTH as f64 - 1.0 && y + h < HEIGHT as f64 - 1.0;
    inside.then(|| [(x - w) as usize, (y - h) as usize, (2.0 * w) as usize + 1, (2.0 * h) as usize + 1])
}

/// Those bounds clipped to the picture; `None` if empty.
pub fn place_inside(pose: &Rigid, spot: &TargetSpot) -> Option<[usize; 4]> {
    let [x, y, w, h] = isophote_tracker::geometry::bounds(&lens(), pose, spot)?;
    let span = |at: f64, half: f64, size: usize| {
        let (low, high) = ((at - half).max(0.0), (at + half).min(size as f64 - 1.0));
        (low < high).then(|| [low as usize, high as usize - low as usize + 1])
    };
    let [left, width] = span(x, 1.35 * w + 3.0, WIDTH)?;
    let [top, height] = span(y, 1.35 * h + 3.0, HEIGHT)?;
    Some([left, top, width, height])
}

/// f(s) within these bounds, with `samples`² samples per pixel.
pub fn patch(pose: &Rigid, spot: &TargetSpot, rim: Rim, [x, y, width, height]: [usize; 4], samples: usize) -> Patch {
    let k = Matrix3::new(FOCAL_PX, 0.0, 319.5, 0.0, FOCAL_PX, 239.5, 0.0, 0.0, 1.0);
    let centre = pose.apply(Vector3::from(spot.position_mm));
    let (u, v) = (pose.rotation.column(0), pose.rotation.column(1));
    let back = (k * Matrix3::from_columns(&[u.into(), v.into(), centre])).try_inverse().unwrap();
    let offset = |i: usize| (i as f64 + 0.5) / samples as f64 - 0.5;
    let share = |pixel: usize| {
        let (px, py) = ((x + pixel % width) as f64, (y + pixel / width) as f64);
        let mut sum = 0.0;
        for i in 0..samples * samples {
            let p = back * Vector3::new(px + offset(i % samples), py + offset(i / samples), 1.0);
            let s = (p.x * p.x + p.y * p.y) / (p.z * RADIUS_MM).powi(2);
            sum += rim.at(s);
        }
        sum / (samples * samples) as f64
    };
    Patch { x, y, width, height, shares: (0..width * height).map(share).collect() }
}

/// An 8-bit frame with these spots; `None` if one is not completely in it.
pub fn frame(pose: &Rigid, spots: &[TargetSpot], brightness: f64, random: &mut Random) -> Option<Frame> {
    Some(read_out(&means(pose, spots, brightness)?, random))
}

/// Its noise-free pixel values; `None` if a spot is not completely in it.
pub fn means(pose: &Rigid, spots: &[TargetSpot], brightness: f64) -> Option<Vec<f64>> {
    let mut means = vec![BACKGROUND; WIDTH * HEIGHT];
    for spot in spots {
        let patch = patch(pose, spot, SOFT, place(pose, spot)?, 8);
        for (i, share) in patch.shares.iter().enumerate() {
            means[(patch.y + i / patch.width) * WIDTH + patch.x + i % patch.width] += brightness * share;
        }
    }
    Some(means)
}

/// A frame with the camera's noise.
pub fn read_out(means: &[f64], random: &mut Random) -> Frame {
    let bytes = means.iter().map(|mean| random.read_out(*mean)).collect();
    Frame::new(&[WIDTH, HEIGHT], vec![Plane::owned(PixelFormat::U8, bytes, WIDTH)]).unwrap()
}

/// The brightness that saturates this share of a soft spot's area; 200 for none.
pub fn brightness(saturated: f64) -> f64 {
    SOFT.brightness(saturated)
}
