//! Shortcomings of a fit: residuals beyond noise, rivals, pixels that are not seen.
//!
//! Input: a fit, and how likely it is of the target. Output: [`Quality`]s. It never decides anything.

use isophote_jit::Window;

use super::ground::{SCATTER, freedom};
use super::judged::WHOLE;
use super::solver::{Attempt, Solver};
use super::window::share_inside;
use crate::estimate::{OUTLIERS, Quality};
use crate::solve::passes::Worth;
use crate::verdict::Verdict;

/// A definition: noise that is larger than stated by this share is reported.
const NOISIER: f64 = 0.1;
/// A definition: other things are reported when their odds are this share of its own.
const AMBIGUOUS: f64 = 0.1;

/// Of a fit in `whole`, beside such a verdict, where the noise of pixels is so many times what the model states.
pub(super) fn of(
    solver: &Solver,
    whole: Option<Window>,
    attempt: &Attempt,
    verdict: Option<&Verdict>,
    noise: Option<f64>,
) -> Vec<Quality> {
    let Some((fit, worth)) = attempt.fit.as_ref().and_then(|fit| Some((fit, fit.worth.as_ref()?))) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    found.extend(misfit(solver, worth, &fit.parameters, noise.unwrap_or(1.0)));
    if let Some(verdict) = verdict {
        found.extend((verdict.odds() < 1.0).then_some(Quality::RoughModel));
        let is_ambiguous = verdict.rivals() >= AMBIGUOUS * verdict.odds();
        found.extend(is_ambiguous.then_some(Quality::Ambiguous { place: verdict.rival() }));
    }
    found.extend((worth.saturated > 0.0).then_some(Quality::Saturated { share: worth.saturated }));
    let hidden = fit.choice.map_or(0.0, |choice| choice.hidden);
    found.extend((hidden > OUTLIERS).then_some(Quality::Covered { share: hidden }));
    let inside = whole.map_or(1.0, |whole| share_inside(solver.model(), &fit.parameters, whole));
    found.extend((inside < WHOLE).then_some(Quality::CutOff { share: 1.0 - inside }));
    let noisier = noise.filter(|noise| *noise > 1.0 + NOISIER);
    found.extend(noisier.map(|factor| Quality::Noisier { factor }));
    found
}

/// Of a model that states its noise.
fn misfit(solver: &Solver, worth: &Worth, parameters: &[f64], noise: f64) -> Option<Quality> {
    let reduced = worth.reduced.filter(|_| solver.model().has_noise())?;
    let freedom = freedom(solver, worth);
    let excess = reduced - noise * noise;
    let sigma = excess / (noise * noise * (2.0 / freedom).sqrt());
    if sigma.is_nan() || sigma < SCATTER {
        return None;
    }
    // F less χ² is the sum of the logarithms of variances: the geometric mean of pixels' standard deviations.
    let deviation = (0.5 * (worth.objective - reduced * freedom) / worth.pixels as f64).exp();
    let share = solver.looks(parameters).1.map(|brightness| excess.sqrt() * deviation / brightness.exp());
    Some(Quality::Misfit { sigma, share: share.filter(|share| share.is_finite()) })
}

impl Solver {
    /// Of the first target, px; absent in other than two dimensions.
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
    fn a_rough_model_of_a_lone_thing_is_tracked_and_called_rough() {
        let own = estimate(vec![spot(81.3, OWN)]);
        assert!(own.state == TrackState::Tracking && own.quality.is_empty() && own.candidate.is_none(), "{own:?}");
        let rough = estimate(vec![spot(81.3, Falloff::Disc)]);
        assert!(rough.state == TrackState::Tracking && rough.confidence.unwrap() < 0.5, "{rough:?}");
        assert!(rough.quality.contains(&Quality::RoughModel), "{rough:?}");
    }

    #[test]
    fn one_of_two_is_a_candidate_that_says_where_the_other_is() {
        let found = estimate(vec![spot(40.0, OWN), spot(120.0, OWN)]);
        let candidate = found.candidate.unwrap();
        assert_eq!((found.state, candidate.rejection), (TrackState::Searching, Rejection::OneOfSeveral));
        let place = candidate.quality.iter().find_map(|one| match one {
            Quality::Ambiguous { place } => *place,
            _ => None,
        });
        let apart = (place.unwrap()[0] - candidate.parameters[0]).abs();
        assert!((apart - 80.0).abs() < 1.0 && (candidate.confidence.unwrap() - 0.5).abs() < 0.1, "{candidate:?}");
    }

    #[test]
    fn a_thing_at_the_border_is_cut_off() {
        let cut = estimate(vec![spot(2.0, OWN)]);
        let share = cut.quality.iter().find_map(|one| match one {
            Quality::CutOff { share } => Some(*share),
            _ => None,
        });
        assert!((share.unwrap() - 0.4).abs() < 0.1, "{cut:?}");
    }
}
