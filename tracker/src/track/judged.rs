//! The signs of a fit, of a frame as a tracker sees it.

use super::candidate::is_about;
use super::solver::{Look, Solver};
use super::window::FARTHEST;
use crate::sight::cold::{Cold, Grain};
use crate::verdict::{FittedModel, Pictured, Signs, signs};

/// A budget: things of a frame that are counted.
const THINGS: usize = 24;
/// Definition: what has less of a target's energy is not counted.
const COUNTED: f64 = 0.1;

/// Something that stands out by itself.
pub(crate) struct Thing {
    /// Where a fit of it begins.
    start: Vec<f64>,
    /// The square of its height, times the area of the rectangle around it.
    energy: f64,
}

impl Solver {
    /// Of a fit with these parameters, and a polynomial of that degree beside it.
    pub fn signs(&self, look: &Look, things: &[Thing], parameters: &[f64], degree: u32) -> Option<Signs> {
        let subject = Pictured {
            model: self.model(),
            constants: &self.constants,
            predictions: self.compiled.predictions()?,
            reach: self.reach.outlines().unwrap_or(FARTHEST),
            whole: look.window,
            view: &|window| self.view(look, window),
        };
        let free: Vec<usize> = self.compiled.last_parameters().iter().map(|parameter| parameter.index()).collect();
        let own = signs(&subject, &FittedModel { parameters, free: &free, degree })?;
        let (area, brightness) = self.looks(parameters);
        let energy = area.zip(brightness).map(|(area, brightness)| 4.0 * (area + 2.0 * brightness).exp());
        let is_other = |thing: &&Thing| match is_about(self, parameters, &thing.start) {
            true => energy.is_some_and(|energy| COUNTED * thing.energy > energy),
            false => energy.is_none_or(|energy| thing.energy >= COUNTED * energy),
        };
        Some(Signs { others: things.iter().filter(is_other).count() as f64, ..own })
    }

    /// What stands out in a frame by itself.
    pub fn things(&self, look: &Look) -> Vec<Thing> {
        let (model, view) = (self.model(), self.view(look, look.window));
        let given = vec![None; model.parameters().len()];
        let found = Cold::look(model, &view, &self.constants, &given, THINGS, Vec::new(), Grain::Full);
        let thing =
            |one: &crate::sight::cold::Starts| Some(Thing { start: one.starts.first()?.clone(), energy: one.energy? });
        found.map(|found| found.sights.iter().filter_map(thing).collect()).unwrap_or_default()
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
        assert!(own.cut_off == 0.0 && own.saturated == 0.0 && own.covered < 0.02, "{own:?}");
    }

    #[test]
    fn a_target_at_the_border_is_cut_off() {
        let cut_off = signs(-0.5, Falloff::Cubic(-0.5, -0.3)).cut_off;
        assert!((cut_off - 0.5).abs() < 0.05, "{cut_off}");
    }
}
