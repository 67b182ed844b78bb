//! Tabulated distribution of the pixel values at one brightness: uniform background covers most of most frames.
//!
//! For e electrons on average, g electrons per DN and read noise r, the pixel value is at most d with probability Σ_k P(k;
//! e) Φ(((d + ½) g − k) / r). One uniform number then selects the value, four times faster than counting electrons. Values
//! beyond nine standard deviations (1e-18) are omitted.

use crate::noise::{Sensor, poisson_logarithm};

/// Most terms of the sum above that a table may cost; wider distributions are not tabulated.
const TERMS_MAX: usize = 100_000;
/// Standard deviations tabulated on either side.
const REACH: f64 = 9.0;
/// Entries of the guide, which gives the search's start in the table.
const GUIDE: usize = 256;

/// Pixel values `first`, `first + 1`, … with their cumulative probabilities.
pub(crate) struct Levels {
    mean_dn: f32,
    first: u16,
    cumulative: Vec<f64>,
    guide: [u16; GUIDE],
}

impl Levels {
    /// Tabulates a brightness; `None` if the table would cost more than it saves.
    pub fn new(mean_dn: f32, sensor: &Sensor) -> Option<Levels> {
        let gain = sensor.electrons_per_dn;
        let mean = f64::from(mean_dn).max(0.0) * gain;
        let deviation = (mean + sensor.read_noise_e.powi(2)).sqrt();
        let limit = sensor.saturation.floor();
        let level = |electrons: f64| (electrons / gain + 0.5).floor().clamp(0.0, limit);
        let (first, last) = (level(mean - REACH * deviation - gain), level(mean + REACH * deviation + gain));
        // A small mean has a long upper tail: ten counts beyond the normal approximation.
        let counts = (mean - REACH * mean.sqrt()).floor().max(0.0)..=mean + REACH * mean.sqrt() + 10.0;
        let number = (last - first) as usize + 1;
        if !mean.is_finite() || number.saturating_mul((counts.end() - counts.start()) as usize + 1) > TERMS_MAX {
            return None;
        }
        let below = |limit_e: f64, k: f64| match sensor.read_noise_e > 0.0 {
            true => 0.5 * libm::erfc((k - limit_e) / (sensor.read_noise_e * std::f64::consts::SQRT_2)),
            false => f64::from(u8::from(k < limit_e)),
        };
        let mut cumulative = vec![0.0; number];
        let mut k = *counts.start();
        while k <= *counts.end() {
            let probability =
                if mean > 0.0 { libm::exp(poisson_logarithm(mean, k)) } else { f64::from(u8::from(k == 0.0)) };
            for (i, sum) in cumulative.iter_mut().enumerate() {
                *sum += probability * below((first + i as f64 + 0.5) * gain, k);
            }
            k += 1.0;
        }
        // The last value absorbs clipping and rounding errors.
        cumulative[number - 1] = 1.0;
        let mut guide = [0; GUIDE];
        for (i, entry) in guide.iter_mut().enumerate() {
            *entry = cumulative.partition_point(|c| *c <= i as f64 / GUIDE as f64) as u16;
        }
        Some(Levels { mean_dn, first: first as u16, cumulative, guide })
    }

    /// Brightness of the table.
    pub fn mean_dn(&self) -> f32 {
        self.mean_dn
    }

    /// The value at cumulative probability `u` in [0, 1).
    pub fn at(&self, u: f64) -> u16 {
        let mut i = usize::from(self.guide[(u * GUIDE as f64) as usize]);
        // Terminates at the last entry, which is 1.
        while u >= self.cumulative[i] {
            i += 1;
        }
        self.first + i as u16
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Mean and variance of the tabulated values against m and m/g + (r/g)² + 1/12 (no rounding for g = 1 without read
    /// noise). The rounding term is exact to 1e-6 where the distribution is much wider than a DN.
    #[test]
    fn tables_have_the_moments_of_the_sensor() {
        for (gain, read_noise_e, mean, tolerance) in [
            (19.6, 15.0, 20.0, 1e-6),
            (19.6, 15.0, 150.0, 1e-9),
            (1.0, 0.0, 100.0, 1e-9),
            (1.0, 0.0, 3.0, 1e-9),
            (1.0, 4.0, 60.0, 1e-9),
        ] {
            let sensor = Sensor { saturation: 255.0, electrons_per_dn: gain, read_noise_e, row_noise_e: 0.0 };
            let levels = Levels::new(mean, &sensor).unwrap();
            let (mut before, mut average, mut square) = (0.0, 0.0, 0.0);
            for (i, cumulative) in levels.cumulative.iter().enumerate() {
                let value = f64::from(levels.first) + i as f64;
                let probability = cumulative - before;
                before = *cumulative;
                (average, square) = (average + probability * value, square + probability * value * value);
            }
            let mean = f64::from(mean);
            let rounding = if gain == 1.0 && read_noise_e == 0.0 { 0.0 } else { 1.0 / 12.0 };
            let expected = mean / gain + (read_noise_e / gain).powi(2) + rounding;
            assert!((average - mean).abs() < tolerance, "{average} for {mean}");
            assert!(
                (square - average * average - expected).abs() < 100.0 * tolerance,
                "{} for {expected}",
                square - average * average
            );
        }
    }

    #[test]
    fn clipped_light_reads_saturation_and_wide_distributions_are_not_tabulated() {
        let sensor = Sensor { saturation: 253.0, electrons_per_dn: 19.6, read_noise_e: 15.0, row_noise_e: 0.0 };
        let levels = Levels::new(300.0, &sensor).unwrap();
        assert_eq!((levels.at(0.001), levels.at(0.999_999)), (253, 253));
        let dark = Levels::new(0.0, &sensor).unwrap();
        assert_eq!((dark.at(0.0), dark.at(0.5)), (0, 0));
        assert!(dark.at(0.999_999) >= 3);
        let wide = Sensor { saturation: 65_535.0, electrons_per_dn: 0.5, read_noise_e: 15.0, row_noise_e: 0.0 };
        assert!(Levels::new(30_000.0, &wide).is_none());
        assert!(Levels::new(f32::INFINITY, &sensor).is_none());
    }
}
