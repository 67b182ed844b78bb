//! Frames for searches: a spot of models/spot.toml at a random position in 640 × 480 px, alone or among other objects.
//!
//! The camera is that of the accuracy figures: 8 bit, 255 DN are 5000 electrons, 15 electrons of read noise,
//! background 20 DN. Shot noise is normal with Poisson's variance (400 electrons and more per pixel).

use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};

/// Pixels of a frame.
pub const SIZE: [usize; 2] = [640, 480];
/// DN.
pub const BACKGROUND: f64 = 20.0;
/// DN per electron.
pub const GAIN: f64 = 255.0 / 5000.0;
/// Electrons.
pub const READ_NOISE_E: f64 = 15.0;
/// Sub-pixel samples per side, where the edge of an object crosses a pixel.
const SAMPLES: usize = 4;

/// xorshift64*.
pub struct Random(u64);

impl Random {
    /// Seeded.
    pub fn new(seed: u64) -> Random {
        let mut random = Random(0x9E37_79B9_7F4A_7C15 ^ seed.wrapping_mul(0xD134_2543_DE82_EF95));
        for _ in 0..8 {
            random.uniform();
        }
        random
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform between two numbers.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Standard normal (Box-Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Profile of an object, in s of its ellipse (1 at the rim).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Profile {
    /// That of models/spot.toml.
    Spot,
    /// Flat, with a sharp rim.
    Disc,
    /// Dark inside.
    Ring,
    /// Falls linearly.
    Cone,
}

/// An ellipse of light.
#[derive(Clone, Copy, Debug)]
pub struct SceneObject {
    /// px.
    pub centre: [f64; 2],
    /// Semi-axes, px.
    pub half: [f64; 2],
    /// Angle of the first to x, rad.
    pub angle: f64,
    /// DN above the ground.
    pub height: f64,
    /// Profile.
    pub profile: Profile,
}

impl SceneObject {
    fn s(&self, x: f64, y: f64) -> f64 {
        let (sin, cos) = self.angle.sin_cos();
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        ((cos * dx + sin * dy) / self.half[0]).powi(2) + ((cos * dy - sin * dx) / self.half[1]).powi(2)
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        let s = self.s(x, y);
        let share = match self.profile {
            _ if s > 1.0 => 0.0,
            Profile::Spot => 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s,
            Profile::Disc => 1.0,
            Profile::Ring => f64::from(u8::from(s > 0.4)),
            Profile::Cone => 1.0 - s.sqrt(),
        };
        self.height * share
    }

    fn reach(&self) -> f64 {
        self.half[0].max(self.half[1])
    }

    /// Whether it stays clear of the other's domain.
    fn is_clear_of(&self, other: &SceneObject) -> bool {
        let apart = (self.centre[0] - other.centre[0]).hypot(self.centre[1] - other.centre[1]);
        apart > self.reach() + 1.5 * other.reach() + 4.0
    }
}

/// Description of a frame.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The target.
    pub target: Option<SceneObject>,
    /// Other objects.
    pub clutter: Vec<SceneObject>,
    /// Seed of the noise.
    pub seed: u64,
}

/// Height of a spot with a share of its area at 255 DN or more; 180 DN without saturation.
pub fn height(saturated: f64) -> f64 {
    let s = saturated;
    if s > 0.0 { (255.0 - BACKGROUND) / (1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s) } else { 180.0 }
}

impl Scene {
    /// A target of 20 × 14 px at a random position, with its domain inside the frame, and that many other objects.
    pub fn new(seed: u64, height: f64, clutter: usize) -> Scene {
        let mut random = Random::new(seed);
        let centre = [random.within(32.0, SIZE[0] as f64 - 32.0), random.within(32.0, SIZE[1] as f64 - 32.0)];
        let angle = random.within(0.0, std::f64::consts::PI);
        let target = SceneObject { centre, half: [20.0, 14.0], angle, height, profile: Profile::Spot };
        let mut scene = Scene { target: Some(target), clutter: Vec::new(), seed };
        let mut things = 0;
        while things < clutter {
            let group = distractor(&mut random, height);
            if group.iter().all(|object| object.is_clear_of(&target)) {
                scene.clutter.extend(group);
                things += 1;
            }
        }
        scene
    }

    /// The same without the target.
    pub fn without_target(mut self) -> Scene {
        self.target = None;
        self
    }

    /// Renders the frame.
    pub fn frame(&self) -> Frame {
        let mut light = vec![BACKGROUND; SIZE[0] * SIZE[1]];
        for object in self.clutter.iter().chain(&self.target) {
            render(object, &mut light);
        }
        let mut random = Random::new(self.seed ^ 0x5EED_0000_0000);
        let read = READ_NOISE_E * GAIN;
        let bytes = light.iter().map(|mean| {
            let deviation = (mean.max(0.0) * GAIN + read * read).sqrt();
            (mean + deviation * random.normal()).round().clamp(0.0, 255.0) as u8
        });
        Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes.collect(), SIZE[0])]).unwrap()
    }
}

/// A random distractor: another profile, smaller or larger; irregular; an edge; or a small, faint spot.
fn distractor(random: &mut Random, height: f64) -> Vec<SceneObject> {
    let centre = [random.within(0.0, SIZE[0] as f64), random.within(0.0, SIZE[1] as f64)];
    let angle = random.within(0.0, std::f64::consts::PI);
    let bright = random.within(25.0, 300.0);
    let object = |half: [f64; 2], profile: Profile| SceneObject { centre, half, angle, height: bright, profile };
    match (random.uniform() * 6.0) as usize {
        0 => vec![object([random.within(3.0, 45.0), random.within(3.0, 30.0)], Profile::Disc)],
        1 => vec![object([random.within(8.0, 40.0), random.within(8.0, 30.0)], Profile::Ring)],
        2 => vec![object([random.within(4.0, 40.0), random.within(4.0, 30.0)], Profile::Cone)],
        // A bar, or an edge if wide.
        3 => vec![object([random.within(60.0, 200.0), random.within(2.0, 25.0)], Profile::Disc)],
        // Three overlapping discs.
        4 => (0..3)
            .map(|_| {
                let half = [random.within(5.0, 20.0), random.within(5.0, 20.0)];
                let shift = [random.within(-12.0, 12.0), random.within(-12.0, 12.0)];
                let centre = [centre[0] + shift[0], centre[1] + shift[1]];
                SceneObject { centre, half, angle, height: bright, profile: Profile::Disc }
            })
            .collect(),
        _ => {
            let size = random.within(4.0, 11.0);
            let small = object([size, size * random.within(0.5, 1.0)], Profile::Spot);
            vec![SceneObject { height: height.min(180.0) * random.within(0.2, 0.8), ..small }]
        }
    }
}

fn render(object: &SceneObject, light: &mut [f64]) {
    let reach = object.reach() + 1.0;
    let range = |axis: usize| {
        let last = (SIZE[axis] - 1) as f64;
        let (low, high) = (object.centre[axis] - reach, object.centre[axis] + reach);
        low.clamp(0.0, last).floor() as usize..=high.clamp(0.0, last).ceil() as usize
    };
    for y in range(1) {
        for x in range(0) {
            light[y * SIZE[0] + x] += over_pixel(|dx, dy| object.at(x as f64 + dx, y as f64 + dy));
        }
    }
}

/// The mean over a pixel's square, by offsets from its centre.
pub fn over_pixel(light: impl Fn(f64, f64) -> f64) -> f64 {
    let offset = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
    let sample = |k: usize| light(offset(k % SAMPLES), offset(k / SAMPLES));
    (0..SAMPLES * SAMPLES).map(sample).sum::<f64>() / (SAMPLES * SAMPLES) as f64
}
