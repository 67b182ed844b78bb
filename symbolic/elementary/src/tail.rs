//! The upper tail of the normal distribution, for pixels at their limit: ln Q(z), Q(z) = ½ erfc(z/√2), and φ(z)/Q(z).
//!
//! With a = |z|/√2, e^(a²) erfc(a) (1 + 2a) is a polynomial in (a − 2)/(a + 2) for all a ≥ 0 (Shepherd and Laframboise
//! 1981), so that nothing underflows where Q does.

use super::arithmetic::polynomial;
use super::coefficients::{TAIL_DOUBLE, TAIL_SINGLE};
use super::exponential::exp;
use super::logarithm::log;
use super::machine::{Accuracy, Machine};

/// Beyond this φ(z)/Q(z) is z to the last digit.
const FAR: f64 = 1e8;

/// e^(a²) erfc(a) for a = |z|/√2, and −z²/2.
#[inline(always)]
fn scaled<M: Machine>(m: &M, accuracy: Accuracy, z: M::Number) -> [M::Number; 2] {
    let (distance, far) = (m.abs(z), m.constant(FAR));
    let distance = m.select(m.less(far, distance), far, distance);
    let a = m.mul(distance, m.constant(std::f64::consts::FRAC_1_SQRT_2));
    let two = m.constant(2.0);
    let t = m.div(m.sub(a, two), m.add(a, two));
    let p = polynomial(m, accuracy.pick(&TAIL_SINGLE, &TAIL_DOUBLE), t);
    let value = m.div(p, m.mul_add(a, two, m.constant(1.0)));
    [value, m.mul(m.mul(z, z), m.constant(-0.5))]
}

/// Q(z) of z < 0, which is 1 − ½ e^(−z²/2) · scaled.
#[inline(always)]
fn lower<M: Machine>(m: &M, bell: M::Number, scaled: M::Number) -> M::Number {
    m.sub(m.constant(1.0), m.mul(m.constant(0.5), m.mul(bell, scaled)))
}

/// ln Q(z), to within a few units in the last place of itself or of 1, whichever is larger.
#[inline(always)]
pub(super) fn log_tail<M: Machine>(m: &M, accuracy: Accuracy, z: M::Number) -> M::Number {
    let [scaled, exponent] = scaled(m, accuracy, z);
    let negative = m.less(z, m.constant(0.0));
    let bell = exp(m, accuracy, exponent);
    let half = m.mul(m.constant(0.5), scaled);
    let logarithm = log(m, accuracy, m.select(negative, lower(m, bell, scaled), half));
    m.select(negative, logarithm, m.add(exponent, logarithm))
}

/// φ(z)/Q(z), the inverse of Mills' ratio: −d ln Q/dz.
#[inline(always)]
pub(super) fn hazard<M: Machine>(m: &M, accuracy: Accuracy, z: M::Number) -> M::Number {
    // √(2/π)
    let root = m.constant(0.797_884_560_802_865_4);
    let [scaled, exponent] = scaled(m, accuracy, z);
    let bell = exp(m, accuracy, exponent);
    let below = m.div(m.mul(m.mul(root, m.constant(0.5)), bell), lower(m, bell, scaled));
    let above = m.div(root, scaled);
    let near = m.select(m.less(z, m.constant(0.0)), below, above);
    m.select(m.less(m.constant(FAR), z), z, near)
}

#[cfg(test)]
#[path = "tail_tests.rs"]
mod tests;
