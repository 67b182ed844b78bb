//! The window around a target: a fit needs the pixels of its domain and a margin, not the whole frame.
//!
//! The reach of a domain is found once per model, by walking from the centre of a synthetic target outwards until the
//! domain ends, in units of the outline `dᵀAd = 1`. Without an outline, the parameters that start from the target's
//! size along each coordinate replace it.

use isophote_jit::{Slices, Window};
use isophote_symbolic::{Estimator, Model, Parameter, ParameterId, Roles, Start};

use crate::outline::{Extents, half_widths, made_up};

/// Semi-axes of the synthetic targets, px.
const SEMI_AXES_PX: [f64; 2] = [8.0, 80.0];
/// The same where the reach is a multiple of the size plus some px: both extremes, and one in between.
const SIZES_PX: [f64; 3] = [1.0, 8.0, 80.0];
/// Factor of each step of the walk outwards.
const STEP: f64 = 1.05;
/// Start of the walk, semi-axes.
const NEAREST: f64 = 0.25;
/// End of the walk, semi-axes. A domain that ends further out does not bound the window.
pub(crate) const FARTHEST: f64 = 6.0;

/// The margin of a window around the domain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Margin {
    /// Share of the domain's half width.
    pub share: f64,
    /// px, along each coordinate.
    pub px: [f64; 4],
}

impl Margin {
    /// No margin.
    pub const NONE: Margin = Margin { share: 0.0, px: [0.0; 4] };

    /// The same on all sides.
    pub fn even(share: f64, px: f64) -> Margin {
        Margin { share, px: [px; 4] }
    }
}

/// How far a model's domain reaches; `None` where that is unknown.
#[derive(Clone, Debug)]
pub(crate) struct Reach(Option<End>);

/// Where a domain ends.
#[derive(Clone, Debug)]
enum End {
    /// In units of the outline.
    Outlines(f64),
    /// `share` times the size along each coordinate, plus `px`.
    Sizes { of: Vec<ParameterId>, share: f64, px: f64 },
}

impl Reach {
    /// Finds the reach by walking through the model's domain.
    pub fn of(model: &Model, constants: &[f64]) -> Reach {
        let n = model.coordinates().len();
        if n < 2 || !model.roles().iter().all(|roles| roles.centre.len() == n) {
            return Reach(None);
        }
        let is_outlined = model.roles().iter().all(|roles| roles.shape.len() == n * (n + 1) / 2);
        Reach(if is_outlined { outlined(model, constants) } else { sized(model, constants) })
    }

    /// True when the reach is known.
    pub fn is_known(&self) -> bool {
        self.0.is_some()
    }

    /// The reach in units of the outline; `None` without an outline.
    pub fn outlines(&self) -> Option<f64> {
        match self.0 {
            Some(End::Outlines(reach)) => Some(reach),
            _ => None,
        }
    }

    /// The window that holds the domain of all targets; all of `bounds` where the reach is unknown, or `None` when
    /// nothing of the domain is inside.
    pub fn window(&self, model: &Model, parameters: &[f64], margin: Margin, bounds: Window) -> Option<Window> {
        let Some(end) = &self.0 else { return Some(bounds) };
        let (mut low, mut high) = ([f64::INFINITY; 4], [f64::NEG_INFINITY; 4]);
        for roles in model.roles() {
            let half: Extents = match end {
                End::Outlines(reach) => {
                    half_widths(roles, model.coordinates().len(), parameters)?.map(|half| reach * half).collect()
                }
                End::Sizes { of, share, px } => of.iter().map(|id| share * parameters[id.index()].abs() + px).collect(),
            };
            for (axis, (parameter, half)) in roles.centre.iter().zip(half).enumerate() {
                let wide = half * (1.0 + margin.share) + margin.px[axis];
                let centre = parameters[parameter.index()];
                low[axis] = low[axis].min(centre - wide);
                high[axis] = high[axis].max(centre + wide);
            }
        }
        clipped(low, high, bounds)
    }
}

/// The reach in units of the outline, the farthest of several synthetic targets; `None` where a domain does not end.
fn outlined(model: &Model, constants: &[f64]) -> Option<End> {
    let mut reach: f64 = 0.0;
    for semi_axis in SEMI_AXES_PX {
        let parameters = made_up(model, semi_axis);
        for roles in model.roles() {
            reach = reach.max(walk(model, &parameters, constants, roles, semi_axis)?);
        }
    }
    Some(End::Outlines(reach))
}

/// The reach for the only target of a model that has a size along each coordinate instead.
fn sized(model: &Model, constants: &[f64]) -> Option<End> {
    let [roles] = model.roles() else { return None };
    let along = |axis: usize| {
        let is_size = |parameter: &&Parameter| parameter.start == Start::Estimator(Estimator::Size(axis));
        model.parameter(&model.parameters().iter().find(is_size)?.name)
    };
    let of = (0..roles.centre.len()).map(along).collect::<Option<_>>()?;
    let end = |size: f64| Some(size * walk(model, &made_up(model, size), constants, roles, size)?);
    let [small, middle, large] = SIZES_PX.map(end);
    let share = large? / SIZES_PX[2];
    let px = (small? - share * SIZES_PX[0]).max(middle? - share * SIZES_PX[1]).max(0.0);
    Some(End::Sizes { of, share, px })
}

/// Where the domain ends along the coordinates, the farthest of them, in semi-axes; `None` when it does not end, or does
/// not hold the centre.
fn walk(model: &Model, parameters: &[f64], constants: &[f64], roles: &Roles, semi_axis: f64) -> Option<f64> {
    let centre: Vec<f64> = roles.centre.iter().map(|parameter| parameters[parameter.index()]).collect();
    if !model.domain_holds(&centre, parameters, constants) {
        return None;
    }
    let mut farthest: f64 = 0.0;
    for axis in 0..centre.len() {
        for sign in [-1.0, 1.0] {
            let mut at = NEAREST;
            loop {
                let mut position = centre.clone();
                position[axis] += sign * at * semi_axis;
                if !model.domain_holds(&position, parameters, constants) {
                    break;
                }
                at *= STEP;
                if at > FARTHEST {
                    return None;
                }
            }
            farthest = farthest.max(at);
        }
    }
    Some(farthest)
}

/// The share of the box about the outline that lies inside `bounds`, the least of all targets; 1 without the role
/// `shape`.
pub(super) fn share_inside(model: &Model, parameters: &[f64], bounds: Window) -> f64 {
    let (first, size) = (bounds.first(), bounds.size());
    let of = |roles: &Roles| {
        let half = half_widths(roles, model.coordinates().len(), parameters)?;
        let along = |(axis, (parameter, half)): (usize, (&ParameterId, f64))| {
            let (first_edge, end) = (first[axis] as f64 - 0.5, (first[axis] + size[axis]) as f64 - 0.5);
            let centre = parameters[parameter.index()];
            ((centre + half).min(end) - (centre - half).max(first_edge)).max(0.0) / (2.0 * half)
        };
        Some(roles.centre.iter().zip(half).enumerate().map(along).product::<f64>())
    };
    model.roles().iter().filter_map(of).fold(1.0, f64::min)
}

/// The pixels between two corners that are inside `bounds`. A coordinate that has no corners keeps its extent.
fn clipped(low: [f64; 4], high: [f64; 4], bounds: Window) -> Option<Window> {
    let (first, size) = (bounds.first(), bounds.size());
    let (mut from, mut count) = (first, size);
    for axis in 0..4 {
        if low[axis] > high[axis] {
            continue; // not a coordinate of the model
        }
        let last = (first[axis] + size[axis]) as f64;
        let first_edge = low[axis].floor().max(first[axis] as f64);
        let end = (high[axis].ceil() + 1.0).min(last);
        if first_edge.is_nan() || end.is_nan() || first_edge >= end {
            return None;
        }
        from[axis] = first_edge as usize;
        count[axis] = (end - first_edge) as usize;
    }
    let slices = Slices { first: [from[2], from[3]], count: [count[2], count[3]] };
    Some(Window { x: from[0], y: from[1], width: count[0], height: count[1], slices })
}

/// True when `inner` lies inside `outer`.
pub(crate) fn contains(outer: Window, inner: Window) -> bool {
    let along = |axis: usize| {
        let (first, count) = (outer.first()[axis], outer.size()[axis]);
        inner.first()[axis] >= first && inner.first()[axis] + inner.size()[axis] <= first + count
    };
    (0..4).all(along)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn model(text: &str) -> Model {
        Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test")))
    }

    #[test]
    fn the_window_holds_the_domain_and_not_much_more() {
        let spot = model(include_str!("../../../models/spot.toml"));
        let reach = Reach::of(&spot, &[]);
        let known = reach.outlines().unwrap();
        assert!((2.2_f64.sqrt()..2.2_f64.sqrt() * STEP).contains(&known), "{known}");
        let whole = Window::whole(640, 480);
        // 20 × 10 px at 45°: (A⁻¹)_xx = (20² + 10²)/2.
        let (p, q) = (20.0_f64.powi(-2), 10.0_f64.powi(-2));
        let parameters = [100.0, 470.0, 0.5 * (p + q), 0.5 * (p - q), 0.5 * (p + q), -0.5, -0.3, 20.0, 100.0];
        let window = reach.window(&spot, &parameters, Margin::NONE, whole).unwrap();
        let half = known * 250.0_f64.sqrt();
        assert!((window.width as f64 - 2.0 * half).abs() < 5.0, "{window:?}");
        assert_eq!(window.y + window.height, 480, "clipped: {window:?}");
        let inside = share_inside(&spot, &parameters, whole);
        assert!((inside - 0.5 - 9.5 / (2.0 * 250.0_f64.sqrt())).abs() < 1e-9, "{inside}");
        assert!(contains(whole, window) && !contains(window, whole));
        let outside = [-200.0, 470.0, p, 0.0, p, -0.5, -0.3, 20.0, 100.0];
        assert_eq!(reach.window(&spot, &outside, Margin::NONE, whole), None);
    }

    #[test]
    fn a_size_along_each_coordinate_replaces_an_outline() {
        let model = model(include_str!("../../../models/gaussian-pixel.toml"));
        let reach = Reach::of(&model, &[0.05, 0.75]);
        for [wx, wy] in [[0.3, 0.5], [1.0, 2.0], [6.0, 3.0], [20.0, 90.0]] {
            let window =
                reach.window(&model, &[500.0, 400.0, wx, wy, 0.0, 1.0], Margin::NONE, Window::whole(1000, 800));
            let window = window.unwrap();
            // The domain ends 2 (w + 1) from the centre.
            for (is, least) in [(window.width, 4.0 * (wx + 1.0)), (window.height, 4.0 * (wy + 1.0))] {
                assert!((least..1.1 * least + 5.0).contains(&(is as f64)), "{wx} × {wy}: {window:?}");
            }
        }
    }

    #[test]
    fn a_model_without_domain_or_shape_uses_the_whole_window() {
        for text in [
            include_str!("../../../models/profile-1d.toml").to_string(),
            include_str!("../../../models/gaussian.toml").replace("domain     = \"s <= 4\"", ""),
        ] {
            assert!(Reach::of(&model(&text), &[]).0.is_none());
        }
        let volume = Reach::of(&model(include_str!("../../../models/blob-3d.toml")), &[]);
        assert!((2.0..2.0 * STEP).contains(&volume.outlines().unwrap()), "{volume:?}");
        let three = Reach::of(&model(include_str!("../../../models/three-spots.toml")), &[0.0; 9]);
        assert!(three.0.is_some());
    }
}
