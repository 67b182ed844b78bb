//! Colours: assigns detected things to the targets of a document that fits several values per pixel, by colour. Documents
//! that fit one value per pixel have no colours.
//!
//! 1. A target's colour is the contribution of its brightness to each entry of `observed` at its centre, by the model's own
//!    formulas: a column of the mixing matrix M.
//! 2. A thing's colour c is the sum of its pixels above the median of those around it. Pixels clipped in any entry are skipped.
//! 3. Its light is (MᵀM)⁻¹Mᵀc, one number per target: it is assigned to the target with the largest. Of several such things the one
//!    with most light is taken, or the first where the target's position is known.
//!
//! Results are one [`Detection`] per target, with starting values in the target's own units.

use isophote_jit::PlaneView;
use isophote_symbolic::{Estimator, Model, ParameterId, Start, Summand};
use nalgebra::{DMatrix, DVector};

use crate::sight::grey::Mixture;
use crate::sight::start::Detection;
use crate::sight::view::View;
use crate::statistics::median;

/// The brightness at which a model is evaluated.
const PROBE: f64 = 100.0;
/// Largest dᵀAd of a thing's own pixels.
const INSIDE: f64 = 1.0;
/// Range of dᵀAd of the surrounding pixels.
const AROUND: [f64; 2] = [2.0, 5.0];
/// Largest distance of pixels from the centre, along each coordinate.
const REACH_PX: f64 = 200.0;

/// Colours of a model's targets.
pub(crate) struct Colours {
    /// Each entry of `observed` as a mixture of the planes.
    entries: Vec<Mixture>,
    /// Entries × targets.
    mixing: DMatrix<f64>,
    /// Targets × entries.
    unmixing: DMatrix<f64>,
    /// For each background parameter its entry and its coefficient there.
    backgrounds: Vec<Option<(usize, f64)>>,
}

/// Whether the position of the first target is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Whereabouts {
    /// Detections are sorted by distance from it.
    Known,
    Unknown,
}

/// A detection with its colour.
struct Coloured {
    detection: Detection,
    light: Vec<f64>,
    /// The background of each entry.
    backgrounds: Vec<f64>,
}

impl Colours {
    /// `None` where a pixel has one value, or the formulas do not determine the targets' colours.
    pub fn of(model: &Model, constants: &[f64]) -> Option<Colours> {
        let summands: Vec<Summand> = model.summands().into_iter().filter(|summand| !summand.is_clipped()).collect();
        if summands.len() < 2 {
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
        let added = |entry: &Summand, parameter: usize| {
            let at = |value: f64| {
                let mut parameters = base.clone();
                parameters[parameter] = value;
                entry.predicted(&place, &parameters, constants)
            };
            (at(PROBE) - at(0.0)) / PROBE
        };
        let brightness: Vec<ParameterId> =
            model.roles().iter().map(|roles| roles.brightness).collect::<Option<Vec<_>>>()?;
        let mixing = DMatrix::from_fn(summands.len(), brightness.len(), |i, target| {
            added(&summands[i], brightness[target].index())
        });
        let inverse = (mixing.transpose() * &mixing).try_inverse()?;
        let unmixing = inverse * mixing.transpose();
        let is_known = mixing.column_iter().all(|column| column.sum() > 0.0);
        let is_finite = unmixing.iter().all(|entry| entry.is_finite());
        let background = |(number, parameter): (usize, &isophote_symbolic::Parameter)| {
            let counts = summands.iter().map(|entry| added(entry, number)).enumerate();
            let most = counts.rev().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            most.filter(|(_, count)| parameter.start == Start::Estimator(Estimator::Background) && *count != 0.0)
        };
        let backgrounds = model.parameters().iter().enumerate().map(background).collect();
        let mean = || Mixture::mean(model.channels().len());
        let entries = summands.iter().map(|entry| Mixture::of_summand(entry, constants).unwrap_or_else(mean)).collect();
        (is_known && is_finite).then_some(Colours { entries, mixing, unmixing, backgrounds })
    }

    /// One detection per target, in the document's order, and `given` with the background of each entry where the
    /// document estimates it. `None` when no thing has a target's colour.
    pub fn sorted(
        &self,
        view: &View,
        detections: &[Detection],
        given: &[Option<f64>],
        first: Whereabouts,
    ) -> Option<(Vec<Detection>, Vec<Option<f64>>)> {
        let coloured: Vec<Coloured> = detections.iter().map(|detection| self.coloured(view, detection)).collect();
        let target = |target: usize| {
            let mut own = coloured.iter().filter(|thing| largest(&thing.light) == Some(target));
            if first == Whereabouts::Known && target == 0 {
                return own.next();
            }
            own.max_by(|a, b| a.light[target].total_cmp(&b.light[target]))
        };
        let targets: Vec<&Coloured> = (0..self.mixing.ncols()).map(target).collect::<Option<_>>()?;
        let mut given = given.to_vec();
        for (given, background) in given.iter_mut().zip(&self.backgrounds) {
            if given.is_none()
                && let Some((entry, count)) = background
            {
                *given = targets.first().map(|target| target.backgrounds[*entry] / count);
            }
        }
        let detection = |(number, target): (usize, &&Coloured)| Detection {
            amplitude: target.detection.amplitude / self.mixing.column(number).sum(),
            ..target.detection.clone()
        };
        Some((targets.iter().enumerate().map(detection).collect(), given))
    }

    fn coloured(&self, view: &View, detection: &Detection) -> Coloured {
        let (mut inside, mut around): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        let size = view.window.size();
        let range = |axis: usize| {
            let reach = (AROUND[1].sqrt() * detection.size[axis]).min(REACH_PX);
            let first = (detection.centre[axis] - reach).floor().max(0.0) as usize;
            let last = (detection.centre[axis] + reach).ceil().max(0.0) as usize;
            first..(last + 1).min(size[axis])
        };
        let ranges: [_; 4] = std::array::from_fn(range);
        let [xs, ys, zs, ws] = ranges;
        let columns = ws.flat_map(|w| zs.clone().map(move |z| (z, w)));
        let rows = columns.flat_map(|(z, w)| ys.clone().map(move |y| (y, z, w)));
        for place in rows.flat_map(|(y, z, w)| xs.clone().map(move |x| [x, y, z, w])) {
            let distance = distance(detection, place);
            if distance <= INSIDE {
                inside.extend(self.values(view, place));
            } else if (AROUND[0]..AROUND[1]).contains(&distance) {
                around.extend(self.values(view, place));
            }
        }
        // A thing that fills the window has no surroundings: the sum's background is divided evenly.
        let even = detection.background / self.entries.len() as f64;
        let background =
            |entry: usize| median(&mut around.iter().map(|values| values[entry]).collect::<Vec<f64>>()).unwrap_or(even);
        let backgrounds: Vec<f64> = (0..self.entries.len()).map(background).collect();
        let above = |entry: usize| inside.iter().map(|values| values[entry] - backgrounds[entry]).sum();
        let colour = DVector::from_fn(self.entries.len(), |entry, _| above(entry));
        // A dark thing reduces light.
        let light = (&self.unmixing * colour).iter().map(|light| light * detection.amplitude.signum()).collect();
        Coloured { detection: detection.clone(), light, backgrounds }
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
fn distance(detection: &Detection, place: [usize; 4]) -> f64 {
    let offset: [f64; 4] = std::array::from_fn(|axis| place[axis] as f64 - detection.centre[axis]);
    let row = |axis: usize| detection.extent[axis].iter().zip(offset).map(|(entry, d)| entry * d).sum::<f64>();
    (0..4).map(|axis| offset[axis] * row(axis)).sum()
}

/// Index of the largest light; `None` if none is positive.
fn largest(light: &[f64]) -> Option<usize> {
    let most = light.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    (*most.1 > 0.0).then_some(most.0)
}
