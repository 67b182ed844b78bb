//! The signs of a fit, of a frame as a tracker sees it.

use super::peers::{self, Outstanding};
use super::solver::{Look, Solver};
use super::window::FARTHEST;
use crate::sight::cold::{Cold, Grain};
use crate::verdict::{FittedModel, Pictured, Signs, signs};

/// A budget: things of a frame that are counted.
const THINGS: usize = 24;
/// A definition: another thing counts from this share of the target's energy on.
const COUNTED: f64 = 0.1;

impl Solver {
    /// Of a fit with these parameters, and a polynomial of that degree beside it.
    pub(super) fn signs(&self, look: &Look, things: &[Outstanding], parameters: &[f64], degree: u32) -> Option<Signs> {
        let subject = Pictured {
            model: self.model(),
            constants: &self.constants,
            predictions: self.compiled.predictions()?,
            reach: self.reach.outlines().unwrap_or(FARTHEST),
            whole: look.window,
            others: peers::beside(self, parameters, things, COUNTED).count() as f64,
            view: &|window| self.view(look, window),
        };
        let free: Vec<usize> = self.compiled.last_parameters().iter().map(|parameter| parameter.index()).collect();
        signs(&subject, &FittedModel { parameters, free: &free, degree })
    }

    /// Things that stand out of a frame by themselves.
    pub(super) fn things(&self, look: &Look) -> Vec<Outstanding> {
        let (model, view) = (self.model(), self.view(look, look.window));
        let given = vec![None; model.parameters().len()];
        let found = Cold::look(model, &view, &self.constants, &given, THINGS, Vec::new(), Grain::Full);
        let sights = found.iter().flat_map(|found| &found.sights);
        sights.filter_map(|starts| Outstanding::of(self, look, starts)).collect()
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
