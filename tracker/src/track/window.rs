//! The window around a target: a fit needs the pixels of its domain and a little more, not the whole frame.
//!
//! What comes in: a model, and parameters. What goes out: a rectangle. How far a domain reaches is found once for a model,
//! by walking from the middle of a made-up target outwards until the domain ends, in units of the outline `dᵀAd = 1`.

use isophote_jit::{Slices, Window};
use isophote_symbolic::{Estimator, Model, Roles, Start};
use nalgebra::{DMatrix, Matrix4};

/// Semi-axes of the made-up targets, px.
const SEMI_AXES_PX: [f64; 2] = [8.0, 80.0];
/// Made-up targets are this far from each other, px.
const APART_PX: f64 = 10_000.0;
/// A step of the walk: outwards by this factor …
const STEP: f64 = 1.05;
/// … from here, in semi-axes …
const NEAREST: f64 = 0.25;
/// … to here. A domain that ends further out does not bound the window.
const FARTHEST: f64 = 6.0;

/// By how much a window is larger than the domain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Margin {
    /// Share of the domain's half width.
    pub share: f64,
    /// px, along each coordinate.
    pub px: [f64; 4],
}

impl Margin {
    /// None at all.
    pub const NONE: Margin = Margin { share: 0.0, px: [0.0; 4] };

    /// The same on all sides.
    pub fn even(share: f64, px: f64) -> Margin {
        Margin { share, px: [px; 4] }
    }
}

/// How far a model's domain reaches, in units of the outline; `None` where that is unknown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach(Option<f64>);

impl Reach {
    /// Walks through the model's domain.
    pub fn of(model: &Model, constants: &[f64]) -> Reach {
        let n = model.coordinates().len();
        let known = |roles: &Roles| roles.centre.len() == n && roles.shape.len() == n * (n + 1) / 2;
        if n < 2 || !model.roles().iter().all(known) {
            return Reach(None);
        }
        let mut reach: f64 = 0.0;
        for semi_axis in SEMI_AXES_PX {
            let parameters = made_up(model, semi_axis);
            for roles in model.roles() {
                match walk(model, &parameters, constants, roles, semi_axis) {
                    Some(end) => reach = reach.max(end),
                    None => return Reach(None),
                }
            }
        }
        Reach(Some(reach))
    }

    /// True when it is.
    pub fn is_known(&self) -> bool {
        self.0.is_some()
    }

    /// In units of the outline.
    pub fn outlines(&self) -> Option<f64> {
        self.0
    }

    /// The window that holds the domain of all targets; all of `whole` where the reach is unknown, or `None` when nothing
    /// of the domain is inside.
    pub fn window(&self, model: &Model, parameters: &[f64], margin: Margin, whole: Window) -> Option<Window> {
        let Some(reach) = self.0 else { return Some(whole) };
        let (mut low, mut high) = ([f64::INFINITY; 4], [f64::NEG_INFINITY; 4]);
        for roles in model.roles() {
            let half = half_widths(roles, model.coordinates().len(), parameters)?;
            for (axis, (parameter, half)) in roles.centre.iter().zip(half).enumerate() {
                let wide = reach * half * (1.0 + margin.share) + margin.px[axis];
                let centre = parameters[parameter.index()];
                low[axis] = low[axis].min(centre - wide);
                high[axis] = high[axis].max(centre + wide);
            }
        }
        clipped(low, high, whole)
    }
}

/// A target of that size, the others far away.
fn made_up(model: &Model, semi_axis: f64) -> Vec<f64> {
    let start = |start: &Start| match start {
        Start::Number(number) => *number,
        Start::Estimator(Estimator::Size(_)) => semi_axis,
        Start::Estimator(Estimator::Extent(row, column)) if row == column => semi_axis.powi(-2),
        Start::Estimator(Estimator::Extent(..)) => 0.0,
        Start::Estimator(_) => 100.0,
    };
    let mut parameters: Vec<f64> = model.parameters().iter().map(|parameter| start(&parameter.start)).collect();
    let n = model.coordinates().len();
    for (number, roles) in model.roles().iter().enumerate() {
        for parameter in &roles.centre {
            parameters[parameter.index()] = APART_PX * number as f64;
        }
        let mut entries = roles.shape.iter();
        for (row, column) in (0..n).flat_map(|row| (row..n).map(move |column| (row, column))) {
            if let Some(parameter) = entries.next() {
                parameters[parameter.index()] = if row == column { semi_axis.powi(-2) } else { 0.0 };
            }
        }
    }
    parameters
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
                let mut place = centre.clone();
                place[axis] += sign * at * semi_axis;
                if !model.domain_holds(&place, parameters, constants) {
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

/// A of one target; `None` without the role `shape`.
pub(crate) fn shape(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<DMatrix<f64>> {
    let mut a = DMatrix::zeros(dimensions, dimensions);
    set_shape(roles, dimensions, parameters, |place, entry| a[place] = entry)?;
    Some(a)
}

/// Calls with each entry of A and its row and column; `None` without the role `shape`.
fn set_shape(
    roles: &Roles,
    dimensions: usize,
    parameters: &[f64],
    mut set: impl FnMut((usize, usize), f64),
) -> Option<()> {
    let mut upper = roles.shape.iter().map(|parameter| parameters[parameter.index()]);
    for row in 0..dimensions {
        for column in row..dimensions {
            let entry = upper.next()?;
            set((row, column), entry);
            set((column, row), entry);
        }
    }
    Some(())
}

/// Half the outline's width along each coordinate, `√(A⁻¹)_ii`; `None` when A is not positive definite.
pub(crate) fn half_widths(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<Vec<f64>> {
    let mut whole = Matrix4::identity(); // asked for many times a frame: on the stack
    set_shape(roles, dimensions, parameters, |place, entry| whole[place] = entry)?;
    let inverse = whole.cholesky()?.inverse();
    Some((0..dimensions).map(|axis| inverse[(axis, axis)].sqrt()).collect())
}

/// What begins as the size of what is seen, where that is a model's only target.
pub(crate) fn sizes(model: &Model, parameters: &[f64]) -> Vec<f64> {
    let is_size = |start: &Start| matches!(start, Start::Estimator(Estimator::Size(_)));
    let known = model.parameters().iter().zip(parameters).filter(|_| model.roles().len() == 1);
    known.filter(|(parameter, _)| is_size(&parameter.start)).map(|(_, value)| value.abs()).collect()
}

/// The pixels between two corners that are inside `whole`. A coordinate that has no corners keeps its extent.
fn clipped(low: [f64; 4], high: [f64; 4], whole: Window) -> Option<Window> {
    let (first, size) = (whole.first(), whole.size());
    let (mut from, mut count) = (first, size);
    for axis in 0..4 {
        if low[axis] > high[axis] {
            continue; // not a coordinate of the model
        }
        let last = (first[axis] + size[axis]) as f64;
        let begin = low[axis].floor().max(first[axis] as f64);
        let end = (high[axis].ceil() + 1.0).min(last);
        if begin.is_nan() || end.is_nan() || begin >= end {
            return None;
        }
        from[axis] = begin as usize;
        count[axis] = (end - begin) as usize;
    }
    let slices = Slices { first: [from[2], from[3]], count: [count[2], count[3]] };
    Some(Window { x: from[0], y: from[1], width: count[0], height: count[1], slices })
}

/// True when `inner` lies inside `outer`.
pub(crate) fn holds(outer: Window, inner: Window) -> bool {
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
        let known = reach.0.unwrap();
        assert!((2.2_f64.sqrt()..2.2_f64.sqrt() * STEP).contains(&known), "{known}");
        let whole = Window::whole(640, 480);
        // 20 × 10 px at 45°: (A⁻¹)_xx = (20² + 10²)/2.
        let (p, q) = (20.0_f64.powi(-2), 10.0_f64.powi(-2));
        let parameters = [100.0, 470.0, 0.5 * (p + q), 0.5 * (p - q), 0.5 * (p + q), -0.5, -0.3, 20.0, 100.0];
        let window = reach.window(&spot, &parameters, Margin::NONE, whole).unwrap();
        let half = known * 250.0_f64.sqrt();
        assert!((window.width as f64 - 2.0 * half).abs() < 5.0, "{window:?}");
        assert_eq!(window.y + window.height, 480, "clipped: {window:?}");
        assert!(holds(whole, window) && !holds(window, whole));
        let outside = [-200.0, 470.0, p, 0.0, p, -0.5, -0.3, 20.0, 100.0];
        assert_eq!(reach.window(&spot, &outside, Margin::NONE, whole), None);
    }

    #[test]
    fn a_model_without_domain_or_shape_looks_at_everything() {
        for text in [
            include_str!("../../../models/profile-1d.toml").to_string(),
            include_str!("../../../models/gaussian.toml").replace("domain     = \"s <= 4\"", ""),
        ] {
            assert!(Reach::of(&model(&text), &[]).0.is_none());
        }
        let volume = Reach::of(&model(include_str!("../../../models/blob-3d.toml")), &[]);
        assert!((2.0..2.0 * STEP).contains(&volume.0.unwrap()), "{volume:?}");
        let three = Reach::of(&model(include_str!("../../../models/three-spots.toml")), &[0.0; 9]);
        assert!(three.0.is_some());
    }
}
