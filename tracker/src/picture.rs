//! Synthetic test images in closed form, with seeded noise.

use isophote_jit::PixelFormat;

use isophote_frame::{Frame, Plane};

/// xorshift64*: enough for test noise.
pub(crate) struct Noise(pub u64);

impl Noise {
    /// From 0 to 1.
    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Mean 0, variance 1: sum of twelve uniform numbers.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// An ellipse with the thesis' cubic profile, k2 = −(3/2 + …) chosen by k1, k2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub centre: [f64; 2],
    /// Half axes, px.
    pub half: [f64; 2],
    /// Angle of the first half axis to x, rad.
    pub angle: f64,
    pub amplitude: f64,
    pub profile: Falloff,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Falloff {
    /// `1 + k1 s + k2 s² − (1 + k1 + k2) s³` for s ≤ 1.
    Cubic(f64, f64),
    /// 1 for s ≤ 1.
    Disc,
}

impl Spot {
    pub fn at(x: f64, y: f64, half: f64, amplitude: f64) -> Spot {
        Spot { centre: [x, y], half: [half, half], angle: 0.0, amplitude, profile: Falloff::Cubic(-1.5, 0.0) }
    }

    /// a1, a2, a3 of the outline.
    pub fn extent(&self) -> [f64; 3] {
        let (sin, cos) = self.angle.sin_cos();
        let (p, q) = (self.half[0].powi(-2), self.half[1].powi(-2));
        [p * cos * cos + q * sin * sin, (p - q) * sin * cos, p * sin * sin + q * cos * cos]
    }

    fn intensity(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let [a1, a2, a3] = self.extent();
        let s = a1 * dx * dx + 2.0 * a2 * dx * dy + a3 * dy * dy;
        match self.profile {
            _ if s > 1.0 => 0.0,
            Falloff::Cubic(k1, k2) => self.amplitude * (1.0 + s * (k1 + s * (k2 - s * (1.0 + k1 + k2)))),
            Falloff::Disc => self.amplitude,
        }
    }
}

/// A synthetic image.
#[derive(Clone, Debug)]
pub(crate) struct TestPicture {
    pub width: usize,
    pub height: usize,
    pub ground: f64,
    pub slope: [f64; 2],
    pub spots: Vec<Spot>,
    /// Standard deviation of a pixel.
    pub noise: f64,
    pub seed: u64,
    /// Sub-pixel samples along a side; 1 samples pixel centres, as the models do.
    pub samples: usize,
    pub saturation: f64,
}

impl TestPicture {
    pub fn new(width: usize, height: usize, spots: Vec<Spot>) -> TestPicture {
        TestPicture {
            width,
            height,
            ground: 20.0,
            slope: [0.0; 2],
            spots,
            noise: 0.0,
            seed: 1,
            samples: 1,
            saturation: 255.0,
        }
    }

    pub fn pixels(&self) -> Vec<f64> {
        let mut noise = Noise(0x9E37_79B9_7F4A_7C15 ^ self.seed);
        let mut pixels = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let ground = self.ground + self.slope[0] * x as f64 + self.slope[1] * y as f64;
                let offset = |k: usize| (k as f64 + 0.5) / self.samples as f64 - 0.5;
                let mut sum = 0.0;
                for k in 0..self.samples * self.samples {
                    let (px, py) = (x as f64 + offset(k % self.samples), y as f64 + offset(k / self.samples));
                    sum += self.spots.iter().map(|spot| spot.intensity(px, py)).sum::<f64>();
                }
                let noisy = if self.noise > 0.0 { self.noise * noise.normal() } else { 0.0 };
                pixels.push(ground + sum / (self.samples * self.samples) as f64 + noisy);
            }
        }
        pixels
    }

    /// 8 bit, clipped at `saturation`.
    pub fn frame(&self) -> Frame {
        let bytes = self.pixels().iter().map(|v| v.round().clamp(0.0, self.saturation) as u8).collect();
        let size = if self.height == 1 { vec![self.width] } else { vec![self.width, self.height] };
        Frame::new(&size, vec![Plane::owned(PixelFormat::U8, bytes, self.width)]).expect("the buffer fits")
    }
}
