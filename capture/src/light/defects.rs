//! Applies the illumination defects of one frame to its rows.

use std::ops::Range;

use super::{Hot, Light, read};
use crate::moving::Law;

/// A separable function of x and y.
struct SeparableProfile {
    across: Vec<f32>,
    along: Vec<f32>,
}

/// Evaluated illumination defects of one frame.
pub(crate) struct LightDefects {
    defocus_px: f64,
    slope: Option<Slope>,
    /// Glare, DN.
    lobes: Vec<SeparableProfile>,
    /// Covered share of each pixel, and the occluder's light, DN.
    covers: Vec<(SeparableProfile, f32)>,
    /// Veils around blind rectangles, DN.
    veils: Vec<SeparableProfile>,
    /// Ranges of columns and of rows.
    blind: Vec<[Range<usize>; 2]>,
    hot: Vec<Hot>,
}

#[derive(Clone, Copy)]
struct Slope {
    dn_per_px: [f64; 2],
    middle: [f64; 2],
}

impl LightDefects {
    /// Evaluates `light` at time `t_s` for a frame of `size`; a message if a number is out of range.
    pub fn at(light: &Light<Law>, t_s: f64, size: [usize; 2], saturation: f64) -> Result<LightDefects, String> {
        let light = read::at(light, t_s)?;
        let slope =
            light.slope.map(|dn_per_px| Slope { dn_per_px, middle: size.map(|side| (side as f64 - 1.0) / 2.0) });
        let lobes = light.glare.iter().map(|one| SeparableProfile {
            across: lobe(one.x, one.sigma_px, size[0], one.height),
            along: lobe(one.y, one.sigma_px, size[1], 1.0),
        });
        let covers = light.occluders.iter().map(|one| {
            let across = edges(one.x, one.width);
            let along = edges(one.y, one.height);
            (SeparableProfile { across: covered(across, size[0]), along: covered(along, size[1]) }, one.value as f32)
        });
        let places = light.blind.iter().map(|one| ([edges(one.x, one.width), edges(one.y, one.height)], one.soft_px));
        let veils = places.clone().filter_map(|([across, along], soft_px)| {
            let soft_px = soft_px.filter(|px| *px > 0.0)?;
            let [across, along] =
                [veil(across, soft_px, size[0], 2.0 * saturation), veil(along, soft_px, size[1], 1.0)];
            Some(SeparableProfile { across, along })
        });
        let blind = places.map(|([across, along], _)| [inside(across, size[0]), inside(along, size[1])]);
        Ok(LightDefects {
            defocus_px: light.defocus_px.unwrap_or(0.0),
            slope,
            lobes: lobes.collect(),
            covers: covers.collect(),
            veils: veils.collect(),
            blind: blind.collect(),
            hot: light.hot,
        })
    }

    /// Standard deviation of the blur, px; 0 means none.
    pub fn defocus_px(&self) -> f64 {
        self.defocus_px
    }

    /// Applies the defects to the light of row `y`, DN.
    pub fn apply(&self, y: usize, row: &mut [f32]) {
        if let Some(Slope { dn_per_px: [along_x, along_y], middle: [mx, my] }) = self.slope {
            let first = along_y * (y as f64 - my);
            row.iter_mut().enumerate().for_each(|(x, light)| *light += (first + along_x * (x as f64 - mx)) as f32);
        }
        self.lobes.iter().for_each(|lobe| lobe.add(y, row));
        if self.slope.is_some() {
            row.iter_mut().for_each(|light| *light = light.max(0.0));
        }
        for (cover, value) in &self.covers {
            let along = cover.along[y];
            if along > 0.0 {
                row.iter_mut().zip(&cover.across).for_each(|(light, across)| {
                    let share = across * along;
                    *light = *light * (1.0 - share) + value * share;
                });
            }
        }
        self.veils.iter().for_each(|veil| veil.add(y, row));
    }

    /// Overrides the hot pixels and the blind pixels (at saturation) of row `y`.
    pub fn apply_to_pixels(&self, y: usize, row: &mut [u16], saturation: u16) {
        for hot in &self.hot {
            for (x, pixel) in row.iter_mut().enumerate() {
                if let Some(more) = hot.at(x, y) {
                    *pixel = (f64::from(*pixel) + more).round().clamp(0.0, f64::from(saturation)) as u16;
                }
            }
        }
        let here = self.blind.iter().filter(|[_, rows]| rows.contains(&y));
        here.for_each(|[columns, _]| row[columns.clone()].fill(saturation));
    }
}

impl Hot {
    /// DN added to a pixel, if it is hot.
    fn at(&self, x: usize, y: usize) -> Option<f64> {
        let first = scrambled(scrambled(self.seed.wrapping_add(x as u64)).wrapping_add(y as u64));
        let share = |number: u64| (number >> 11) as f64 * (1.0 / (1u64 << 53) as f64);
        (share(first) < self.share).then(|| self.least + (self.most - self.least) * share(scrambled(first)))
    }
}

/// SplitMix64's next number: decorrelates neighbouring inputs.
fn scrambled(number: u64) -> u64 {
    let x = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl SeparableProfile {
    fn add(&self, y: usize, row: &mut [f32]) {
        let along = self.along[y];
        if along > 0.0 {
            row.iter_mut().zip(&self.across).for_each(|(light, across)| *light += across * along);
        }
    }
}

/// The mean of `height`·exp(−(x − middle)²/2σ²) over each pixel: σ√(π/2)·(erf(b) − erf(a)) with a and b its sides over σ√2.
fn lobe(middle: Option<f64>, sigma_px: f64, side: usize, height: f64) -> Vec<f32> {
    let Some(middle) = middle else { return vec![height as f32; side] };
    let scale = height * sigma_px * (std::f64::consts::PI / 2.0).sqrt();
    let from = |i: usize| (i as f64 - 0.5 - middle) / (sigma_px * std::f64::consts::SQRT_2);
    let mean = |i: usize| {
        let (a, b) = (from(i), from(i + 1));
        // For a lobe much wider than a pixel, the difference would be only rounding errors.
        let difference = b - a;
        let between = if difference > 1e-4 {
            libm::erf(b) - libm::erf(a)
        } else {
            let centre = (a + b) / 2.0;
            2.0 / std::f64::consts::PI.sqrt() * difference * libm::exp(-centre * centre)
        };
        (scale * between) as f32
    };
    (0..side).map(mean).collect()
}

/// Outer edges of `count` pixels from `first`, px.
fn edges(first: Option<f64>, count: Option<f64>) -> [f64; 2] {
    let low = first.map_or(f64::NEG_INFINITY, |first| first - 0.5);
    [low, count.map_or(f64::INFINITY, |count| first.unwrap_or(0.0) - 0.5 + count)]
}

/// Share of each pixel between two edges.
fn covered([low, high]: [f64; 2], side: usize) -> Vec<f32> {
    let share = |i: usize| (high.min(i as f64 + 0.5) - low.max(i as f64 - 0.5)).clamp(0.0, 1.0) as f32;
    (0..side).map(share).collect()
}

/// Pixels whose centre is between two edges.
fn inside([low, high]: [f64; 2], side: usize) -> Range<usize> {
    // `as` saturates: positions left of the frame become 0.
    let first = |edge: f64| (edge.ceil() as usize).min(side);
    let (from, to) = (first(low), first(high));
    from..to.max(from)
}

/// `height`·(Φ((x − low)/σ) − Φ((x − high)/σ)) at each pixel.
fn veil([low, high]: [f64; 2], sigma_px: f64, side: usize, height: f64) -> Vec<f32> {
    let normal = |x: f64| 0.5 * libm::erfc(-x / (sigma_px * std::f64::consts::SQRT_2));
    (0..side).map(|i| (height * (normal(i as f64 - low) - normal(i as f64 - high))) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hot_pixels_are_fixed_across_frames() {
        let hot = Hot { share: 0.05, least: 40.0, most: 200.0, seed: 3 };
        let light = Light { hot: vec![hot, Hot { least: -30.0, most: -30.0, seed: 4, ..hot }], ..Light::default() };
        let frames = [0.0, 7.0].map(|t_s| {
            let defects = LightDefects::at(&light, t_s, [100, 100], 255.0).unwrap_or_else(|reason| panic!("{reason}"));
            let mut rows = vec![[20_u16; 100]; 100];
            rows.iter_mut().enumerate().for_each(|(y, row)| defects.apply_to_pixels(y, row, 255));
            rows.concat()
        });
        assert_eq!(frames[0], frames[1]);
        let more = frames[0].iter().filter(|pixel| **pixel >= 60 - 30 && **pixel != 20);
        let less = frames[0].iter().filter(|pixel| **pixel == 0).count();
        // 500 each: 5 standard deviations of 22.
        assert!((390..610).contains(&more.count()) && (390..610).contains(&less));
        assert!(frames[0].iter().all(|pixel| *pixel == 0 || *pixel == 20 || (30..=220).contains(pixel)));
        assert!(frames[0].iter().any(|pixel| *pixel > 200) && frames[0].iter().any(|pixel| (60..70).contains(pixel)));
    }
}
