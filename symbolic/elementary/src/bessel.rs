//! The Bessel functions J0 and J1, and J1(x)/x and J2(x)/x², which make their derivatives defined at 0.
//!
//! Below 8 polynomials in x², shifted to the middle of its range. Beyond, √(2/πx) (P cos χ − Q sin χ) with
//! χ = x − (2n + 1) π/4 and two polynomials in 64/x² (Hankel 1869). Errors are relative to the height of the waves, not to
//! a value near a zero.

use super::arithmetic::{clamped, polynomial, signed};
use super::machine::{Accuracy, Machine};
use super::trigonometric::sin_cos;
use super::wave_coefficients::*;

/// Start of the wave form.
const FAR: f64 = 8.0;

/// J0
#[inline(always)]
pub(super) fn j0<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let near = near(m, 1.0, accuracy.pick(&BESSEL_0_SINGLE, &BESSEL_0_DOUBLE), a);
    let [far, _] = far(m, accuracy, a);
    joined(m, a, near, far)
}

/// J1
#[inline(always)]
pub(super) fn j1<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let near = m.mul(a, near(m, 0.5, accuracy.pick(&BESSEL_1_SINGLE, &BESSEL_1_DOUBLE), a));
    let [_, far] = far(m, accuracy, a);
    signed(m, joined(m, a, near, far), x)
}

/// J1(x)/x
#[inline(always)]
pub(super) fn ratio1<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let near = near(m, 0.5, accuracy.pick(&BESSEL_1_SINGLE, &BESSEL_1_DOUBLE), a);
    let [_, far] = far(m, accuracy, a);
    joined(m, a, near, m.div(far, a))
}

/// J2(x)/x²; beyond 8 it is (2 J1(x)/x − J0(x))/x².
#[inline(always)]
pub(super) fn ratio2<M: Machine>(m: &M, accuracy: Accuracy, x: M::Number) -> M::Number {
    let a = m.abs(x);
    let near = near(m, 0.125, accuracy.pick(&BESSEL_2_SINGLE, &BESSEL_2_DOUBLE), a);
    let [first, second] = far(m, accuracy, a);
    let twice = m.div(m.add(second, second), a);
    // Divides twice, because x² may overflow.
    joined(m, a, near, m.div(m.div(m.sub(twice, first), a), a))
}

#[inline(always)]
fn near<M: Machine>(m: &M, start: f64, coefficients: &[f64], a: M::Number) -> M::Number {
    let a = clamped(m, a, 0.0, FAR);
    let z = m.mul(a, a);
    let t = m.mul_add(z, m.constant(1.0 / 32.0), m.constant(-1.0));
    m.mul_add(z, polynomial(m, coefficients, t), m.constant(start))
}

/// J0 and J1 of a ≥ 8: with cos and sin of χ expanded, √(1/πx) ((P + Q) cos x + (P − Q) sin x), and for J1
/// √(1/πx) ((P + Q) sin x − (P − Q) cos x).
#[inline(always)]
fn far<M: Machine>(m: &M, accuracy: Accuracy, a: M::Number) -> [M::Number; 2] {
    let [sin, cos] = sin_cos(m, accuracy, a);
    let a = clamped(m, a, FAR, f64::INFINITY);
    let u = m.div(m.constant(FAR), a);
    let w = m.mul(u, u);
    // √(1/8π) √(8/x)
    let height = m.mul(m.constant(0.199_471_140_200_716_33), m.sqrt(u));
    let pair = |even: &[f64], odd: &[f64]| {
        let (p, q) = (polynomial(m, even, w), m.mul(u, polynomial(m, odd, w)));
        [m.add(p, q), m.sub(p, q)]
    };
    let [sum, difference] =
        pair(accuracy.pick(&HANKEL_P0_SINGLE, &HANKEL_P0_DOUBLE), accuracy.pick(&HANKEL_Q0_SINGLE, &HANKEL_Q0_DOUBLE));
    let first = m.mul_add(sum, cos, m.mul(difference, sin));
    let [sum, difference] =
        pair(accuracy.pick(&HANKEL_P1_SINGLE, &HANKEL_P1_DOUBLE), accuracy.pick(&HANKEL_Q1_SINGLE, &HANKEL_Q1_DOUBLE));
    let second = m.mul_add(sum, sin, m.neg(m.mul(difference, cos)));
    [m.mul(height, first), m.mul(height, second)]
}

/// Selects a form; 0 at infinity, which has no angle; keeps NaN.
#[inline(always)]
fn joined<M: Machine>(m: &M, a: M::Number, near: M::Number, far: M::Number) -> M::Number {
    let far = m.select(m.equal(a, m.constant(f64::INFINITY)), m.constant(0.0), far);
    m.select(m.less(a, m.constant(FAR)), near, far)
}

#[cfg(test)]
#[path = "bessel_tests.rs"]
mod tests;
