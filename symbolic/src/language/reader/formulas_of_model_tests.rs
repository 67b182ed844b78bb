//! Exactness of Gauss rules.

use crate::model::Quadrature;

#[test]
fn a_rule_of_n_points_is_exact_to_degree_2n_minus_1() {
    for points in 1..=6_usize {
        for power in 0..2 * points as i32 {
            let sum: f64 = Quadrature::rule(points).iter().map(|(x, w)| w * x.powi(power)).sum();
            // ∫ x^k dx over −½ … ½
            let exact = if power % 2 == 1 { 0.0 } else { 0.5_f64.powi(power) / (f64::from(power) + 1.0) };
            assert!((sum - exact).abs() < 1e-15, "{points} points, x^{power}: {sum} {exact}");
        }
    }
}
