//! Frames with or without a target, on various backgrounds, beside various objects, with their truth.

use std::f64::consts::{PI, TAU};

use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};

use super::things::{Kind, Light};
use crate::accuracy::search::scene::{GAIN, READ_NOISE_E, Random};

/// A document under test: name, text, and profile with its extra parameter.
pub struct Document {
    /// Name in the tables.
    pub name: String,
    /// TOML text.
    pub text: String,
    /// The relative height at s, given an extra parameter drawn from `extra`.
    pub profile: fn(f64, f64) -> f64,
    /// Bounds of the extra parameter.
    pub extra: [f64; 2],
    /// The kind of object equal to its target.
    pub same: Option<Kind>,
}

/// A target.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// px.
    pub centre: [f64; 2],
    /// Semi-axes, px.
    pub half: [f64; 2],
    /// The extra parameter of the profile.
    pub extra: f64,
    /// Signal-to-noise ratio of a matched filter against the camera's noise.
    pub snr: f64,
}

/// A frame, and the truth about it.
pub struct Scene {
    /// The camera's frame.
    pub frame: Frame,
    /// Kind of the objects beside the target.
    pub kind: Kind,
    /// The target, if there is one.
    pub target: Option<Truth>,
}

/// Saturation limit, DN.
const WHITE: f64 = 255.0;
/// Share of overexposed targets and objects.
const OVEREXPOSED: f64 = 0.2;
/// Maximum height of overexposed ones, DN.
const HIGHEST: f64 = 3000.0;

/// The frame of a number, with a target of the document or without one.
pub fn scene(document: &Document, kind: Kind, seed: u64) -> Scene {
    let kind = if document.same == Some(kind) { Kind::Cross } else { kind };
    let mut random = Random::new(seed ^ 0x51C7_0000);
    let is_large = random.uniform() < 0.12;
    let (width, height, largest) = if is_large { (320, 240, 40.0) } else { (192, 144, 20.0) };
    let level = random.within(10.0, 70.0);
    let mut light = ground(width, height, level, &mut random);
    if kind == Kind::Leaves && random.uniform() < 0.6 {
        let contrast = random.within(50.0, 180.0);
        let leaves = Light::leaves(width, height, &mut random);
        light.values.iter_mut().zip(&leaves.values).for_each(|(value, leaf)| *value += contrast * leaf);
    }
    let log = |random: &mut Random, low: f64, high: f64| random.within(low.ln(), high.ln()).exp();
    let mut target = None;
    let mut image = Light::even(width, height, 0.0);
    if random.uniform() < 0.5 {
        let half = log(&mut random, 3.0, largest);
        let half = [half, (half * random.within(0.5, 1.0)).max(2.5)];
        let margin = 0.6 * half[0];
        let centre = [width, height].map(|side| random.within(margin, side as f64 - 1.0 - margin));
        let extra = random.within(document.extra[0], document.extra[1]);
        let (sin, cos) = random.within(0.0, PI).sin_cos();
        let s = |x: f64, y: f64| {
            let (dx, dy) = (x - centre[0], y - centre[1]);
            ((cos * dx + sin * dy) / half[0]).powi(2) + ((cos * dy - sin * dx) / half[1]).powi(2)
        };
        image = image.filled(|x, y| (document.profile)(s(x, y), extra));
        let noise = (level.max(1.0) * GAIN + (READ_NOISE_E * GAIN).powi(2)).sqrt();
        let norm = image.values.iter().map(|value| value * value).sum::<f64>().sqrt();
        let mut high = match random.uniform() < 0.5 {
            true => log(&mut random, 15.0, 230.0),
            false => log(&mut random, 8.0, 200.0) * noise / norm,
        };
        let is_overexposed = random.uniform() < OVEREXPOSED;
        high = if is_overexposed { log(&mut random, WHITE, HIGHEST) } else { high.min(WHITE - level) };
        // Targets deviate slightly from their documents.
        let off = random.within(0.0, 0.03) * high;
        let waves: Vec<[f64; 4]> = (0..8)
            .map(|_| {
                [random.normal(), random.within(0.0, 3.0), random.within(0.0, 4.0).floor(), random.within(0.0, TAU)]
            })
            .collect();
        let deviation = |x: f64, y: f64| {
            let s = s(x, y);
            let (radius, angle) = (s.sqrt(), (y - centre[1]).atan2(x - centre[0]));
            let wave = |[a, k, n, phase]: &[f64; 4]| a * (PI * k * radius + phase).cos() * (n * angle).cos();
            0.5 * (-s * s).exp() * waves.iter().map(wave).sum::<f64>()
        };
        let deviations = Light::even(width, height, 0.0).filled(deviation);
        let each = image.values.iter_mut().zip(&deviations.values);
        each.for_each(|(value, deviation)| *value = high * *value + off * deviation);
        target = Some(Truth { centre, half, extra, snr: high * norm / noise });
    }
    if !matches!(kind, Kind::Nothing | Kind::Leaves) {
        for _ in 0..random.within(1.0, 4.0) as usize {
            let size = log(&mut random, 3.0, largest);
            let own = if kind == Kind::Blocks { Kind::ALL[1 + random.within(0.0, 6.0) as usize] } else { kind };
            let own = if document.same == Some(own) { Kind::Cross } else { own };
            let mut place = [0.0; 2];
            for _ in 0..12 {
                place = [width, height].map(|side| random.within(0.0, side as f64 - 1.0));
                let is_far = target.is_none_or(|target| {
                    let apart = (place[0] - target.centre[0]).hypot(place[1] - target.centre[1]);
                    apart > 1.6 * (size + target.half[0])
                });
                if is_far || random.uniform() < 0.1 {
                    break;
                }
            }
            let scale = match random.uniform() < OVEREXPOSED {
                true => log(&mut random, WHITE, HIGHEST),
                false => log(&mut random, 25.0, WHITE),
            };
            light.add_thing(own, place, size, scale, &mut random);
        }
    }
    light.values.iter_mut().zip(&image.values).for_each(|(value, own)| *value += own);
    if let Some(target) = target.filter(|_| random.uniform() < 0.2) {
        // A half plane occludes part of it.
        let (sin, cos) = random.within(0.0, TAU).sin_cos();
        let (edge, dark) = (random.within(0.45, 1.0) * target.half[1], level * random.within(0.3, 1.0));
        for (pixel, value) in light.values.iter_mut().enumerate() {
            let (dx, dy) = ((pixel % width) as f64 - target.centre[0], (pixel / width) as f64 - target.centre[1]);
            if cos * dx + sin * dy > edge && dx.hypot(dy) < 1.6 * target.half[0] {
                *value = dark;
            }
        }
    }
    let noisy = |mean: &f64, random: &mut Random| {
        let mean = mean.max(0.0);
        mean + (mean * GAIN + (READ_NOISE_E * GAIN).powi(2)).sqrt() * random.normal()
    };
    light.values = light.values.iter().map(|mean| noisy(mean, &mut random)).collect();
    if kind == Kind::Blocks {
        light.values.iter_mut().for_each(|value| *value = value.round().clamp(0.0, WHITE));
        light.compress(random.within(2.0, 16.0));
    }
    let bytes = light.values.iter().map(|value| value.round().clamp(0.0, WHITE) as u8).collect();
    let frame = Frame::new(&[width, height], vec![Plane::owned(PixelFormat::U8, bytes, width)]).unwrap();
    Scene { frame, kind, target }
}

/// A constant, sloped, textured, or 1/f background.
fn ground(width: usize, height: usize, level: f64, random: &mut Random) -> Light {
    let mut light = Light::even(width, height, level);
    let deviation = random.within(2.0_f64.ln(), 20.0_f64.ln()).exp();
    match random.uniform() {
        ..0.4 => {}
        ..0.6 => {
            let (fall, (sin, cos)) = (random.within(5.0, 40.0), random.within(0.0, TAU).sin_cos());
            for (pixel, value) in light.values.iter_mut().enumerate() {
                let at = [(pixel % width) as f64 / width as f64 - 0.5, (pixel / width) as f64 / height as f64 - 0.5];
                *value += fall * (cos * at[0] + sin * at[1]);
            }
        }
        kind => {
            let sigma = (kind < 0.8).then(|| random.within(1.0, 5.0));
            let texture = Light::texture(width, height, sigma, random);
            light.values.iter_mut().zip(&texture.values).for_each(|(value, own)| *value += deviation * own);
        }
    }
    light
}
