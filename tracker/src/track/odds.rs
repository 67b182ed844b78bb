//! From what speaks for and against a thing to the odds that it is the target: how often things with such log odds are.
//!
//! What comes in: log odds L as [`super::evidence`] weighs them, with a misfit that counts no more than [`MISFIT_MAX`]. What goes
//! out: odds that rise with L. It never knows a fit.
//!
//! ```text
//! 1/odds = 1/(exp(L − c) + exp(L/20)/a) + exp(−(L + b))
//! ```
//!
//! 1. exp(L − c): however well a thing fits, something else may look so. L is at most 6.6, so c is what look-alikes are expected
//!    without any knowledge of the scene: a thing that leaves nothing unexplained and stands out of the noise is the target in
//!    about 95 cases of 100.
//! 2. exp(L/20)/a: a target on an uneven ground leaves as much unexplained as a thing of another shape does. What does not fit is
//!    the target in one case of four to seven, and how badly it fits says hardly more.
//! 3. exp(−(L + b)): corners, a frame full of such things and a place far off are no matter of the ground, and count without end.
//!
//! The three constants are a base rate: they were fitted to cold starts in frames of which every other one has a target
//! (docs/confidence.md says how well they hold for other frames).

/// More misfit than this says nothing more: what lies under a target may be to blame.
pub(super) const MISFIT_MAX: f64 = 3.1;

/// c: ln of how much likelier a thing looks so than the weights say.
const ALIKE: f64 = 3.7;
/// a: things that do not fit, for each target that does not.
const UNFIT: f64 = 2.99;
/// L that is lower by so much makes that e-fold more.
const EFOLD: f64 = 20.0;
/// b: what is odd by more is no target, on any ground.
const ODD: f64 = 24.0;

/// The odds.
pub(super) fn of(log_odds: f64) -> f64 {
    let fits = (log_odds - ALIKE).exp() + (log_odds / EFOLD).exp() / UNFIT;
    1.0 / (fits.recip() + (-(log_odds + ODD)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CONFIDENCE_MIN;

    fn confidence(log_odds: f64) -> f64 {
        of(log_odds) / (1.0 + of(log_odds))
    }

    #[test]
    fn what_is_likelier_stays_so() {
        let all: Vec<f64> = (-60..=14).map(|half| confidence(0.5 * f64::from(half))).collect();
        assert!(all.windows(2).all(|pair| pair[0] < pair[1]), "{all:?}");
    }

    #[test]
    fn nothing_is_sure_at_first_sight_and_a_misfit_alone_says_little() {
        assert!((0.93..0.97).contains(&confidence(6.6)), "{}", confidence(6.6));
        assert!((0.1..0.25).contains(&confidence(-12.0)), "{}", confidence(-12.0));
        assert!(confidence(-40.0) < 1e-3, "{}", confidence(-40.0));
    }

    /// Log odds of −5.8, the logistic function of which is 0.003, are what is taken and what is not.
    #[test]
    fn the_usual_least_confidence_is_that_of_a_thing_that_hardly_looks_like_the_target() {
        assert!(confidence(-5.7) > CONFIDENCE_MIN && confidence(-5.9) < CONFIDENCE_MIN, "{}", confidence(-5.8));
    }
}
