//! How likely a fit is of the target, in a frame as a tracker sees it.
//!
//! Input: a fit, and the other things in the frame. Output: a [`Verdict`]. It never knows a track.

use super::candidate::is_about;
use super::solver::{Attempt, Look, Solver};
use super::window::{FARTHEST, share_inside};
use crate::estimate::Ending;
use crate::sight::cold::{Cold, Grain, Starts};
use crate::sight::view::View;
use crate::verdict::{FittedModel, Pictured, Signs, Verdict, signs};

/// A budget: things of a frame that are counted.
pub(super) const THINGS: usize = 24;
/// A definition: something else is as bright as a target when it has this share of its energy.
const COUNTED: f64 = 0.1;
/// A definition: with less inside, the border cuts a thing off.
pub(super) const WHOLE: f64 = 0.9;

/// Something that stands out by itself.
#[derive(Clone, Debug)]
pub(crate) struct Thing {
    /// Where a fit of it begins.
    start: Vec<f64>,
    /// The square of its height, times the area of the rectangle around it.
    energy: f64,
}

/// All that stands out, each once. A thing that the border of a given window cuts off belongs to what the window leaves out.
#[derive(Clone, Debug, Default)]
pub(crate) struct Things {
    all: Vec<Thing>,
    /// ln of the least value that is saturated.
    limit: f64,
}

impl Things {
    pub fn add(&mut self, solver: &Solver, look: &Look, view: &View, sights: &[Starts]) {
        self.limit = view.saturation.iter().copied().fold(f64::INFINITY, f64::min).ln();
        let thing = |one: &Starts| Some(Thing { start: one.starts.first()?.clone(), energy: one.energy? });
        let is_whole = |thing: &Thing| share_inside(solver.model(), &thing.start, look.window) >= WHOLE;
        let is_counted = |thing: &Thing| solver.options.window.is_none() || is_whole(thing);
        for thing in sights.iter().filter_map(thing).filter(is_counted) {
            if !self.all.iter().any(|known| is_about(solver, &known.start, &thing.start)) {
                self.all.push(thing);
            }
        }
    }

    /// How many are as bright as something with these parameters, as far as that can be seen, beyond the targets that are wanted.
    pub fn beside(&self, solver: &Solver, parameters: &[f64]) -> f64 {
        let energy = self.energy(solver, parameters);
        let is_bright = |thing: &Thing| energy.is_none_or(|energy| thing.energy >= COUNTED * energy);
        let is_beside = |thing: &&Thing| !is_about(solver, parameters, &thing.start) && is_bright(thing);
        self.all.iter().filter(is_beside).count().saturating_sub(solver.options.targets - 1) as f64
    }

    /// True for something that is as bright as something else, as far as that can be seen.
    pub fn is_rival(&self, solver: &Solver, rival: &[f64], other: &[f64]) -> bool {
        let both = self.energy(solver, rival).zip(self.energy(solver, other));
        both.is_none_or(|(rival, other)| rival >= COUNTED * other)
    }

    /// Of something with these parameters, as far as it can be seen.
    fn energy(&self, solver: &Solver, parameters: &[f64]) -> Option<f64> {
        let (area, brightness) = solver.looks(parameters);
        area.zip(brightness).map(|(area, brightness)| 4.0 * (area + 2.0 * brightness.min(self.limit)).exp())
    }
}

impl Solver {
    /// How likely a fit is of the target, beside so many other things; `None` where that cannot be told.
    pub fn verdict(&self, look: &Look, attempt: &Attempt, others: f64) -> Option<Verdict> {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good())?;
        let degree = fit.choice.map_or(0, |choice| choice.degree);
        Some(Verdict::of(&self.signs(look, others, &fit.parameters, (degree, attempt.ending))?))
    }

    /// Of a fit with these parameters, a polynomial of that degree beside it, and that ending.
    pub fn signs(
        &self,
        look: &Look,
        others: f64,
        parameters: &[f64],
        (degree, ending): (u32, Ending),
    ) -> Option<Signs> {
        let pictured = Pictured {
            model: self.model(),
            constants: &self.constants,
            predictions: self.compiled.predictions()?,
            reach: self.reach.outlines().unwrap_or(FARTHEST),
            whole: look.window,
            others,
            view: &|window| self.view(look, window),
        };
        let free: Vec<usize> = self.compiled.last_parameters().iter().map(|parameter| parameter.index()).collect();
        let fitted = FittedModel { parameters, free: &free, is_converged: ending.is_converged(), degree };
        signs(&pictured, &fitted)
    }

    /// Everything in a frame that stands out by itself.
    pub fn things(&self, look: &Look) -> Things {
        let (model, view) = (self.model(), self.view(look, look.window));
        let given = vec![None; model.parameters().len()];
        let found = Cold::look(model, &view, &self.constants, &given, THINGS, Vec::new(), Grain::Full);
        let mut things = Things::default();
        found.iter().for_each(|found| things.add(self, look, &view, &found.sights));
        things
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

    /// Of a fit of the document to one spot of 12 px that is as it says, or an even disc.
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
    fn a_targets_own_profile_speaks_for_it_and_another_one_against_it() {
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
