//! A scene: one drawing of a condition, its light, and the visible part of it.

use super::condition::{Companion, Condition, Glare};
use super::document::semi_axes;
use super::light::{SAMPLES, Spot, blurred, profile, shape};
use super::sensor::{FULL, Random};

/// Value of an occluder, DN.
const OCCLUDER: f64 = 5.0;
/// Height of the veil, DN; its edge is the integral of a Gaussian of `VEIL_EDGE_PX`, whose middle lies
/// `VEIL_BEHIND_PX` behind.
const VEIL: f64 = 600.0;
const VEIL_EDGE_PX: f64 = 4.0;
const VEIL_BEHIND_PX: f64 = 8.0;
/// Height of the plane of glare above the background, DN.
const PLANE_OVER: f64 = 40.0;
/// Samples along a side of a pixel at the occluder's edge.
const EDGE_SAMPLES: usize = 8;

/// An occluder or veil before the spot.
#[derive(Clone, Copy, Debug)]
enum Cover {
    /// All positions with n·position > limit.
    HalfPlane { normal: [f64; 2], limit: f64 },
    /// All positions within the radius of the centre.
    Disc { centre: [f64; 2], radius: f64 },
}

/// One drawing of a condition.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The condition drawn.
    pub condition: Condition,
    /// px
    pub centre: [f64; 2],
    /// A, px⁻²: xx, xy, yy.
    pub shape: [f64; 3],
    /// DN
    pub brightness: f64,
    /// Motion, px per exposure.
    pub motion: [f64; 2],
    cover: Option<Cover>,
    companion: Option<Spot>,
}

/// The unknowns of a scene: bx, by, a1, a2, a3, v0, v1, and with glare its two slopes or, for a modelled lobe, its
/// centre, width and height; those after the seventh as differences from the truth.
pub type Unknowns = Vec<f64>;

/// Nuisance parameters of the bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beside {
    /// A constant background.
    Even,
    /// A sloped background.
    Plane,
    /// The lobe's centre, width and height.
    Lobe,
}

impl Scene {
    /// Draws phase, angle and directions at random.
    pub fn draw(condition: Condition, random: &mut Random) -> Scene {
        let middle = (condition.side_px as f64 - 1.0) / 2.0;
        let centre = [middle + random.uniform(-0.5, 0.5), middle + random.uniform(-0.5, 0.5)];
        let shape = shape(condition.semi_axes_px, random.uniform(0.0, std::f64::consts::PI));
        let over = FULL - condition.background;
        let brightness = match condition.saturated {
            share if share > 0.0 => over / profile(condition.profile, share), // area grows as s does
            _ => condition.peak - condition.background,
        };
        let turn = random.uniform(0.0, std::f64::consts::TAU);
        let motion = [condition.motion_px * turn.cos(), condition.motion_px * turn.sin()];
        let hidden = condition.occluded.max(condition.blinded);
        let cover = (hidden > 0.0).then(|| {
            let normal = [turn.cos(), turn.sin()];
            let [a1, a2, a3] = shape;
            let [x, y] = normal;
            // The ellipse reaches √(nᵀA⁻¹n) along n.
            let radius = ((a3 * x * x - 2.0 * a2 * x * y + a1 * y * y) / (a1 * a3 - a2 * a2)).sqrt();
            Cover::HalfPlane { normal, limit: x * centre[0] + y * centre[1] + chord(hidden) * radius }
        });
        let disc =
            (condition.behind_disc > 0.0).then(|| Cover::disc(centre, shape, (condition.behind_disc, turn), random));
        let companion = condition.companion.map(|Companion { share, distance_px, size }| Spot {
            centre: [centre[0] + distance_px * turn.cos(), centre[1] + distance_px * turn.sin()],
            shape: shape.map(|entry| entry / (size * size)),
            brightness: share * brightness,
            motion: [0.0; 2],
            profile: condition.profile,
            samples: condition.samples,
        });
        Scene { condition, centre, shape, brightness, motion, cover: cover.or(disc), companion }
    }

    /// The true values of the unknowns.
    pub fn unknowns(&self, beside: Beside) -> Unknowns {
        let ([bx, by], [a1, a2, a3]) = (self.centre, self.shape);
        let extra = match beside {
            Beside::Even => 0,
            Beside::Plane => 2,
            Beside::Lobe => 4,
        };
        let mut unknowns = vec![bx, by, a1, a2, a3, self.condition.background, self.brightness];
        unknowns.resize(7 + extra, 0.0);
        unknowns
    }

    /// The light for these unknowns without occluder or veil, DN, unclipped.
    pub fn light(&self, unknowns: &[f64]) -> Vec<f64> {
        self.sampled(unknowns, SAMPLES)
    }

    fn sampled(&self, unknowns: &[f64], samples: usize) -> Vec<f64> {
        let side = self.condition.side_px;
        let middle = (side as f64 - 1.0) / 2.0;
        let lobe = match unknowns[7..] {
            [x, y, width, height] => [x, y, width, height],
            _ => [0.0; 4],
        };
        let [gx, gy] = if let [gx, gy] = unknowns[7..] { [gx, gy] } else { [0.0; 2] };
        let ground = |i: usize| {
            let (x, y) = ((i % side) as f64, (i / side) as f64);
            let glare = match self.condition.glare {
                Glare::None => 0.0,
                Glare::Plane([px, py]) => PLANE_OVER + px * (x - middle) + py * (y - middle),
                Glare::Lobe { height, centre, width } => {
                    let square = (x - centre[0] - lobe[0]).powi(2) + (y - centre[1] - lobe[1]).powi(2);
                    (height + lobe[3]) * (-square / (2.0 * (width + lobe[2]).powi(2))).exp()
                }
                Glare::Lorentz { height, centre, width } => {
                    let square = (x - centre[0] - lobe[0]).powi(2) + (y - centre[1] - lobe[1]).powi(2);
                    (height + lobe[3]) / (1.0 + square / (width + lobe[2]).powi(2))
                }
            };
            unknowns[5] + gx * (x - middle) + gy * (y - middle) + glare
        };
        let mut light: Vec<f64> = (0..side * side).map(ground).collect();
        let spot = Spot {
            centre: [unknowns[0], unknowns[1]],
            shape: [unknowns[2], unknowns[3], unknowns[4]],
            brightness: unknowns[6],
            motion: self.motion,
            profile: self.condition.profile,
            samples,
        };
        spot.add_to(&mut light, side);
        if self.condition.blur_px > 0.0 { blurred(&light, side, self.condition.blur_px) } else { light }
    }

    /// The light that reaches the camera, and the pixels unaffected by occluder or veil.
    pub fn seen(&self) -> (Vec<f64>, Vec<bool>) {
        let mut light = self.sampled(&self.unknowns(Beside::Even), self.condition.samples);
        let mut kept = vec![true; light.len()];
        let side = self.condition.side_px;
        if let Some(companion) = self.companion {
            companion.add_to(&mut light, side);
        }
        let Some(cover) = self.cover else { return (light, kept) };
        for (i, (light, kept)) in light.iter_mut().zip(&mut kept).enumerate() {
            let (x, y) = ((i % side) as f64, (i / side) as f64);
            if self.condition.blinded == 0.0 {
                let share = cover.covered(x, y);
                *light = *light * (1.0 - share) + OCCLUDER * share;
                *kept = share == 0.0;
            } else {
                let veil = VEIL * normal_cdf((cover.beyond(x, y) - VEIL_BEHIND_PX) / VEIL_EDGE_PX);
                *light += veil;
                *kept = veil < 0.5;
            }
        }
        (light, kept)
    }

    /// Starting values with the errors of the last frame's answer: 1.5 px, 8 % and 20 %.
    pub fn prior(&self, random: &mut Random) -> Vec<(&'static str, f64)> {
        let [a1, a2, a3] = self.shape;
        vec![
            ("bx", self.centre[0] + 1.5 * random.normal()),
            ("by", self.centre[1] + 1.5 * random.normal()),
            ("a1", 1.08 * a1),
            ("a2", 1.08 * a2),
            ("a3", 0.95 * a3),
            ("v0", self.condition.background),
            ("v1", 0.8 * self.brightness),
        ]
    }
}

impl Cover {
    /// Depth of a position inside the cover, px; negative outside.
    fn beyond(&self, x: f64, y: f64) -> f64 {
        match *self {
            Cover::HalfPlane { normal, limit } => normal[0] * x + normal[1] * y - limit,
            Cover::Disc { centre, radius } => radius - (x - centre[0]).hypot(y - centre[1]),
        }
    }

    /// A disc in that direction that covers this share of an ellipse, with radius 0.6 to 1.1 times its shorter
    /// semi-axis.
    fn disc(centre: [f64; 2], shape: [f64; 3], (share, turn): (f64, f64), random: &mut Random) -> Cover {
        let [major, minor] = semi_axes(shape);
        let radius = minor * random.uniform(0.6, 1.1);
        let at = |distance: f64| [centre[0] + distance * turn.cos(), centre[1] + distance * turn.sin()];
        let (mut near, mut far) = (0.0, major + radius);
        for _ in 0..40 {
            let middle = (near + far) / 2.0;
            let disc = Cover::Disc { centre: at(middle), radius };
            if disc.share_of(centre, shape) > share { near = middle } else { far = middle }
        }
        Cover::Disc { centre: at(far), radius }
    }

    /// The share of an ellipse inside the cover, on a grid of half pixels.
    fn share_of(&self, [bx, by]: [f64; 2], [a1, a2, a3]: [f64; 3]) -> f64 {
        let reach = semi_axes([a1, a2, a3])[0].ceil() as i32 * 2;
        let places = (-reach..=reach).flat_map(|row| (-reach..=reach).map(move |column| (column, row)));
        let inside = places.map(|(u, v)| (f64::from(u) / 2.0, f64::from(v) / 2.0));
        let inside = inside.filter(|(u, v)| a1 * u * u + 2.0 * a2 * u * v + a3 * v * v < 1.0);
        let (all, covered) = inside
            .fold((0, 0), |(all, covered), (u, v)| (all + 1, covered + i32::from(self.beyond(bx + u, by + v) > 0.0)));
        f64::from(covered) / f64::from(all.max(1))
    }

    /// The share of a pixel inside the cover.
    fn covered(&self, x: f64, y: f64) -> f64 {
        let sample = |k: usize| (k as f64 + 0.5) / EDGE_SAMPLES as f64 - 0.5;
        let all = (0..EDGE_SAMPLES * EDGE_SAMPLES).map(|k| (sample(k % EDGE_SAMPLES), sample(k / EDGE_SAMPLES)));
        let inside = all.filter(|(u, v)| self.beyond(x + u, y + v) > 0.0).count();
        inside as f64 / (EDGE_SAMPLES * EDGE_SAMPLES) as f64
    }
}

/// Distance from the centre of a unit disc of the chord that cuts off this share of its area: (acos t − t√(1 − t²))/π
/// = share.
fn chord(share: f64) -> f64 {
    let (mut low, mut high) = (-1.0f64, 1.0f64);
    for _ in 0..60 {
        let t = (low + high) / 2.0;
        let cut = (t.acos() - t * (1.0 - t * t).sqrt()) / std::f64::consts::PI;
        if cut > share { low = t } else { high = t }
    }
    low
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::condition::condition;

    /// Counted over the pixels of the spot: edge pixels count as hidden, hence 3 %.
    #[test]
    fn occluders_cover_their_share() {
        assert!((chord(0.25) - 0.4040).abs() < 1e-4 && (chord(0.4) - 0.158).abs() < 1e-3 && chord(0.5).abs() < 1e-9);
        for number in 0..8 {
            let scene = Scene::draw(condition("occl25"), &mut Random::of("hidden", number));
            let (_, kept) = scene.seen();
            let [a1, a2, a3] = scene.shape;
            let inside = |i: &usize| {
                let (u, v) = ((i % 96) as f64 - scene.centre[0], (i / 96) as f64 - scene.centre[1]);
                a1 * u * u + 2.0 * a2 * u * v + a3 * v * v < 1.0
            };
            let spot: Vec<usize> = (0..kept.len()).filter(inside).collect();
            let hidden = spot.iter().filter(|&&i| !kept[i]).count() as f64 / spot.len() as f64;
            assert!((hidden - 0.25).abs() < 0.03, "{hidden}");
        }
    }
}
