//! Occlusion of a pose's picture, as by a hand before a spot or glare beside it: masks the pixels that the pose does not
//! explain, and fits the rest again.
//!
//! The occlusion shows once the pose is nearly known, and the pose once the occlusion is known. So several starts are
//! tried: the predicted pose, the result of the plain fit, and, as the other spots suffice for a pose, that fit once
//! without each of the spots. Each iterates by itself: mask the occlusion, fit the rest. The fit that explains most of all
//! spots' pixels wins.

use isophote_symbolic::{Model, ParameterId};

use super::backgrounds::MISFIT;
use super::nan_masked::{NanMasked, dilated};
use crate::estimate::Substitute;
use crate::pose::{self, Five, Geometry};
use crate::sight::view::View;
use crate::solve::fit::{Fit, fit};
use crate::solve::passes::SQUARE_MAX;
use crate::solve::residuals::{OUTLIER, Over, Predictions, Residual};
use crate::solve::stage_kernels::{CompileFailure, PixelHandling, StageKernels};

/// The inputs of a fit of a partly hidden pose.
pub(crate) struct OcclusionFit<'a> {
    pub kernels: &'a StageKernels,
    pub predictions: &'a Predictions,
    pub view: &'a View<'a>,
    pub constants: &'a [f64],
    pub geometry: &'a Geometry,
    pub names: SpotNames,
}

/// Whether the assignment of spots is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SpotNames {
    /// The target was seen before.
    Known,
    /// It was found in this picture.
    Guessed,
}

/// The first mask.
#[derive(Clone, Copy)]
enum InitialMask<'a> {
    /// Pixels that the start does not explain.
    Unexplained,
    /// The pixels of one spot.
    Spot(usize),
    /// These pixels.
    Mask(&'a [bool]),
}

/// A fit with its mask.
struct MaskedFit {
    fit: Fit,
    hidden: Vec<bool>,
    /// Number of spots that contribute to the pose.
    seen: usize,
}

/// Factor on the residuals' deviations, by round.
const SCALES: [f64; 4] = [3.0, 1.5, 1.0, 1.0];
/// Half-widths of neighbourhoods, px: an occlusion begins sharply, glare decays slowly.
const NEAR_PX: [usize; 3] = [0, 2, 7];
/// Smallest visible share of the spots' pixels, for several spots and for one.
const VISIBLE_MIN: [f64; 2] = [0.4, 0.62];
/// Width of a ring around the mask, px.
const RING_PX: usize = 3;
/// Most rings around the mask.
const RINGS: usize = 12;
/// A ring joins the mask if its mean is too low by more than this many standard deviations.
const RING_DARK: f64 = 3.0;
/// A ring joins the mask if its mean is too high by more than this many standard deviations: a cover has an edge, glare has
/// none.
const RING_BRIGHT: f64 = 2.0;
/// Spots of equal appearance that determine their names by position.
const NAMED: usize = 3;
/// A good fit that masks less than this share needs no alternatives.
const SURE: f64 = 0.35;
/// Poses farther apart than this are different, rad.
const OTHER: f64 = 0.1;
/// Two poses are ambiguous if their costs differ by less than this.
const UNDECIDED: f64 = 50.0;
/// s at which a spot ends.
const RIM: f64 = 1.2;
/// The part of the picture used, as a multiple of s.
const REACH: f64 = 2.6;
/// A brightness is estimated from pixels at least this bright, as a share of the brightest.
const BRIGHT: f64 = 0.2;
/// Quantiles of the brightness estimates of single pixels.
const QUANTILES: [f64; 5] = [0.1, 0.25, 0.5, 0.75, 0.9];
/// A spot below this share of the brightest one's brightness is dark.
const DARK: f64 = 0.05;
/// The largest brightness is chosen that explains at least this share of the pixels that the best one does.
const SHINING: f64 = 0.45;
/// Another brightness must explain this many times as many pixels.
const BETTER: f64 = 1.1;

impl OcclusionFit<'_> {
    /// The best fit over all starts; `None` where hardly anything is visible in any, or where the best pose is ambiguous.
    pub fn best_fit(&self, starts: &[Vec<f64>]) -> Result<Option<Fit>, CompileFailure> {
        // For a single spot nothing beside it shows how much of it is hidden.
        if self.names == SpotNames::Guessed && self.geometry.target.spots.len() < 2 {
            return Ok(None);
        }
        let Some(view) = self.part(starts) else { return Ok(None) };
        let part = OcclusionFit { view: &view, ..*self };
        let mut found: Vec<MaskedFit> = Vec::new();
        for start in starts {
            found.extend(part.masked_fit(start.clone(), InitialMask::Unexplained)?);
            // The predicted pose explains the rest: nothing about the spots is open.
            if self.names == SpotNames::Known && found.iter().any(MaskedFit::is_sure) {
                break;
            }
        }
        let spots = self.geometry.target.spots.len();
        if let Some(start) = starts.last().filter(|_| spots > 1 && !found.iter().any(MaskedFit::is_sure)) {
            for spot in 0..spots {
                found.extend(part.masked_fit(start.clone(), InitialMask::Spot(spot))?);
            }
        }
        let Some(best) = part.best(found) else { return Ok(None) };
        if self.names == SpotNames::Known || spots < 2 {
            return Ok(Some(best.fit));
        }
        // Two spots of equal appearance have the same picture with their names exchanged.
        let is_named = |one: &MaskedFit| self.kernels.model().entries() > 1 || one.seen >= NAMED.min(spots);
        // The assignment was found together with the mask: with the mask known, the other assignments are tried.
        let spend = |units: u64| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let outlines: Vec<Five> = self.geometry.outlines(&best.fit.parameters).into_iter().flatten().collect();
        let mut found = Vec::new();
        for other in pose::namings(self.geometry, &outlines, &spend) {
            let mut start = best.fit.parameters.clone();
            self.geometry.put(&other.pose, &mut start);
            found.extend(part.masked_fit(start, InitialMask::Mask(&best.hidden))?);
        }
        found.push(best);
        Ok(part.only(found).filter(is_named).map(|only| only.fit))
    }
}

impl MaskedFit {
    /// The visible pixels are explained.
    fn is_fine(&self) -> bool {
        self.fit
            .summary
            .as_ref()
            .and_then(|summary| summary.reduced_chi_square)
            .is_some_and(|reduced| reduced <= MISFIT)
    }

    /// The visible pixels are explained, and little is masked.
    fn is_sure(&self) -> bool {
        self.is_fine() && self.fit.choice.is_some_and(|choice| choice.hidden < SURE)
    }
}

impl<'a> OcclusionFit<'a> {
    /// The fit of least cost over the pixels of any fit's spots.
    fn best(&self, found: Vec<MaskedFit>) -> Option<MaskedFit> {
        let best = self.by_cost(found).into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, best)| best)
    }

    /// The fit of least cost, unless a different pose costs nearly as little.
    fn only(&self, found: Vec<MaskedFit>) -> Option<MaskedFit> {
        let mut found = self.by_cost(found);
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found = found.into_iter();
        let (least, best) = found.next()?;
        let is_other = |one: &MaskedFit| self.geometry.apart(&one.fit.parameters, &best.fit.parameters) > OTHER;
        let is_sure = !found.any(|(cost, one)| cost < least + UNDECIDED && is_other(&one));
        is_sure.then_some(best)
    }

    /// The cost of each over the pixels of any fit's spots.
    fn by_cost(&self, found: Vec<MaskedFit>) -> Vec<(f64, MaskedFit)> {
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

    /// The part of the picture with the spots of any of these poses.
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
            let (first_edge, end) = (first as f64, (first + count) as f64 - 1.0);
            let (low, high) = (low.floor().max(first_edge), high.ceil().min(end));
            (low <= high).then(|| (low as usize, (high - low) as usize + 1))
        };
        let (x, width) = span(window.x, window.width, low[0], high[0])?;
        let (y, height) = span(window.y, window.height, low[1], high[1])?;
        Some(self.view.narrowed(isophote_jit::Window { x, y, width, height, ..window }))
    }

    /// Pixels within a contour of a spot, with the nearest spot's index.
    fn nearest(&self, parameters: &[f64], rim: f64) -> Vec<(usize, usize)> {
        self.geometry.nearest(parameters, self.view.window, rim)
    }

    /// Iterates from a start; `None` where that fails, or leaves hardly any pixels.
    fn masked_fit(&self, mut parameters: Vec<f64>, first: InitialMask) -> Result<Option<MaskedFit>, CompileFailure> {
        let mut last: Option<(Fit, Vec<bool>)> = None;
        let model = self.kernels.model().clone();
        for (round, scale) in SCALES.into_iter().enumerate() {
            let mut hidden = vec![false; self.view.window.pixels()];
            match if round == 0 { first } else { InitialMask::Unexplained } {
                InitialMask::Mask(known) => {
                    brighten_dark_spots(&model, &mut parameters);
                    hidden.copy_from_slice(known);
                }
                InitialMask::Spot(spot) => {
                    let own = self.nearest(&parameters, REACH).into_iter().filter(|(_, nearest)| *nearest == spot);
                    own.for_each(|(pixel, _)| hidden[pixel] = true);
                }
                InitialMask::Unexplained => {
                    brighten_dark_spots(&model, &mut parameters);
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
            let nan_masked = NanMasked::new(self.view, &hidden);
            let Some(view) = nan_masked.view(self.view, self.kernels.precision()) else { return Ok(None) };
            let fitted = fit(self.kernels, &view, self.constants, &parameters, PixelHandling::SkipInvalid)?;
            if fitted.summary.as_ref().is_none_or(|summary| summary.covariance.is_none()) {
                return Ok(None);
            }
            parameters.clone_from(&fitted.parameters);
            last = Some((fitted, hidden));
        }
        let Some((mut fit, mask)) = last else { return Ok(None) };
        let inside = self.nearest(&fit.parameters, 1.0);
        let blind = inside.iter().filter(|(pixel, _)| mask[*pixel]).count();
        let share = blind as f64 / inside.len().max(1) as f64;
        if 1.0 - share < VISIBLE_MIN[usize::from(self.geometry.target.spots.len() == 1)] {
            return Ok(None);
        }
        fit.unused = self.unused(&inside, &mask);
        // A single visible spot of several leaves the rotation undetermined.
        let spots = self.geometry.target.spots.len();
        if spots > 1 && spots < fit.unused.len() + 2 {
            return Ok(None);
        }
        // A dark spot may be elsewhere.
        let brightest = pose::brightest(&model, &fit.parameters);
        let shines = |light: usize| fit.parameters[light].abs() >= DARK * brightest;
        let is_seen = |spot: &usize| !fit.unused.contains(spot) && self.light(&model, *spot).is_none_or(shines);
        let seen = (0..spots).filter(is_seen).count();
        fit.choice = Some(Substitute { degree: 0, robust: false, hidden: share });
        Ok(Some(MaskedFit { fit, hidden: mask, seen }))
    }

    /// Spots of which hardly any pixel is visible.
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

    /// Re-estimates the brightness of each spot where another value explains more of its pixels: most of a spot may be
    /// hidden, and a spot left out so far has no estimate.
    fn guess_brightness(&self, model: &Model, residuals: &[Residual], parameters: &mut [f64]) {
        let Some(background) = model.roles().iter().find_map(|roles| roles.background) else { return };
        let background = parameters[background.index()];
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
                .map(|residual| (residual, (residual.predicted - background) / now))
                .filter(|(residual, share)| *share > BRIGHT && residual.deviation.is_finite())
                .map(|(residual, share)| {
                    let light = residual.predicted - background + residual.whitened * residual.deviation;
                    (light, share, residual.deviation)
                })
                .collect();
            let explained =
                |v: f64| own.iter().filter(|(light, share, sigma)| (light - v * share).abs() < 3.0 * sigma).count();
            let mut ratios: Vec<f64> = own.iter().map(|(light, share, _)| light / share).collect();
            ratios.sort_by(f64::total_cmp);
            let guesses = QUANTILES.iter().filter_map(|q| ratios.get((q * ratios.len() as f64) as usize));
            let most = guesses.clone().map(|guess| explained(*guess)).max().unwrap_or(0) as f64;
            // An occlusion lacks the spot's profile: pixels that follow it are the spot, even if most of it is hidden.
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

    /// Masks pixels with large residuals, then neighbourhoods of the rest with a large mean.
    fn hide(&self, residuals: &[Residual], scale: f64, hidden: &mut [bool]) {
        let [width, height, ..] = self.view.window.size();
        for near in NEAR_PX {
            // Summed-area tables: the sum over a neighbourhood is four entries.
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
            // The edge of an occlusion covers pixels in part.
            far.into_iter().for_each(|pixel| hidden[pixel] = true);
            hidden.copy_from_slice(&dilated(hidden, width, height, 1));
        }
        // Glare decays slowly: the mean of the pixels around it is significant where no single one is.
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

/// Gives dark spots the brightness of the brightest, so that each pixel yields an estimate.
fn brighten_dark_spots(model: &Model, parameters: &mut [f64]) {
    let brightest = pose::brightest(model, parameters);
    for index in pose::lights(model) {
        if parameters[index].abs() < DARK * brightest {
            parameters[index] = brightest;
        }
    }
}
