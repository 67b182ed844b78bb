//! The shortcomings of a fit, as [`Quality`] values: residuals beyond noise, rivals, pixels that are not seen. It
//! decides nothing.

use isophote_jit::Window;

use super::noise::NoiseLevel;
use super::pixel_statistics::{SCATTER, freedom};
use super::solver::{Attempt, Solver};
use super::verdicts::WHOLE;
use super::window::share_inside;
use crate::estimate::{OUTLIERS, Quality};
use crate::solve::passes::FitSummary;
use crate::verdict::Verdict;

/// A definition: noise that exceeds the stated noise by this share is reported.
const NOISIER: f64 = 0.1;
/// A definition: noise whose variance is less than this share of the stated one is reported.
const QUIETER: f64 = 0.1;
/// A definition: rivals are reported when their odds are this share of the target's own.
const AMBIGUOUS: f64 = 0.1;

/// The shortcomings of a fit in `usable_window`; `noise`: of the track's pixels.
pub(super) fn of(
    solver: &Solver,
    usable_window: Option<Window>,
    attempt: &Attempt,
    verdict: Option<&Verdict>,
    noise: NoiseLevel,
) -> Vec<Quality> {
    let Some((fit, summary)) = attempt.fit.as_ref().and_then(|fit| Some((fit, fit.summary.as_ref()?))) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    found.extend(misfit(solver, summary, &fit.parameters, noise.ratio().unwrap_or(1.0)));
    if let Some(verdict) = verdict {
        found.extend((verdict.odds() < 1.0).then_some(Quality::RoughModel));
        let is_ambiguous = verdict.rivals() >= AMBIGUOUS * verdict.odds();
        found.extend(is_ambiguous.then_some(Quality::Ambiguous { place: verdict.rival() }));
    }
    found.extend((summary.saturated > 0.0).then_some(Quality::Saturated { share: summary.saturated }));
    let hidden = fit.choice.map_or(0.0, |choice| choice.hidden);
    found.extend((hidden > OUTLIERS).then_some(Quality::Covered { share: hidden }));
    let inside =
        usable_window.map_or(1.0, |usable_window| share_inside(solver.model(), &fit.parameters, usable_window));
    found.extend((inside < WHOLE).then_some(Quality::CutOff { share: 1.0 - inside }));
    let noisier = noise.ratio().filter(|noise| *noise > 1.0 + NOISIER);
    found.extend(noisier.map(|factor| Quality::Noisier { factor }));
    let quieter = noise.measured().filter(|noise| noise * noise < QUIETER);
    found.extend(quieter.map(|factor| Quality::Quieter { factor }));
    found
}

/// The misfit of a model that states its noise.
fn misfit(solver: &Solver, summary: &FitSummary, parameters: &[f64], noise: f64) -> Option<Quality> {
    let reduced = summary.reduced_chi_square.filter(|_| solver.model().has_noise())?;
    let freedom = freedom(solver, summary);
    let excess = reduced - noise * noise;
    let sigma = excess / (noise * noise * (2.0 / freedom).sqrt());
    if sigma.is_nan() || sigma < SCATTER {
        return None;
    }
    // F less χ² is the sum of the logarithms of variances: the geometric mean of pixels' standard deviations.
    let deviation = (0.5 * (summary.objective - reduced * freedom) / summary.pixels as f64).exp();
    let share =
        solver.ln_size_and_brightness(parameters).1.map(|brightness| excess.sqrt() * deviation / brightness.exp());
    Some(Quality::Misfit { sigma, share: share.filter(|share| share.is_finite()) })
}

impl Solver {
    /// Centre of the first target, px; `None` in other than two dimensions.
    pub fn centre(&self, parameters: &[f64]) -> Option<[f64; 2]> {
        let [x, y] = self.model().roles().first()?.centre[..] else { return None };
        Some([parameters[x.index()], parameters[y.index()]])
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use isophote_symbolic::{Model, Precision};

    use crate::picture::{Falloff, Spot, TestPicture};
    use crate::solve::compiled::Compiled;
    use crate::{Estimate, Quality, Rejection, TrackState, Tracker, TrackerOptions};

    /// The first estimate of `plain-spot.toml` in a picture of these spots.
    fn estimate(spots: Vec<Spot>) -> Estimate {
        let text = include_str!("../../../tests/documents/plain-spot.toml");
        let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap());
        let frame = TestPicture { noise: 1.5, ..TestPicture::new(160, 120, spots) }.frame();
        Tracker::new(compiled, TrackerOptions::default()).unwrap().track(&frame)
    }

    fn spot(x: f64, profile: Falloff) -> Spot {
        Spot { profile, ..Spot::at(x, 58.7, 12.0, 120.0) }
    }

    const OWN: Falloff = Falloff::Cubic(-0.5, -0.3);

    #[test]
    fn a_rough_model_of_a_lone_object_is_tracked_and_reported() {
        let own = estimate(vec![spot(81.3, OWN)]);
        assert!(own.state == TrackState::Tracking && own.quality.is_empty() && own.candidate.is_none(), "{own:?}");
        let rough = estimate(vec![spot(81.3, Falloff::Disc)]);
        assert!(rough.state == TrackState::Tracking && rough.confidence.unwrap() < 0.5, "{rough:?}");
        assert!(rough.quality.contains(&Quality::RoughModel), "{rough:?}");
    }

    #[test]
    fn noise_that_is_stated_too_large_is_reported() {
        let text = include_str!("../../../tests/documents/plain-spot.toml");
        let factor = |variance: f64| {
            let text = text.replace("saturated  =", &format!("noise = \"{variance}\"\nsaturated  ="));
            let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap());
            let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
            let estimates = (1..=12).map(|seed| {
                let picture = TestPicture { noise: 1.0, seed, ..TestPicture::new(160, 120, vec![spot(81.3, OWN)]) };
                tracker.track(&picture.frame())
            });
            estimates.last().unwrap().quality.into_iter().find_map(|one| match one {
                Quality::Quieter { factor } => Some(factor),
                _ => None,
            })
        };
        assert_eq!(factor(1.0), None);
        assert!((factor(64.0).unwrap() - 0.13).abs() < 0.02, "{:?}", factor(64.0));
    }

    #[test]
    fn an_ambiguous_candidate_reports_its_rivals_position() {
        let found = estimate(vec![spot(40.0, OWN), spot(120.0, OWN)]);
        let candidate = found.candidate.unwrap();
        assert_eq!((found.state, candidate.rejection), (TrackState::Searching, Rejection::OneOfSeveral));
        let position = candidate.quality.iter().find_map(|one| match one {
            Quality::Ambiguous { place } => *place,
            _ => None,
        });
        let apart = (position.unwrap()[0] - candidate.parameters[0]).abs();
        assert!((apart - 80.0).abs() < 1.0 && (candidate.confidence.unwrap() - 0.5).abs() < 0.1, "{candidate:?}");
    }

    #[test]
    fn an_object_at_the_border_is_reported_as_cut_off() {
        let cut = estimate(vec![spot(2.0, OWN)]);
        let share = cut.quality.iter().find_map(|one| match one {
            Quality::CutOff { share } => Some(*share),
            _ => None,
        });
        assert!((share.unwrap() - 0.4).abs() < 0.1, "{cut:?}");
    }
}
