//! The scene and the sensor's picture of it.

use std::sync::Arc;

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

use super::controls::Controls;

/// Number of stored random numbers; each picture uses a run of them at a different offset.
const STORE: usize = 1 << 19;
/// Saturation limit, DN.
const LIMIT: f32 = 255.0;

/// Light by pixel: the values that an exposure of 1 without noise would read, DN, unclipped.
#[derive(Clone, Debug, PartialEq)]
pub enum Scene {
    /// From 0 to 128 along each row.
    Ramp,
    /// The spot of `models/spot.toml`: `background + amplitude · f(s)`, f = 1 − 0.5 s − 0.3 s² − 0.2 s³ up to the rim s = 1.
    Spot {
        /// Column and row, px.
        centre: [f32; 2],
        /// From the centre to the rim along x and along y, px.
        half_axes: [f32; 2],
        /// At the centre above the background, DN; more than 255 saturates.
        amplitude: f32,
        /// DN.
        background: f32,
    },
    /// Pictures in a loop; dark beyond their size.
    Film {
        /// Width and height, px.
        size: [usize; 2],
        /// Pixels of all pictures, row by row.
        pixels: Vec<f32>,
    },
}

impl Scene {
    /// A film from the bytes of a file: f32, little-endian, pictures of `size` px.
    ///
    /// # Errors
    /// The bytes are not a whole number of pictures.
    pub fn film(bytes: &[u8], size: [usize; 2]) -> Result<Scene, String> {
        let pixels: Vec<f32> = bytes.as_chunks().0.iter().map(|pixel| f32::from_le_bytes(*pixel)).collect();
        let one = size[0] * size[1];
        if one == 0 || pixels.is_empty() || !bytes.len().is_multiple_of(4 * one) {
            let [width, height] = size;
            return Err(format!("{} bytes are no pictures of {width}x{height} px in f32", bytes.len()));
        }
        Ok(Scene::Film { size, pixels })
    }

    fn is_moving(&self) -> bool {
        matches!(self, Scene::Film { size, pixels } if pixels.len() > size[0] * size[1])
    }

    /// Light at a pixel of picture `number`.
    fn at(&self, number: u32, x: usize, y: usize, width: usize) -> f32 {
        match self {
            Scene::Ramp => (x * 128 / width) as f32,
            Scene::Spot { centre, half_axes, amplitude, background } => {
                let [u, v] = [(x as f32 - centre[0]) / half_axes[0], (y as f32 - centre[1]) / half_axes[1]];
                let s = u * u + v * v;
                background + if s < 1.0 { amplitude * (1.0 - s * (0.5 + s * (0.3 + s * 0.2))) } else { 0.0 }
            }
            Scene::Film { size: [w, h], pixels } if x < *w && y < *h => {
                let picture = number as usize % (pixels.len() / (w * h));
                pixels[(picture * h + y) * w + x]
            }
            Scene::Film { .. } => 0.0,
        }
    }
}

/// Noise of pixels: electrons follow the Poisson distribution (approximated by the normal distribution of the same
/// variance, accurate for many electrons), plus read noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation of a pixel without light, DN.
    pub read_dn: f32,
    /// DN per electron at gain 64; 0: no shot noise.
    pub dn_per_e: f32,
    /// Same seed, same noise.
    pub seed: u64,
}

/// Renders pictures; caches what does not change between them.
pub(super) struct Painter {
    seen: Option<(Arc<Scene>, Noise, Controls, [usize; 2])>,
    /// The picture whose means are cached.
    number: Option<u32>,
    means: Vec<f32>,
    deviations: Vec<f32>,
    random: Pcg64Mcg,
    store: Vec<f32>,
}

impl Default for Painter {
    fn default() -> Self {
        let (means, deviations, store) = (Vec::new(), Vec::new(), Vec::new());
        Painter { seen: None, number: None, means, deviations, random: Pcg64Mcg::seed_from_u64(0), store }
    }
}

impl Painter {
    /// Sets the parameters of the next picture.
    pub fn begin(&mut self, scene: &Arc<Scene>, noise: Noise, controls: Controls, size: [usize; 2]) {
        let seen = Some((scene.clone(), noise, controls, size));
        let scatter = |noise: Noise| noise.read_dn > 0.0 || noise.dn_per_e > 0.0;
        let seed = self.seen.as_ref().map(|(_, before, ..)| (before.seed, scatter(*before)));
        if scatter(noise) && seed != Some((noise.seed, true)) {
            self.random = Pcg64Mcg::seed_from_u64(noise.seed);
            let random = &mut self.random;
            self.store = (0..STORE).map(|_| StandardNormal.sample(random)).collect();
        }
        if self.seen != seen {
            (self.seen, self.number) = (seen, None);
        }
    }

    /// Renders picture `number`, one byte per pixel, with `shown` in its first four pixels if given.
    pub fn paint(&mut self, number: u32, shown: Option<u32>) -> Vec<u8> {
        let Some((scene, noise, controls, [width, height])) = self.seen.clone() else { return Vec::new() };
        if self.number.is_none_or(|before| before != number && scene.is_moving()) {
            let lift = f32::from(controls.brightness);
            let light = controls.light();
            let each = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            let lit: Vec<f32> = each.map(|(x, y)| light * scene.at(number, x, y, width)).collect();
            let deviation =
                |lit: &f32| (noise.read_dn * noise.read_dn + noise.dn_per_e * controls.gain() * lit.max(0.0)).sqrt();
            self.deviations = lit.iter().map(deviation).collect();
            self.means = lit.into_iter().map(|lit| lit + lift).collect();
            self.number = Some(number);
        }
        let place = self.random.next_u64() as usize % (STORE - self.means.len());
        let random = self.store.get(place..).unwrap_or_default().iter().copied().chain(std::iter::repeat(0.0));
        let read = self.means.iter().zip(&self.deviations).zip(random);
        // `as u8` truncates.
        let mut picture: Vec<u8> = read
            .map(|((mean, deviation), random)| (mean + deviation * random).clamp(0.0, LIMIT).round() as u8)
            .collect();
        if let Some(shown) = shown {
            picture.iter_mut().zip(shown.to_le_bytes()).for_each(|(pixel, byte)| *pixel = byte);
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const SIZE: [usize; 2] = [64, 48];
    const SPOT: Scene =
        Scene::Spot { centre: [30.0, 20.0], half_axes: [12.0, 9.0], amplitude: 600.0, background: 20.0 };

    fn painted(scene: Scene, noise: Noise, controls: Controls) -> Vec<u8> {
        let mut painter = Painter::default();
        painter.begin(&Arc::new(scene), noise, controls, SIZE);
        painter.paint(0, None)
    }

    #[test]
    fn bright_spots_saturate_in_the_middle() {
        let picture = painted(SPOT, Noise::default(), Controls::default());
        let inside =
            |i: &usize| ((i % 64) as f32 - 30.0).powi(2) / 144.0 + ((i / 64) as f32 - 20.0).powi(2) / 81.0 < 1.0;
        let spot: Vec<usize> = (0..picture.len()).filter(inside).collect();
        let share = spot.iter().filter(|i| picture[**i] == 255).count() as f64 / spot.len() as f64;
        assert!((0.6..0.8).contains(&share), "{share}");
        assert_eq!((picture[20 * 64 + 30], picture[0], picture[20 * 64 + 43]), (255, 20, 20));
    }

    #[test]
    fn noise_has_its_deviation_and_is_reproducible() {
        let flat = Scene::Film { size: SIZE, pixels: vec![100.0; 64 * 48] };
        let noise = Noise { read_dn: 3.0, dn_per_e: 0.16, seed: 7 };
        let picture = painted(flat.clone(), noise, Controls::default());
        let n = picture.len() as f64;
        let mean = picture.iter().map(|pixel| f64::from(*pixel)).sum::<f64>() / n;
        let variance = picture.iter().map(|pixel| (f64::from(*pixel) - mean).powi(2)).sum::<f64>() / n;
        // 3² + 0.16 · 100, plus 1/12 for rounding; 3072 pixels determine the deviation to 1.3 %.
        assert!(
            (mean - 100.0).abs() < 0.4 && (variance.sqrt() / 25.08f64.sqrt() - 1.0).abs() < 0.06,
            "{mean} {variance}"
        );
        assert_eq!(picture, painted(flat.clone(), noise, Controls::default()));
        assert_ne!(picture, painted(flat, Noise { seed: 8, ..noise }, Controls::default()));
    }

    #[test]
    fn films_loop_and_show_numbers() {
        let bytes: Vec<u8> = [1.0f32, 2.0, 3.0, 4.0].iter().flat_map(|pixel| pixel.to_le_bytes()).collect();
        let film = Arc::new(Scene::film(&bytes, [2, 1]).unwrap());
        assert!(Scene::film(&bytes[1..], [2, 1]).is_err() && Scene::film(&[], [2, 1]).is_err());
        let mut painter = Painter::default();
        let mut paint = |number, shown| {
            painter.begin(&film, Noise::default(), Controls::default(), [4, 2]);
            painter.paint(number, shown)
        };
        assert_eq!(paint(0, None), [1, 2, 0, 0, 0, 0, 0, 0]);
        assert_eq!(paint(3, None), [3, 4, 0, 0, 0, 0, 0, 0]);
        assert_eq!(paint(4, Some(258)), [2, 1, 0, 0, 0, 0, 0, 0]);
    }
}
