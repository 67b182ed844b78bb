//! `raised`: the background beside something dark that covers a part of it as well.
//!
//! What comes in: a picture and a start. What goes out: a start whose background is the brighter one of two. It never knows a fit.

use super::{Alternatives, Variation, constants_for};
use crate::sight::view::View;
use crate::solve::residuals::{Over, Residual, Seen};

/// A pixel to which a target adds no more than this share of its height is one of the background.
const BARE: f64 = 0.05;
/// The background is raised to what this share of its pixels is below, what covers it is at what this share is below, …
const RAISED: f64 = 0.75;
const COVERED: f64 = 0.1;
/// … where these are so many standard deviations of a pixel above and below the start, and this share of all pixels as near to one of
/// the two: glare has no levels.
const APART: f64 = 3.0;
const LEVEL: f64 = 0.8;

impl Alternatives {
    /// A start whose background is the brighter one of two: what stands dark in front of a part of the picture is a part of its
    /// background to whoever has not found it yet. `None` where the background is one, or no parameter.
    pub fn raised(&self, view: &View, constants: &[f64], start: &[f64]) -> Option<Vec<f64>> {
        let Variation { compiled, predictions } = self.own.as_ref()?;
        let [roles] = compiled.model().roles() else { return None };
        let background = roles.background?.index();
        let constants = constants_for(compiled.model(), constants, view, 1.0);
        let seen = predictions.residuals(view, start, &constants, Over::Domain)?;
        let [seen] = &seen[..] else { return None };
        let (Seen { residuals, .. }, floor) = (seen, seen.floor());
        let ceiling = residuals.iter().map(|residual| residual.predicted).fold(f64::NEG_INFINITY, f64::max);
        let is_bare =
            |residual: &&Residual| residual.predicted - floor <= BARE * (ceiling - floor) && !residual.saturated;
        let mut bare: Vec<&Residual> = residuals.iter().filter(is_bare).collect();
        bare.sort_by(|a, b| a.whitened.total_cmp(&b.whitened));
        let at = |share: f64| bare.get((share * bare.len() as f64) as usize);
        let (covered, raised) = (at(COVERED)?, at(RAISED)?);
        let is_near = |residual: &Residual, level: &Residual| (residual.whitened - level.whitened).abs() < APART;
        let is_level = |residual: &&&Residual| is_near(residual, covered) || is_near(residual, raised);
        let is_even = bare.iter().filter(is_level).count() as f64 >= LEVEL * bare.len() as f64;
        let is_between = covered.whitened < -APART && raised.whitened > APART;
        (is_even && is_between).then(|| {
            let mut start = start.to_vec();
            start[background] += raised.whitened * raised.deviation;
            start
        })
    }
}
