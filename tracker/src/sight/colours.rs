//! Colours: which of the things in a picture is which target of a document that fits several values of a pixel.
//!
//! What comes in: a model, what [`crate::sight::start`] found in the sum of its pictures, and the planes. What goes out: one sight a
//! target, of the target's own colour, with starting values in the target's own units. Documents that fit one number a
//! pixel have no colours.
//!
//! 1. A target's colour is what its brightness adds to each entry of `observed` at its centre, by the model's own formulas:
//!    a column of the mixing matrix M.
//! 2. A thing's colour c is by how much its pixels lie above the median of those around it. Pixels that are clipped in any
//!    entry are left out: they tell no colour.
//! 3. Its light is (MᵀM)⁻¹Mᵀc, one number a target: it may be the target of which it has most. Of several such the one with
//!    most light is taken, or the first where it is known where the target should be.

use isophote_jit::PlaneView;
use isophote_symbolic::{Estimator, Model, ParameterId, Start};
use nalgebra::{DMatrix, DVector};

use crate::sight::grey::Mixture;
use crate::sight::start::Sight;
use crate::sight::view::View;

/// The brightness at which a model is asked.
const PROBE: f64 = 100.0;
/// A thing's pixels have dᵀAd up to this, …
const INSIDE: f64 = 1.0;
/// … and those around it lie between these two.
const AROUND: [f64; 2] = [2.0, 5.0];
/// Pixels on either side of a centre that are looked at, along each coordinate.
const REACH_PX: f64 = 200.0;

/// Colours of a model's targets.
pub(crate) struct Colours {
    /// What each entry of `observed` is of the planes.
    entries: Vec<Mixture>,
    /// Entries × targets.
    mixing: DMatrix<f64>,
    /// Targets × entries.
    unmixing: DMatrix<f64>,
    /// For each parameter that is a background the entry that it is the ground of, and how much it counts there.
    grounds: Vec<Option<(usize, f64)>>,
}

/// What is known beforehand of where the first target is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Whereabouts {
    /// Sights come in the order of their distance from it.
    Known,
    Unknown,
}

/// A sight with its colour.
struct Coloured {
    sight: Sight,
    light: Vec<f64>,
    /// The ground of each entry.
    grounds: Vec<f64>,
}

impl Colours {
    /// `None` where a pixel has one value, or the formulas do not say what colour each target has.
    pub fn of(model: &Model, constants: &[f64]) -> Option<Colours> {
        let models: Vec<Model> =
            model.summands().into_iter().filter(|summand| !summand.is_clipped).map(|summand| summand.model).collect();
        if models.len() < 2 {
            return None;
        }
        let place = vec![0.0; model.coordinates().len()];
        let plain = |start: &Start| match start {
            Start::Number(number) => *number,
            Start::Estimator(Estimator::Extent(row, column)) if row == column => 1.0,
            Start::Estimator(Estimator::Size(_)) => 1.0,
            Start::Estimator(_) => 0.0,
        };
        let mut base: Vec<f64> = model.parameters().iter().map(|parameter| plain(&parameter.start)).collect();
        model.roles().iter().flat_map(|roles| &roles.centre).for_each(|centre| base[centre.index()] = 0.0);
        let added = |entry: &Model, parameter: usize| {
            let at = |value: f64| {
                let mut parameters = base.clone();
                parameters[parameter] = value;
                entry.predicted(&place, &parameters, constants)
            };
            (at(PROBE) - at(0.0)) / PROBE
        };
        let brightness: Vec<ParameterId> =
            model.roles().iter().map(|roles| roles.brightness).collect::<Option<Vec<_>>>()?;
        let mixing =
            DMatrix::from_fn(models.len(), brightness.len(), |i, target| added(&models[i], brightness[target].index()));
        let inverse = (mixing.transpose() * &mixing).try_inverse()?;
        let unmixing = inverse * mixing.transpose();
        let is_known = mixing.column_iter().all(|column| column.sum() > 0.0);
        let is_finite = unmixing.iter().all(|entry| entry.is_finite());
        let ground = |(number, parameter): (usize, &isophote_symbolic::Parameter)| {
            let counts = models.iter().map(|entry| added(entry, number)).enumerate();
            let most = counts.rev().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            most.filter(|(_, count)| parameter.start == Start::Estimator(Estimator::Background) && *count != 0.0)
        };
        let grounds = model.parameters().iter().enumerate().map(ground).collect();
        let entries = models.iter().map(|entry| Mixture::observed(entry, constants)).collect();
        (is_known && is_finite).then_some(Colours { entries, mixing, unmixing, grounds })
    }

    /// One sight a target, in the document's order, and `given` with the grounds of each entry where the document asks for
    /// them. `None` when a target's colour is nowhere.
    pub fn sorted(
        &self,
        view: &View,
        sights: &[Sight],
        given: &[Option<f64>],
        first: Whereabouts,
    ) -> Option<(Vec<Sight>, Vec<Option<f64>>)> {
        let coloured: Vec<Coloured> = sights.iter().map(|sight| self.coloured(view, sight)).collect();
        let target = |target: usize| {
            let mut own = coloured.iter().filter(|thing| largest(&thing.light) == Some(target));
            if first == Whereabouts::Known && target == 0 {
                return own.next();
            }
            own.max_by(|a, b| a.light[target].total_cmp(&b.light[target]))
        };
        let targets: Vec<&Coloured> = (0..self.mixing.ncols()).map(target).collect::<Option<_>>()?;
        let mut given = given.to_vec();
        for (given, ground) in given.iter_mut().zip(&self.grounds) {
            if given.is_none()
                && let Some((entry, count)) = ground
            {
                *given = targets.first().map(|target| target.grounds[*entry] / count);
            }
        }
        let sight = |(number, target): (usize, &&Coloured)| Sight {
            amplitude: target.sight.amplitude / self.mixing.column(number).sum(),
            ..target.sight.clone()
        };
        Some((targets.iter().enumerate().map(sight).collect(), given))
    }

    fn coloured(&self, view: &View, sight: &Sight) -> Coloured {
        let (mut inside, mut around): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        let size = view.window.size();
        let range = |axis: usize| {
            let reach = (AROUND[1].sqrt() * sight.size[axis]).min(REACH_PX);
            let first = (sight.centre[axis] - reach).floor().max(0.0) as usize;
            let last = (sight.centre[axis] + reach).ceil().max(0.0) as usize;
            first..(last + 1).min(size[axis])
        };
        let ranges: [_; 4] = std::array::from_fn(range);
        let [xs, ys, zs, ws] = ranges;
        let columns = ws.flat_map(|w| zs.clone().map(move |z| (z, w)));
        let rows = columns.flat_map(|(z, w)| ys.clone().map(move |y| (y, z, w)));
        for place in rows.flat_map(|(y, z, w)| xs.clone().map(move |x| [x, y, z, w])) {
            let distance = distance(sight, place);
            if distance <= INSIDE {
                inside.extend(self.values(view, place));
            } else if (AROUND[0]..AROUND[1]).contains(&distance) {
                around.extend(self.values(view, place));
            }
        }
        // A thing that fills the window has no ground around it: the sum's is shared evenly.
        let even = sight.background / self.entries.len() as f64;
        let ground = |entry: usize| median(around.iter().map(|values| values[entry]).collect()).unwrap_or(even);
        let grounds: Vec<f64> = (0..self.entries.len()).map(ground).collect();
        let above = |entry: usize| inside.iter().map(|values| values[entry] - grounds[entry]).sum();
        let colour = DVector::from_fn(self.entries.len(), |entry, _| above(entry));
        // A dark thing takes light away.
        let light = (&self.unmixing * colour).iter().map(|light| light * sight.amplitude.signum()).collect();
        Coloured { sight: sight.clone(), light, grounds }
    }

    /// A pixel's entries; `None` where one is clipped.
    fn values(&self, view: &View, place: [usize; 4]) -> Option<Vec<f64>> {
        let first = view.window.first();
        let at = std::array::from_fn(|axis| first[axis] + place[axis]);
        let pixel: Vec<f64> = view.planes.iter().map(|plane: &PlaneView| plane.pixel_at(at)).collect();
        let is_clipped = pixel.iter().zip(&view.saturation).any(|(value, limit)| value >= limit);
        let entries = || self.entries.iter().map(|entry| entry.at(pixel.iter().copied())).collect();
        (!is_clipped).then(entries)
    }
}

/// dᵀAd
fn distance(sight: &Sight, place: [usize; 4]) -> f64 {
    let offset: [f64; 4] = std::array::from_fn(|axis| place[axis] as f64 - sight.centre[axis]);
    let row = |axis: usize| sight.extent[axis].iter().zip(offset).map(|(entry, d)| entry * d).sum::<f64>();
    (0..4).map(|axis| offset[axis] * row(axis)).sum()
}

/// Whose light it is; `None` where there is none.
fn largest(light: &[f64]) -> Option<usize> {
    let most = light.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    (*most.1 > 0.0).then_some(most.0)
}

/// `None` of nothing.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
