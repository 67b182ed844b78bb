//! Verdicts of fits: the likelihood of the target among the other objects in the frame.

use super::candidate::is_about;
use super::solver::{Attempt, FrameContext, Solver};
use super::window::{FARTHEST, share_inside};
use crate::estimate::Ending;
use crate::sight::cold::{CandidateStarts, ColdStarts, Resolution};
use crate::sight::view::View;
use crate::verdict::{FittedModel, Signs, Surroundings, Verdict, VerdictContext, signs};

/// A budget: objects that are counted in a frame, of those that stand out and of those that a filter detects, for one target.
const OBJECTS_MAX: [usize; 2] = [24, 12];
/// A budget: objects that are counted for each of many targets.
const OBJECTS_PER_TARGET: usize = 2;
/// A definition: an object with this share of a target's energy is as bright as the target.
const COUNTED: f64 = 0.1;
/// A definition: an object with a smaller share inside is cut off by the border.
pub(super) const WHOLE: f64 = 0.9;

/// An object that stands out by itself.
#[derive(Clone, Debug)]
pub(crate) struct SceneObject {
    /// Start of its fit.
    start: Vec<f64>,
    /// The square of its height times the area of its bounding rectangle.
    energy: f64,
}

/// All objects that stand out, without duplicates, and without those that the border of a given window cuts off.
#[derive(Clone, Debug, Default)]
pub(crate) struct SceneObjects {
    all: Vec<SceneObject>,
    /// ln of the lowest saturation.
    limit: f64,
}

impl SceneObjects {
    pub fn add(&mut self, solver: &Solver, context: &FrameContext, view: &View, candidates: &[CandidateStarts]) {
        self.limit = view.saturation.iter().copied().fold(f64::INFINITY, f64::min).ln();
        let object =
            |one: &CandidateStarts| Some(SceneObject { start: one.starts.first()?.clone(), energy: one.energy? });
        let is_whole = |object: &SceneObject| share_inside(solver.model(), &object.start, context.window) >= WHOLE;
        let is_counted = |object: &SceneObject| solver.options.window.is_none() || is_whole(object);
        for object in candidates.iter().filter_map(object).filter(is_counted) {
            if !self.all.iter().any(|known| is_about(solver, &known.start, &object.start)) {
                self.all.push(object);
            }
        }
    }

    /// The objects around one with these parameters; all others count where its energy is unknown.
    pub fn around(&self, solver: &Solver, parameters: &[f64]) -> Surroundings {
        let energy = self.energy(solver, parameters);
        let is_bright = |object: &SceneObject| energy.is_none_or(|energy| object.energy >= COUNTED * energy);
        let is_other = |object: &&SceneObject| !is_about(solver, parameters, &object.start) && is_bright(object);
        let others = self.all.iter().filter(is_other).count().saturating_sub(solver.options.targets - 1) as f64;
        let several = self.all.iter().filter(|_| solver.options.targets > 1);
        Surroundings { others, targets: several.filter_map(|object| solver.centre(&object.start)).collect() }
    }

    /// True when `rival` is as bright as `other`, or one of the energies is unknown.
    pub fn is_rival(&self, solver: &Solver, rival: &[f64], other: &[f64]) -> bool {
        let both = self.energy(solver, rival).zip(self.energy(solver, other));
        both.is_none_or(|(rival, other)| rival >= COUNTED * other)
    }

    /// The energy of an object with these parameters, up to saturation.
    fn energy(&self, solver: &Solver, parameters: &[f64]) -> Option<f64> {
        let (area, brightness) = solver.ln_size_and_brightness(parameters);
        area.zip(brightness).map(|(area, brightness)| 4.0 * (area + 2.0 * brightness.min(self.limit)).exp())
    }
}

impl Solver {
    /// The verdict on a fit with these objects around it, where no least SNR takes its place; `None` where the model or the fit allows none.
    pub fn verdict(&self, context: &FrameContext, attempt: &Attempt, around: &Surroundings) -> Option<Verdict> {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good() && self.options.snr_min.is_none())?;
        let degree = fit.choice.map_or(0, |choice| choice.degree);
        Some(Verdict::of(&self.signs(context, around, &fit.parameters, (degree, attempt.ending))?))
    }

    /// The signs of a fit with these parameters, a background polynomial of this degree, and this ending.
    pub fn signs(
        &self,
        context: &FrameContext,
        surroundings: &Surroundings,
        parameters: &[f64],
        (degree, ending): (u32, Ending),
    ) -> Option<Signs> {
        let pictured = VerdictContext {
            model: self.model(),
            constants: &self.constants,
            predictions: self.compiled.predictions()?,
            reach: self.reach.outlines().unwrap_or(FARTHEST),
            region: context.window,
            surroundings,
            view: &|window| self.view(context, window),
        };
        let free: Vec<usize> = self.compiled.last_parameters().iter().map(|parameter| parameter.index()).collect();
        let fitted = FittedModel { parameters, free: &free, is_converged: ending.is_converged(), degree };
        signs(&pictured, &fitted)
    }

    /// The largest number of objects that a search fits, of those that stand out and of those that a filter detects.
    pub fn objects_max(&self) -> [usize; 2] {
        OBJECTS_MAX.map(|most| most.max(OBJECTS_PER_TARGET * self.options.targets))
    }

    /// All objects in a frame that stand out by themselves.
    pub fn objects(&self, context: &FrameContext) -> SceneObjects {
        let (model, view) = (self.model(), self.view(context, context.window));
        let given = vec![None; model.parameters().len()];
        let [most, _] = self.objects_max();
        let found = ColdStarts::search(model, &view, &self.constants, &given, most, Vec::new(), Resolution::Full);
        let mut objects = SceneObjects::default();
        found.iter().for_each(|found| objects.add(self, context, &view, &found.candidates));
        objects
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use isophote_symbolic::{Model, Precision};

    use crate::picture::{Falloff, Spot, TestPicture};
    use crate::solve::compiled::Compiled;
    use crate::verdict::Signs;
    use crate::{Tracker, TrackerOptions};

    /// The signs of a fit to one spot of 12 px with `profile`: the document's own, or an even disc.
    fn signs(x: f64, profile: Falloff) -> Signs {
        let text = include_str!("../../../tests/documents/plain-spot.toml");
        let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap());
        let frame = TestPicture {
            noise: 1.5,
            ..TestPicture::new(160, 120, vec![Spot { profile, ..Spot::at(x, 58.7, 12.0, 120.0) }])
        }
        .frame();
        let options = TrackerOptions { confidence_min: 0.0, ..TrackerOptions::default() };
        let mut tracker = Tracker::new(compiled, options).unwrap();
        let estimate = tracker.track(&frame);
        tracker.signs(&frame, &estimate).unwrap()
    }

    #[test]
    fn evidence_is_positive_for_the_own_profile_and_negative_for_another() {
        let (own, other) = (signs(81.3, Falloff::Cubic(-0.5, -0.3)), signs(81.3, Falloff::Disc));
        assert!(own.evidence > 3.0 && other.evidence < -3.0, "{own:?} {other:?}");
        assert!(own.cut_off == 0.0 && own.covered < 0.02, "{own:?}");
    }

    #[test]
    fn a_target_at_the_border_is_cut_off() {
        let cut_off = signs(-0.5, Falloff::Cubic(-0.5, -0.3)).cut_off;
        assert!((cut_off - 0.5).abs() < 0.05, "{cut_off}");
    }
}
