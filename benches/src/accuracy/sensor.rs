//! The camera: linear, 8 bits, 255 DN = 5000 electrons, 15 electrons of read noise, clipped at 255.

use isophote_jit::PixelFormat;
use isophote_tracker::{Camera, Frame, Plane};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// Saturation limit, DN.
pub const FULL: f64 = 255.0;
/// DN per electron.
pub const GAIN: f64 = FULL / 5000.0;
/// Read noise, electrons.
pub const READ_E: f64 = 15.0;

/// Variance of an unclipped pixel, DN², rounding included.
pub fn variance(mean: f64) -> f64 {
    mean.max(0.0) * GAIN + (READ_E * GAIN).powi(2) + 1.0 / 12.0
}

/// A linear camera of some bit depth; light is given in DN of 255 levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Name in the tables.
    pub name: &'static str,
    /// Saturation limit in its own levels.
    pub levels: f64,
    /// Electrons at that value.
    pub full_e: f64,
    /// Read noise, electrons.
    pub read_e: f64,
}

/// The camera of the other benches, and a better one.
pub const SENSORS: [Sensor; 2] = [
    Sensor { name: "8 bit, 5,000 electrons", levels: FULL, full_e: 5_000.0, read_e: READ_E },
    Sensor { name: "16 bit, 60,000 electrons", levels: 65_535.0, full_e: 60_000.0, read_e: 10.0 },
];

impl Sensor {
    /// Own levels per level of 255.
    pub fn scale(&self) -> f64 {
        self.levels / FULL
    }

    /// Own levels per electron.
    pub fn gain(&self) -> f64 {
        self.levels / self.full_e
    }

    /// Variance in DN of 255 levels.
    pub fn variance(&self, light: f64) -> f64 {
        let dn = light.max(0.0) * self.scale();
        (dn * self.gain() + (self.read_e * self.gain()).powi(2) + 1.0 / 12.0) / self.scale().powi(2)
    }

    /// Pixel values of this light, in own levels.
    pub fn values(&self, light: &[f64], random: &mut Random) -> Vec<u16> {
        let pixel = |light: &f64| {
            let mean_e = light / FULL * self.full_e;
            let electrons = mean_e + (mean_e + self.read_e * self.read_e).sqrt() * random.normal();
            (electrons * self.gain()).round_ties_even().clamp(0.0, self.levels) as u16
        };
        light.iter().map(pixel).collect()
    }

    /// A frame of these values, `side` per row.
    pub fn frame(&self, values: &[u16], side: usize) -> Frame {
        let plane = match self.levels > FULL {
            true => {
                let bytes = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
                Plane::owned(PixelFormat::U16, bytes, side)
            }
            false => Plane::owned(PixelFormat::U8, values.iter().map(|&value| value as u8).collect(), side),
        };
        Frame::new(&[side, side], vec![plane]).unwrap()
    }

    /// The camera document.
    pub fn camera(&self) -> Camera {
        Camera {
            saturation: Some(self.levels),
            electrons_per_dn: Some(1.0 / self.gain()),
            read_noise_e: Some(self.read_e),
            ..Camera::default()
        }
    }
}

/// The random numbers of one frame: a separate stream per name and number.
pub struct Random(Pcg64Mcg);

impl Random {
    /// The stream of frame `number` of `name`.
    pub fn of(name: &str, number: usize) -> Random {
        // FNV-1a of the name, then the finaliser of SplitMix64, so that neighbours are uncorrelated.
        let fold = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325, fold).wrapping_add(number as u64);
        let x = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Random(Pcg64Mcg::seed_from_u64(x ^ (x >> 31)))
    }

    /// Uniform between the two.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// A sample of a distribution.
    pub fn draw(&mut self, distribution: &impl Distribution<f64>) -> f64 {
        distribution.sample(&mut self.0)
    }

    /// Pixel values of this light (DN, unclipped).
    pub fn exposed(&mut self, light: &[f64]) -> Vec<u8> {
        light.iter().map(|&mean| self.pixel(mean, 0.0)).collect()
    }

    /// The same, with a random offset of this deviation, DN, on each row of `width` pixels.
    pub fn exposed_by_rows(&mut self, light: &[f64], width: usize, row_noise: f64) -> Vec<u8> {
        let mut pixels = Vec::with_capacity(light.len());
        for row in light.chunks(width) {
            let offset = row_noise * self.normal();
            pixels.extend(row.iter().map(|&mean| self.pixel(mean, offset)));
        }
        pixels
    }

    fn pixel(&mut self, mean: f64, offset: f64) -> u8 {
        let photons = Poisson::new(mean / GAIN).map_or(0.0, |poisson| poisson.sample(&mut self.0));
        let electrons = photons + READ_E * self.normal();
        (electrons * GAIN + offset).round_ties_even().clamp(0.0, FULL) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 200,000 pixels; five standard errors. Omitting the rounding would show: 1/12 is 17 errors.
    #[test]
    fn noise_has_the_variance_of_the_bound() {
        let n = 200_000;
        for mean in [8.0, 20.0, 150.0] {
            let pixels = Random::of("variance", 0).exposed(&vec![mean; n]);
            let average = pixels.iter().map(|&p| f64::from(p)).sum::<f64>() / n as f64;
            let seen = pixels.iter().map(|&p| (f64::from(p) - average).powi(2)).sum::<f64>() / n as f64;
            let expected = variance(mean);
            assert!((average - mean).abs() < 5.0 * (expected / n as f64).sqrt(), "{average} for {mean}");
            let error = 5.0 * expected * (2.0 / n as f64).sqrt();
            assert!((seen - expected).abs() < error, "{seen} for {expected}");
            assert!(mean > 100.0 || (seen - (expected - 1.0 / 12.0)).abs() > error, "rounding is not noticed");
        }
    }

    #[test]
    fn frames_have_separate_random_streams() {
        let draw = |name, number| Random::of(name, number).uniform(0.0, 1.0);
        assert_eq!(draw("S0", 5), draw("S0", 5));
        assert_ne!(draw("S0", 5), draw("S0", 6));
        assert_ne!(draw("S0", 5), draw("S30", 5));
    }
}
