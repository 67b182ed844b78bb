//! Sensor model: converts expected light to pixel values.
//!
//! A pixel with mean m DN collects e = m · `electrons_per_dn` photo-electrons on average. It counts Poisson(e) of them, adds
//! read noise N(0, read noise²) and its row's offset N(0, row noise²) in electrons, converts the sum to DN, multiplies it by
//! the gain, rounds it and clips it to 0…saturation; below a gain of 1 to 0…gain · saturation, the full well. With a
//! response, DN are light above black, and the response gives the values before rounding. With `electrons_per_dn` = 0 the
//! mean is only rounded and clipped.
//!
//! Poisson numbers are exact: inversion for small means, otherwise Hörmann's transformed rejection PTRS (W. Hörmann, The
//! transformed rejection method for generating Poisson random variables, Insurance: Mathematics and Economics 12, 1993).
//! Uniform background is drawn from a table of its distribution ([`Levels`]). Logarithms come from `libm`, so a seed gives
//! the same frames on every machine.

use std::sync::Arc;

use isophote_frame::Response;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

use crate::levels::Levels;

/// Means below this use inversion.
const INVERSION_BELOW: f64 = 10.0;
/// More counts than a mean below [`INVERSION_BELOW`] ever gives (the chance is under 1e-80).
const INVERSION_STEPS: u32 = 128;

/// Sensor parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sensor {
    /// Clipping limit of the pixel values, DN.
    pub saturation: f64,
    /// 0 disables noise.
    pub electrons_per_dn: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f64,
    /// Standard deviation of the offset that a row's pixels share, electrons.
    pub row_noise_e: f64,
}

/// This many consecutive equal means are background, which is then drawn from a table.
const BACKGROUND_RUN: u32 = 256;
/// Most background tables per frame (a background that slopes along y has one brightness per row).
const BACKGROUNDS_MAX: u32 = 2;

/// Reads out frames row by row.
pub(crate) struct ReadOut {
    /// Sensor at the current frame's gain.
    sensor: Sensor,
    /// Sensor at a gain of 1.
    ungained: Sensor,
    /// Response from light to pixel values, if not linear.
    response: Option<Arc<Response>>,
    random: FrameRandom,
    /// Last mean, its number of consecutive pixels, and its distribution.
    mean_dn: f32,
    run: u32,
    poisson: Poisson,
    /// Table of the frame's background, once found.
    background: Option<Levels>,
    backgrounds: u32,
    /// Table of the previous frame, usually the same. Only the current frame decides whether it is used.
    memory: Option<Levels>,
}

impl ReadOut {
    /// Starts before frame 0.
    pub fn new(sensor: Sensor, response: Option<Arc<Response>>) -> ReadOut {
        let (random, poisson) = (FrameRandom::of_frame(0, 0), Poisson::new(0.0));
        let (ungained, mean_dn) = (sensor, f32::NAN);
        ReadOut {
            sensor,
            ungained,
            response,
            random,
            mean_dn,
            run: 0,
            poisson,
            background: None,
            backgrounds: 0,
            memory: None,
        }
    }

    /// Starts a frame with random numbers of its own. At gain g, m electrons read g times as many DN: the means passed to
    /// [`ReadOut::row`] must be g times the light.
    pub fn begin(&mut self, seed: u64, frame: u64, gain: f64) {
        self.random = FrameRandom::of_frame(seed, frame);
        let sensor = self.ungained.at(gain);
        if sensor != self.sensor {
            // Tables are valid for one gain only.
            self.sensor = sensor;
            (self.background, self.memory) = (None, None);
        }
        (self.mean_dn, self.run, self.backgrounds) = (f32::NAN, 0, 0);
        self.memory = self.background.take().or(self.memory.take());
    }

    /// Reads one row. `means` are in DN; random numbers are drawn in pixel order.
    pub fn row(&mut self, means: &[f32], pixels: &mut [u16]) {
        if self.sensor.electrons_per_dn <= 0.0 {
            for (pixel, mean) in pixels.iter_mut().zip(means) {
                *pixel = self.value(f64::from(*mean));
            }
            return;
        }
        let offset_e = match self.sensor.row_noise_e {
            deviation if deviation > 0.0 => deviation * self.random.normal(),
            _ => 0.0,
        };
        for (pixel, mean) in pixels.iter_mut().zip(means) {
            *pixel = match &self.background {
                Some(background) if background.mean_dn() == *mean => background.at(self.random.uniform()),
                _ => self.counted(*mean, offset_e),
            };
        }
    }

    /// Reads one pixel by counting electrons; `offset_e` is its row's offset.
    fn counted(&mut self, mean_dn: f32, offset_e: f64) -> u16 {
        let Sensor { electrons_per_dn, read_noise_e, row_noise_e, .. } = self.sensor;
        if mean_dn == self.mean_dn {
            self.run += 1;
            // Tables do not cover row noise or a response.
            if row_noise_e == 0.0
                && self.response.is_none()
                && self.run == BACKGROUND_RUN
                && self.backgrounds < BACKGROUNDS_MAX
            {
                self.find_background(mean_dn);
            }
        } else {
            (self.mean_dn, self.run) = (mean_dn, 1);
            self.poisson = Poisson::new(f64::from(mean_dn) * electrons_per_dn);
        }
        let mut electrons = offset_e + self.poisson.sample(&mut self.random);
        if read_noise_e > 0.0 {
            electrons += read_noise_e * self.random.normal();
        }
        self.value(electrons / electrons_per_dn)
    }

    /// The pixel value of light plus noise.
    fn value(&self, dn: f64) -> u16 {
        let Some(response) = &self.response else { return self.sensor.digitised(dn) };
        // The full well limits the light, even if the response could give higher values.
        let full = response.range() * self.sensor.saturation / self.ungained.saturation;
        self.ungained.digitised(response.value(dn.min(full)))
    }

    fn find_background(&mut self, mean_dn: f32) {
        self.backgrounds += 1;
        let remembered = self.memory.take().filter(|levels| levels.mean_dn() == mean_dn);
        self.background = remembered.or_else(|| Levels::new(mean_dn, &self.sensor));
    }
}

impl Sensor {
    /// The sensor at a gain: a full well limits the value, even below the saturation in DN.
    fn at(self, gain: f64) -> Sensor {
        let saturation = self.saturation.min(gain * self.saturation);
        Sensor { saturation, electrons_per_dn: self.electrons_per_dn / gain, ..self }
    }

    /// Rounds half up and clips; NaN becomes 0.
    fn digitised(&self, dn: f64) -> u16 {
        // `as` truncates, saturates and maps NaN to 0; the value is not negative here.
        (dn + 0.5).clamp(0.0, self.saturation.floor() + 0.5) as u16
    }
}

/// Random numbers of one frame.
pub(crate) struct FrameRandom(Pcg64Mcg);

impl FrameRandom {
    /// An independent stream per (seed, frame): a frame does not depend on earlier ones.
    pub fn of_frame(seed: u64, frame: u64) -> FrameRandom {
        FrameRandom(Pcg64Mcg::seed_from_u64(scrambled(scrambled(seed) ^ frame)))
    }

    /// Uniform in [0, 1), 53 bits.
    fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// SplitMix64's finaliser: a bijection that decorrelates neighbouring seeds.
fn scrambled(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// A Poisson distribution, prepared for one mean.
#[derive(Clone, Copy, Debug)]
enum Poisson {
    Zero,
    Inversion { zero_probability: f64, mean: f64 },
    Ptrs { mean: f64, a: f64, b: f64, v_quick: f64 },
}

impl Poisson {
    /// A mean that is not positive (or NaN) gives 0.
    fn new(mean: f64) -> Poisson {
        if mean.is_nan() || mean <= 0.0 {
            Poisson::Zero
        } else if mean < INVERSION_BELOW {
            Poisson::Inversion { zero_probability: libm::exp(-mean), mean }
        } else {
            let b = 0.931 + 2.53 * mean.sqrt();
            Poisson::Ptrs { mean, a: -0.059 + 0.02483 * b, b, v_quick: 0.9277 - 3.6224 / (b - 2.0) }
        }
    }

    fn sample(&self, random: &mut FrameRandom) -> f64 {
        match *self {
            Poisson::Zero => 0.0,
            Poisson::Inversion { zero_probability, mean } => inverted(zero_probability, mean, random.uniform()),
            Poisson::Ptrs { mean, a, b, v_quick } => loop {
                // Terminates: each iteration accepts with probability above 0.7, whatever the mean.
                let (u, v) = (random.uniform() - 0.5, random.uniform());
                let us = 0.5 - u.abs();
                let k = ((2.0 * a / us + b) * u + mean + 0.43).floor();
                if us >= 0.07 && v <= v_quick {
                    return k;
                }
                if k < 0.0 || (us < 0.013 && v > us) {
                    continue;
                }
                let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
                if libm::log(v * inverse_alpha / (a / (us * us) + b)) <= poisson_logarithm(mean, k) {
                    return k;
                }
            },
        }
    }
}

/// The smallest k whose cumulative probability exceeds `u`.
fn inverted(zero_probability: f64, mean: f64, u: f64) -> f64 {
    let (mut k, mut probability, mut cumulative) = (0.0, zero_probability, zero_probability);
    for _ in 0..INVERSION_STEPS {
        if u < cumulative {
            break;
        }
        k += 1.0;
        probability *= mean / k;
        cumulative += probability;
    }
    k
}

/// ln of the probability of k ≥ 0 counts at a positive mean.
pub(crate) fn poisson_logarithm(mean: f64, k: f64) -> f64 {
    k * libm::log(mean) - mean - log_factorial(k)
}

/// ln k! for integer k ≥ 0: products up to 15, then Stirling's series (error below 1e-11).
fn log_factorial(k: f64) -> f64 {
    if k < 16.0 {
        let product: f64 = (2..=k as u32).map(f64::from).product();
        return libm::log(product);
    }
    const HALF_LOG_TWO_PI: f64 = 0.918_938_533_204_672_8;
    let r = 1.0 / (k * k);
    (k + 0.5) * libm::log(k) - k + HALF_LOG_TWO_PI + (1.0 / 12.0 - r * (1.0 / 360.0 - r / 1260.0)) / k
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_factorial_equals_lgamma() {
        for k in (0..400).map(f64::from) {
            let expected = libm::lgamma(k + 1.0);
            assert!((log_factorial(k) - expected).abs() <= 1e-12 * (1.0 + expected), "{k}");
        }
    }

    /// Pearson's χ² of 400,000 numbers, for means on both sides of the change of method. With ν bins χ² has mean ν and
    /// variance 2ν; five standard deviations are allowed.
    #[test]
    fn poisson_numbers_follow_the_distribution() {
        const N: usize = 400_000;
        for (seed, mean) in [0.05, 0.7, 3.0, 9.99, 10.0, 12.5, 40.0, 391.0, 5000.0].into_iter().enumerate() {
            let mut random = FrameRandom::of_frame(seed as u64, 0);
            let poisson = Poisson::new(mean);
            let mut counts = std::collections::BTreeMap::<u64, u64>::new();
            for _ in 0..N {
                *counts.entry(poisson.sample(&mut random) as u64).or_default() += 1;
            }
            let (mut chi_square, mut bins, mut rest, mut rest_seen) = (0.0, 0.0, N as f64, N as f64);
            for k in 0..=(mean + 20.0 * f64::sqrt(mean) + 20.0) as u64 {
                let expected = N as f64 * libm::exp(poisson_logarithm(mean, k as f64));
                if expected < 10.0 {
                    continue;
                }
                let seen = counts.get(&k).copied().unwrap_or(0) as f64;
                chi_square += (seen - expected).powi(2) / expected;
                (bins, rest, rest_seen) = (bins + 1.0, rest - expected, rest_seen - seen);
            }
            let limit = bins + 5.0 * f64::sqrt(2.0 * bins);
            assert!(chi_square < limit, "mean {mean}: chi-square {chi_square} over {bins} bins, limit {limit}");
            assert!((rest - rest_seen).abs() < 5.0 * rest.max(4.0).sqrt(), "mean {mean}: tails {rest_seen} for {rest}");
        }
    }

    #[test]
    fn read_out_rounds_and_clips_without_noise() {
        let sensor = Sensor { saturation: 253.0, electrons_per_dn: 0.0, read_noise_e: 15.0, row_noise_e: 0.0 };
        let means = [-3.0, 0.0, 0.49, 0.5, 1.5, 252.4, 252.6, 900.0, f32::NAN, f32::INFINITY];
        let mut pixels = [7; 10];
        ReadOut::new(sensor, None).row(&means, &mut pixels);
        assert_eq!(pixels, [0, 0, 0, 1, 2, 252, 253, 253, 0, 253]);
    }

    /// Light beyond the full well reads the full well times a gain below 1; above 1 saturation is the limit. Covers
    /// background (a table) and single pixels.
    #[test]
    fn below_unit_gain_the_full_well_limits_values() {
        for electrons_per_dn in [0.0, 19.6] {
            let sensor = Sensor { saturation: 200.0, electrons_per_dn, read_noise_e: 5.0, row_noise_e: 0.0 };
            let mut read_out = ReadOut::new(sensor, None);
            for (gain, end) in [(1.0, 200), (0.5, 100), (0.333, 66), (2.0, 200)] {
                read_out.begin(3, 0, gain);
                let mut pixels = vec![0; 1000];
                // Twice the full well.
                read_out.row(&vec![400.0 * gain as f32; 1000], &mut pixels);
                assert_eq!(pixels, vec![end; 1000], "gain {gain}");
                read_out.row(&[60.0 * gain as f32], &mut pixels[..1]);
                assert!(f64::from(pixels[0]).max(1.0) < 80.0 * gain, "gain {gain}: {}", pixels[0]);
            }
        }
    }

    /// Mean and variance of 1,000,000 pixels: σ²(DN) = m/g + (r/g)² + 1/12 for g electrons a DN and r electrons of read
    /// noise. Tolerances: 5 standard errors, √(σ²/N) and σ²·√(2/N).
    #[test]
    fn noise_has_the_stated_mean_and_variance() {
        const N: usize = 1_000_000;
        for (gain, read_noise_e, mean) in
            [(19.6, 15.0, 20.0), (19.6, 15.0, 150.0), (1.0, 2.0, 100.0), (0.2, 0.0, 120.0)]
        {
            let sensor = Sensor { saturation: 65_535.0, electrons_per_dn: gain, read_noise_e, row_noise_e: 0.0 };
            let mut pixels = vec![0; N];
            let mut read_out = ReadOut::new(sensor, None);
            read_out.begin(42, 7, 1.0);
            // Neighbours differ by a negligible amount, so no table is used and every pixel is counted.
            let means: Vec<f32> = (0..N).map(|i| if i % 2 == 0 { mean } else { mean * 1.000_001 }).collect();
            read_out.row(&means, &mut pixels);
            let sum: f64 = pixels.iter().map(|p| f64::from(*p)).sum();
            let average = sum / N as f64;
            let variance = pixels.iter().map(|p| (f64::from(*p) - average).powi(2)).sum::<f64>() / N as f64;
            let mut expected = f64::from(mean) / gain + (read_noise_e / gain).powi(2);
            if gain >= 1.0 {
                expected += if read_noise_e > 0.0 { 1.0 / 12.0 } else { 0.0 };
            }
            let n = N as f64;
            assert!((average - f64::from(mean)).abs() < 5.0 * (expected / n).sqrt(), "mean {average} for {mean}");
            assert!(
                (variance - expected).abs() < 5.0 * expected * (2.0 / n).sqrt(),
                "variance {variance} for {expected}"
            );
        }
    }

    /// Rows of uniform background: the row means of 5,000 rows vary as stated, and pixels within a row as without row noise.
    #[test]
    fn pixels_of_a_row_share_an_offset() {
        let sensor = Sensor { saturation: 255.0, electrons_per_dn: 20.0, read_noise_e: 15.0, row_noise_e: 40.0 };
        let mut read_out = ReadOut::new(sensor, None);
        read_out.begin(42, 7, 1.0);
        let (mut pixels, rows, n) = (vec![0; 300], 5000, 300.0);
        let [mut between, mut within] = [0.0; 2];
        for _ in 0..rows {
            read_out.row(&vec![100.0; 300], &mut pixels);
            let mean = pixels.iter().map(|p| f64::from(*p)).sum::<f64>() / n;
            between += (mean - 100.0).powi(2) / f64::from(rows);
            within += pixels.iter().map(|p| (f64::from(*p) - mean).powi(2)).sum::<f64>() / (n - 1.0) / f64::from(rows);
        }
        let pixel = 100.0 / 20.0 + (15.0f64 / 20.0).powi(2) + 1.0 / 12.0;
        assert!((within / pixel - 1.0).abs() < 0.01, "{within}");
        assert!((between / (4.0 + pixel / n) - 1.0).abs() < 0.1, "{between}"); // 5 √(2/5000)
    }

    /// Tabulated background and the same light counted by electrons have the same distribution: χ² of two samples.
    #[test]
    fn tabulated_background_has_the_counted_distribution() {
        const N: usize = 400_000;
        for (gain, read_noise_e, mean) in [(19.6, 15.0, 20.0), (19.6, 15.0, 250.0), (1.0, 0.0, 4.0), (0.3, 2.0, 90.0)] {
            let sensor = Sensor { saturation: 255.0, electrons_per_dn: gain, read_noise_e, row_noise_e: 0.0 };
            let count = |means: Vec<f32>, seed| {
                let mut read_out = ReadOut::new(sensor, None);
                read_out.begin(seed, 0, 1.0);
                let mut pixels = vec![0; N];
                read_out.row(&means, &mut pixels);
                let mut counts = vec![0.0; 256];
                pixels.iter().for_each(|pixel| counts[usize::from(*pixel)] += 1.0);
                (counts, read_out.background.is_some())
            };
            let (background, has_table) = count(vec![mean; N], 1);
            let (counted, has_none) = count((0..N).map(|i| mean * (1.0 + (i % 2) as f32 * 1e-6)).collect(), 2);
            assert!(has_table && !has_none);
            let (mut chi_square, mut bins) = (0.0, 0.0);
            for (a, b) in background.iter().zip(&counted) {
                if a + b > 20.0 {
                    chi_square += f64::powi(a - b, 2) / (a + b);
                    bins += 1.0;
                }
            }
            assert!(chi_square < bins + 5.0 * f64::sqrt(2.0 * bins), "gain {gain}: {chi_square} over {bins} bins");
        }
    }

    /// A frame does not depend on whether others were read before it.
    #[test]
    fn frames_do_not_depend_on_earlier_ones() {
        let sensor = Sensor { saturation: 255.0, electrons_per_dn: 19.6, read_noise_e: 15.0, row_noise_e: 0.0 };
        let means = vec![20.0; 2000];
        let (mut fresh, mut used) = (ReadOut::new(sensor, None), ReadOut::new(sensor, None));
        let (mut first, mut second) = (vec![0; 2000], vec![0; 2000]);
        used.begin(1, 0, 1.0);
        used.row(&means, &mut second);
        for read_out in [&mut fresh, &mut used] {
            read_out.begin(1, 1, 1.0);
        }
        fresh.row(&means, &mut first);
        used.row(&means, &mut second);
        assert_eq!(first, second);
    }

    #[test]
    fn frames_have_independent_random_streams() {
        let draw = |seed, frame| FrameRandom::of_frame(seed, frame).uniform();
        assert_eq!(draw(1, 5), draw(1, 5));
        assert_ne!(draw(1, 5), draw(1, 6));
        assert_ne!(draw(1, 5), draw(2, 5));
        assert_ne!(draw(0, 1), draw(1, 0));
    }
}
