//! Where what hides a part of a target lies: in the middle of a ring there is a hole, and nothing in front of it.
//!
//! What comes in: a fit that left a part of its target out, and the picture around it. What goes out: the log odds that this takes
//! away. It never knows a target or a track.
//!
//! Of everything round some ring looks like a target once its middle is left out. Something that stands in front of a target stands
//! anywhere; that it does so in the very middle of it is as likely as that area is small.

use nalgebra::Vector2;

use super::around::Around;
use super::asymmetry;
use crate::estimate::Substitute;
use crate::solve::residuals::OUTLIER;

/// Of a target that nobody has seen before this share may be covered: a thing of any shape is one of which enough is covered.
const HIDDEN_MOST: f64 = 0.32;
/// What more of it takes of the log odds, of all pixels.
const VEILED: f64 = 300.0;
/// Fewer pixels are nothing in front of a target.
const PIXELS_MIN: usize = 12;
/// The middle of what is hidden is so far from the target's, in units of its outline, …
const OFF_CENTRE: f64 = 0.2;
/// … and what one in the very middle takes of the log odds.
const WEIGHT: f64 = 8.0;
/// Corners and ends say this less of what is hidden in part.
const FORGIVEN: f64 = 0.1;

/// The log odds that the share that is hidden takes away.
pub(super) fn veiled(choice: Substitute) -> f64 {
    if choice.robust { VEILED * (choice.hidden - HIDDEN_MOST).max(0.0) } else { 0.0 }
}

/// Those that its place does; `limit` is the largest value that a pixel may have.
pub(super) fn against(around: &Around, limit: f64) -> f64 {
    let middle = middle(around).map_or(0.0, |off| WEIGHT * (1.0 - off / OFF_CENTRE).max(0.0));
    // Glare has any shape.
    let is_blinded = around.inside.iter().any(|residual| residual.saturated && residual.whitened > OUTLIER);
    let corners = asymmetry::of(around, limit).filter(|_| !is_blinded);
    middle + corners.map_or(0.0, |found| asymmetry::against(found - FORGIVEN))
}

/// How far the middle of what is not explained is from that of the target, of what is darker than it should be and of what is
/// brighter: a ground that slopes has either on one side. `None` where hardly anything is.
fn middle(around: &Around) -> Option<f64> {
    let off = |sign: f64| {
        let far = around.inside.iter().filter(|residual| sign * residual.whitened > OUTLIER);
        let places: Vec<Vector2<f64>> = far.map(|residual| around.place(residual.pixel)).collect();
        let sum = places.iter().fold(Vector2::zeros(), |sum, place| sum + place);
        (places.len() >= PIXELS_MIN).then(|| sum.norm() / places.len() as f64)
    };
    [1.0, -1.0].into_iter().filter_map(off).reduce(f64::max)
}
