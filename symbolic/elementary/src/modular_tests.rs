//! Residues equal those of the exact fractions.

use super::*;

#[test]
fn decimals_are_fractions() {
    let of = |x: f64| Modular::from(x);
    assert_eq!(of(0.1) * of(3.0), of(0.1 * 3.0));
    assert_eq!(of(1.7) - of(1.0), of(1.7 - 1.0));
    assert_eq!(of(-0.25) * of(-4.0), Modular(1));
    assert_eq!(of(1e-9) * of(1e9), Modular(1));
    assert_ne!(of(std::f64::consts::PI), of(355.0 / 113.0));
    assert_eq!(of(std::f64::consts::PI) * of(2.0), of(2.0 * std::f64::consts::PI));
    assert_eq!(of(7.0) / of(3.0) * of(3.0), of(7.0));
}

#[test]
fn small_fractions_are_recovered() {
    for (numerator, denominator) in [(0.0, 1.0), (3.0, 10.0), (-7.0, 1.0), (1.0, -48.0), (1023.0, 1000.0)] {
        let residue = Modular::from(numerator) / Modular::from(denominator);
        assert_eq!(residue.small_fraction(), Some(numerator / denominator));
    }
    assert_eq!(Modular(0x5eed).opaque(7).small_fraction(), None);
}

#[test]
fn comparisons_hold_when_terms_change_sides() {
    for i in 0..100_u64 {
        let [a, b, c] = [1, 2, 3].map(|k| Modular(i).opaque(k));
        assert_eq!(a < b, a + c < b + c);
        assert_eq!(a < b, -b < -a);
        assert!(a < b || b < a);
    }
}
