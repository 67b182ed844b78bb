//! What hides a part of a pose's picture: a hand before a spot, glare beside it. Pixels that the pose does not explain are left
//! out, and the rest is fitted again.
//!
//! What comes in: a picture, and poses to begin with. What goes out: the fit that explains most of all spots' pixels, and the
//! share that it left out. It never knows earlier frames.
//!
//! What is hidden shows once the pose is nearly known, and the pose once it is known what is hidden. So several beginnings are
//! tried: the pose that was expected, the one that the plain fit came to, and, as the other spots are enough for a pose, that
//! fit once without each of the spots. Each goes on by itself: find what is hidden, fit the rest.

use isophote_symbolic::{Model, ParameterId};

use super::backgrounds::MISFIT;
use super::painted::{Painted, dilated};
use crate::estimate::Substitute;
use crate::pose::{self, Five, Geometry};
use crate::sight::view::View;
use crate::solve::fit::{Fit, fit};
use crate::solve::passes::SQUARE_MAX;
use crate::solve::residuals::{OUTLIER, Over, Predictions, Residual};
use crate::solve::stage_kernels::{CompileFailure, Control, StageKernels};

/// A picture of a pose.
pub(crate) struct Veil<'a> {
    pub kernels: &'a StageKernels,
    pub predictions: &'a Predictions,
    pub view: &'a View<'a>,
    pub constants: &'a [f64],
    pub geometry: &'a Geometry,
    pub names: SpotNames,
}

/// Whether it is known which spot is which.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SpotNames {
    /// The target was seen before.
    Known,
    /// It was found in this picture.
    Guessed,
}

/// What is left out at first.
#[derive(Clone, Copy)]
enum First<'a> {
    /// What the start does not explain.
    Unexplained,
    /// A spot.
    Spot(usize),
    /// These pixels.
    Mask(&'a [bool]),
}

/// A fit, and the pixels that it left out.
struct Cleared {
    fit: Fit,
    hidden: Vec<bool>,
    /// Spots that tell where they are.
    seen: usize,
}

/// How many times their deviation residuals are taken to have, round by round.
const SCALES: [f64; 4] = [3.0, 1.5, 1.0, 1.0];
/// Half the widths of neighbourhoods, px: what is hidden begins sharply, glare dies away slowly.
const NEAR_PX: [usize; 3] = [0, 2, 7];
/// At least this share of the spots' pixels must be left, of several spots and of one.
const LEFT: [f64; 2] = [0.4, 0.62];
/// Around what is hidden so many px are looked at together, …
const RING_PX: usize = 3;
/// … so many times, …
const RINGS: usize = 12;
/// … and belong to it while their mean is too low by so many standard deviations, …
const RING_DARK: f64 = 3.0;
/// … or too high: what covers a spot has an edge, glare has none.
const RING_BRIGHT: f64 = 2.0;
/// So many spots that look alike tell their names by where they are.
const NAMED: usize = 3;
/// A fit that leaves out less than this share, and explains the rest, needs no others beside it.
const SURE: f64 = 0.35;
/// Poses farther apart are two, rad, …
const OTHER: f64 = 0.1;
/// … and which of them it is stays open where the one costs less than this more than the other.
const UNDECIDED: f64 = 50.0;
/// A spot ends at this s.
const RIM: f64 = 1.2;
/// What of the picture is looked at, as a multiple of s.
const REACH: f64 = 2.6;
/// A brightness is guessed from pixels at least this bright, as a share of the brightest.
const BRIGHT: f64 = 0.2;
/// Quantiles of what single pixels say about it.
const QUANTILES: [f64; 5] = [0.1, 0.25, 0.5, 0.75, 0.9];
/// A spot of this share of the brightest one's brightness is dark.
const DARK: f64 = 0.05;
/// Of the brightnesses that explain at least this share of what the best one does it is the largest.
const SHINING: f64 = 0.45;
/// Another brightness must explain so many times as many pixels.
const BETTER: f64 = 1.1;

impl Veil<'_> {
    /// The fit that explains most, of all beginnings; `None` where hardly anything is left of any.
    pub fn unveiled(&self, starts: &[Vec<f64>]) -> Result<Option<Fit>, CompileFailure> {
        // A single spot has nothing beside it that would say what is hidden of it.
        if self.names == SpotNames::Guessed && self.geometry.target.spots.len() < 2 {
            return Ok(None);
        }
        let Some(view) = self.part(starts) else { return Ok(None) };
        let part = Veil { view: &view, ..*self };
        let mut found: Vec<Cleared> = Vec::new();
        for start in starts {
            found.extend(part.cleared(start.clone(), First::Unexplained)?);
            // What was expected explains the rest: nothing is to be found out about the spots.
            if self.names == SpotNames::Known && found.iter().any(Cleared::is_sure) {
                break;
            }
        }
        let spots = self.geometry.target.spots.len();
        if let Some(start) = starts.last().filter(|_| spots > 1 && !found.iter().any(Cleared::is_sure)) {
            for spot in 0..spots {
                found.extend(part.cleared(start.clone(), First::Spot(spot))?);
            }
        }
        let Some(best) = part.best(found) else { return Ok(None) };
        if self.names == SpotNames::Known || spots < 2 {
            return Ok(Some(best.fit));
        }
        // Two spots that look alike have the same picture with their names exchanged.
        let is_named = |one: &Cleared| self.kernels.model().entries() > 1 || one.seen >= NAMED.min(spots);
        // Which spot is which was found out with the hidden pixels: now that these are known, the others are tried.
        let spend = |units: u64| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let outlines: Vec<Five> = self.geometry.outlines(&best.fit.parameters).into_iter().flatten().collect();
        let mut found = Vec::new();
        for other in pose::namings(self.geometry, &outlines, &spend) {
            let mut start = best.fit.parameters.clone();
            self.geometry.put(&other.pose, &mut start);
            found.extend(part.cleared(start, First::Mask(&best.hidden))?);
        }
        found.push(best);
        Ok(part.only(found).filter(is_named).map(|only| only.fit))
    }
}

impl Cleared {
    /// What is left is explained.
    fn is_fine(&self) -> bool {
        self.fit.worth.as_ref().and_then(|worth| worth.reduced).is_some_and(|reduced| reduced <= MISFIT)
    }

    /// And hardly anything is hidden.
    fn is_sure(&self) -> bool {
        self.is_fine() && self.fit.choice.is_some_and(|choice| choice.hidden < SURE)
    }
}

impl<'a> Veil<'a> {
    /// The one that explains most of the pixels that the spots of any of them have.
    fn best(&self, found: Vec<Cleared>) -> Option<Cleared> {
        let best = self.by_cost(found).into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, best)| best)
    }

    /// The same, where no other pose explains nearly as much.
    fn only(&self, found: Vec<Cleared>) -> Option<Cleared> {
        let mut found = self.by_cost(found);
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found = found.into_iter();
        let (least, best) = found.next()?;
        let is_other = |one: &Cleared| self.geometry.apart(&one.fit.parameters, &best.fit.parameters) > OTHER;
        let is_sure = !found.any(|(cost, one)| cost < least + UNDECIDED && is_other(&one));
        is_sure.then_some(best)
    }

    /// What each costs over the pixels that the spots of any of them have.
    fn by_cost(&self, found: Vec<Cleared>) -> Vec<(f64, Cleared)> {
        let mut region = vec![false; self.view.window.pixels()];
        for one in &found {
            for (pixel, _) in self.nearest(&one.fit.parameters, RIM) {
                region[pixel] = true;
            }
        }
        let costs = found.into_iter().filter_map(|one| {
            let seen = self.predictions.residuals(self.view, &one.fit.parameters, self.constants, Over::Everything)?;
            let inside = seen.iter().flat_map(|seen| &seen.residuals).filter(|residual| region[residual.pixel]);
            let cost: f64 = inside.map(|residual| residual.whitened.powi(2).min(SQUARE_MAX)).sum();
            Some((cost, one))
        });
        costs.collect()
    }

    /// The part of the picture that spots of any of these poses are in.
    fn part(&self, starts: &[Vec<f64>]) -> Option<View<'a>> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for ellipse in starts.iter().flat_map(|start| self.geometry.outlines(start)).flatten() {
            let determinant = ellipse[2] * ellipse[4] - ellipse[3] * ellipse[3];
            for (axis, a) in [ellipse[4], ellipse[2]].into_iter().enumerate() {
                let half = (REACH * a / determinant).sqrt() + 4.0;
                low[axis] = low[axis].min(ellipse[axis] - half);
                high[axis] = high[axis].max(ellipse[axis] + half);
            }
        }
        let window = self.view.window;
        let span = |first: usize, count: usize, low: f64, high: f64| {
            let (begin, end) = (first as f64, (first + count) as f64 - 1.0);
            let (low, high) = (low.floor().max(begin), high.ceil().min(end));
            (low <= high).then(|| (low as usize, (high - low) as usize + 1))
        };
        let (x, width) = span(window.x, window.width, low[0], high[0])?;
        let (y, height) = span(window.y, window.height, low[1], high[1])?;
        Some(self.view.narrowed(isophote_jit::Window { x, y, width, height, ..window }))
    }

    /// Pixels within a contour of a spot, with the nearest spot's number.
    fn nearest(&self, parameters: &[f64], rim: f64) -> Vec<(usize, usize)> {
        self.geometry.nearest(parameters, self.view.window, rim)
    }

    /// Goes on from a start; `None` where that leads to no fit, or leaves hardly anything.
    fn cleared(&self, mut parameters: Vec<f64>, first: First) -> Result<Option<Cleared>, CompileFailure> {
        let mut last: Option<(Fit, Vec<bool>)> = None;
        let model = self.kernels.model().clone();
        for (round, scale) in SCALES.into_iter().enumerate() {
            let mut hidden = vec![false; self.view.window.pixels()];
            match if round == 0 { first } else { First::Unexplained } {
                First::Mask(known) => {
                    light_up(&model, &mut parameters);
                    hidden.copy_from_slice(known);
                }
                First::Spot(spot) => {
                    let own = self.nearest(&parameters, REACH).into_iter().filter(|(_, nearest)| *nearest == spot);
                    own.for_each(|(pixel, _)| hidden[pixel] = true);
                }
                First::Unexplained => {
                    light_up(&model, &mut parameters);
                    let Some(residuals) = self.residuals(&parameters) else { return Ok(None) };
                    self.guess_brightness(&model, &residuals, &mut parameters);
                    let Some(residuals) = self.residuals(&parameters) else { return Ok(None) };
                    self.hide(&residuals, scale, &mut hidden);
                }
            }
            if let Some((_, before)) = &last
                && *before == hidden
            {
                break;
            }
            let painted = Painted::new(self.view, &hidden);
            let Some(view) = painted.view(self.view, self.kernels.precision()) else { return Ok(None) };
            let fitted = fit(self.kernels, &view, self.constants, &parameters, Control::Blind)?;
            if fitted.worth.as_ref().is_none_or(|worth| worth.covariance.is_none()) {
                return Ok(None);
            }
            parameters.clone_from(&fitted.parameters);
            last = Some((fitted, hidden));
        }
        let Some((mut fit, mask)) = last else { return Ok(None) };
        let inside = self.nearest(&fit.parameters, 1.0);
        let blind = inside.iter().filter(|(pixel, _)| mask[*pixel]).count();
        let share = blind as f64 / inside.len().max(1) as f64;
        if 1.0 - share < LEFT[usize::from(self.geometry.target.spots.len() == 1)] {
            return Ok(None);
        }
        fit.unused = self.unused(&inside, &mask);
        // One spot of several leaves the spin open.
        let spots = self.geometry.target.spots.len();
        if spots > 1 && spots < fit.unused.len() + 2 {
            return Ok(None);
        }
        // What does not shine may be elsewhere.
        let brightest = pose::brightest(&model, &fit.parameters);
        let shines = |light: usize| fit.parameters[light].abs() >= DARK * brightest;
        let is_seen = |spot: &usize| !fit.unused.contains(spot) && self.light(&model, *spot).is_none_or(shines);
        let seen = (0..spots).filter(is_seen).count();
        fit.choice = Some(Substitute { degree: 0, robust: false, hidden: share });
        Ok(Some(Cleared { fit, hidden: mask, seen }))
    }

    /// Spots of which hardly anything is left.
    fn unused(&self, inside: &[(usize, usize)], mask: &[bool]) -> Vec<usize> {
        let is_unused = |spot: &usize| {
            let own = inside.iter().filter(|(_, nearest)| nearest == spot);
            let left = own.clone().filter(|(pixel, _)| !mask[*pixel]).count();
            4 * left < own.count()
        };
        (0..self.geometry.target.spots.len()).filter(is_unused).collect()
    }

    fn residuals(&self, parameters: &[f64]) -> Option<Vec<Residual>> {
        let seen = self.predictions.residuals(self.view, parameters, self.constants, Over::Domain)?;
        Some(seen.into_iter().flat_map(|seen| seen.residuals).collect())
    }

    /// The brightness of each spot, where another one explains more of its pixels: most of a spot may be hidden, and a spot that was
    /// left out has none yet.
    fn guess_brightness(&self, model: &Model, residuals: &[Residual], parameters: &mut [f64]) {
        let Some(ground) = model.roles().iter().find_map(|roles| roles.background) else { return };
        let ground = parameters[ground.index()];
        let mut spot_of = vec![usize::MAX; self.view.window.pixels()];
        for (pixel, spot) in self.nearest(parameters, 1.0) {
            spot_of[pixel] = spot;
        }
        for number in 0..self.geometry.target.spots.len() {
            let Some(brightness) = self.light(model, number) else { continue };
            let now = parameters[brightness];
            let own: Vec<(f64, f64, f64)> = residuals
                .iter()
                .filter(|residual| spot_of[residual.pixel] == number && !residual.saturated)
                .map(|residual| (residual, (residual.predicted - ground) / now))
                .filter(|(residual, share)| *share > BRIGHT && residual.deviation.is_finite())
                .map(|(residual, share)| {
                    let light = residual.predicted - ground + residual.whitened * residual.deviation;
                    (light, share, residual.deviation)
                })
                .collect();
            let explained =
                |v: f64| own.iter().filter(|(light, share, sigma)| (light - v * share).abs() < 3.0 * sigma).count();
            let mut ratios: Vec<f64> = own.iter().map(|(light, share, _)| light / share).collect();
            ratios.sort_by(f64::total_cmp);
            let guesses = QUANTILES.iter().filter_map(|q| ratios.get((q * ratios.len() as f64) as usize));
            let most = guesses.clone().map(|guess| explained(*guess)).max().unwrap_or(0) as f64;
            // Darkness has no profile: what has the spot's own is the spot, though more of it be hidden.
            let best = guesses.copied().rev().find(|guess| explained(*guess) as f64 >= SHINING * most);
            if let Some(best) = best.filter(|best| explained(*best) as f64 > BETTER * explained(now) as f64) {
                parameters[brightness] = best.max(0.0);
            }
        }
    }

    /// The index of a spot's brightness.
    fn light(&self, model: &Model, spot: usize) -> Option<usize> {
        self.geometry.roles(model, spot)?.brightness.map(ParameterId::index)
    }

    /// Marks what is not of the pose: pixels whose residual is too large, then neighbourhoods whose mean is, of what is left.
    fn hide(&self, residuals: &[Residual], scale: f64, hidden: &mut [bool]) {
        let [width, height, ..] = self.view.window.size();
        for near in NEAR_PX {
            // Sums of all to the left and above, so that those of a neighbourhood are four of them.
            let (mut sums, mut counts) = (vec![0.0; (width + 1) * (height + 1)], vec![0.0; (width + 1) * (height + 1)]);
            for residual in residuals.iter().filter(|residual| !hidden[residual.pixel]) {
                let at = (residual.pixel / width + 1) * (width + 1) + residual.pixel % width + 1;
                (sums[at], counts[at]) = (residual.whitened / scale, 1.0);
            }
            for table in [&mut sums, &mut counts] {
                for y in 1..=height {
                    let mut row = 0.0;
                    for x in 1..=width {
                        row += table[y * (width + 1) + x];
                        table[y * (width + 1) + x] = row + table[(y - 1) * (width + 1) + x];
                    }
                }
            }
            let is_far = |residual: &&Residual| {
                let (x, y) = (residual.pixel % width, residual.pixel / width);
                let (left, right) = (x.saturating_sub(near), (x + near + 1).min(width));
                let (top, bottom) = (y.saturating_sub(near), (y + near + 1).min(height));
                let of = |table: &[f64]| {
                    let at = |x: usize, y: usize| table[y * (width + 1) + x];
                    at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)
                };
                of(&sums).abs() > OUTLIER * of(&counts).sqrt()
            };
            let seen = residuals.iter().filter(|residual| !hidden[residual.pixel]);
            let far: Vec<usize> = seen.filter(is_far).map(|residual| residual.pixel).collect();
            // Its edge covers pixels in part.
            far.into_iter().for_each(|pixel| hidden[pixel] = true);
            hidden.copy_from_slice(&dilated(hidden, width, height, 1));
        }
        // Glare dies away slowly: together the pixels around it show what none of them does.
        for _ in 0..RINGS {
            let wider = dilated(hidden, width, height, RING_PX);
            let ring = residuals.iter().filter(|residual| wider[residual.pixel] && !hidden[residual.pixel]);
            let (sum, count) = ring.fold((0.0, 0.0), |(sum, count), ring| (sum + ring.whitened / scale, count + 1.0));
            let deviations = sum / f64::sqrt(count).max(1.0);
            if (-RING_DARK..=RING_BRIGHT).contains(&deviations) {
                break;
            }
            hidden.copy_from_slice(&wider);
        }
    }
}

/// Gives spots that are dark the brightness of the brightest, so that it can be told what each pixel says about it.
fn light_up(model: &Model, parameters: &mut [f64]) {
    let brightest = pose::brightest(model, parameters);
    for index in pose::lights(model) {
        if parameters[index].abs() < DARK * brightest {
            parameters[index] = brightest;
        }
    }
}
