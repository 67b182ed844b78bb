//! From what speaks for and against a thing to the odds that it is the target.
//!
//! What comes in: log odds. What goes out: `1/(exp(−log odds) + a)`, the odds where look-alikes are expected, however well a thing
//! fits. It never knows a fit.

/// a: look-alikes, for each target. What leaves nothing unexplained and stands out of the noise is the target in about 97 cases
/// of 100.
const ALIKE: f64 = 0.025;

/// The odds.
pub(super) fn of(log_odds: f64) -> f64 {
    1.0 / ((-log_odds).exp() + ALIKE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn confidence(log_odds: f64) -> f64 {
        of(log_odds) / (1.0 + of(log_odds))
    }

    #[test]
    fn what_is_likelier_stays_so() {
        let all: Vec<f64> = (-60..=14).map(|half| confidence(0.5 * f64::from(half))).collect();
        assert!(all.windows(2).all(|pair| pair[0] < pair[1]), "{all:?}");
    }

    #[test]
    fn nothing_is_sure_at_first_sight() {
        assert!((0.95..0.98).contains(&confidence(4.2)), "{}", confidence(4.2));
        assert!((0.48..0.5).contains(&confidence(0.0)), "{}", confidence(0.0));
        assert!(confidence(-10.0) < 1e-3, "{}", confidence(-10.0));
    }
}
