//! Zernike functions on the unit disc, the basis of profile deviations: radial degree up to 6, each of mean square 1.
//! (F. Zernike, "Beugungstheorie des Schneidenverfahrens", Physica 1, 1934; R. J. Noll, J. Opt. Soc. Am. 66, 1976.)

/// A budget: the largest radial degree. Higher orders are of the size of a profile's edges.
const DEGREE: i32 = 6;
/// Number of functions, (n + 1)(n + 2)/2.
pub(super) const COUNT: usize = 28;

/// All functions at `(x, y)`, in a fixed order; outside the disc their polynomial continuation.
pub(super) fn at(x: f64, y: f64) -> [f64; COUNT] {
    let (radius, angle) = (x.hypot(y), y.atan2(x));
    let mut values = [0.0; COUNT];
    let mut next = values.iter_mut();
    let mut push = |value: f64| next.by_ref().take(1).for_each(|place| *place = value);
    for degree in 0..=DEGREE {
        for order in (degree % 2..=degree).step_by(2) {
            let times = if order == 0 { 1.0 } else { 2.0 };
            let radial = (times * f64::from(degree + 1)).sqrt() * radial(degree, order, radius);
            let angle = f64::from(order) * angle;
            push(radial * angle.cos());
            if order > 0 {
                push(radial * angle.sin());
            }
        }
    }
    values
}

/// `R(r)` of that degree and order, 1 at the rim.
fn radial(degree: i32, order: i32, radius: f64) -> f64 {
    let factorial = |of: i32| (1..=of).map(f64::from).product::<f64>();
    let term = |k: i32| {
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        let below = factorial(k) * factorial((degree + order) / 2 - k) * factorial((degree - order) / 2 - k);
        sign * factorial(degree - k) / below * radius.powi(degree - 2 * k)
    };
    (0..=(degree - order) / 2).map(term).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_are_orthogonal_and_of_mean_square_one() {
        let side = 400;
        let place = |i: usize| (i as f64 + 0.5) / f64::from(side) * 2.0 - 1.0;
        let (mut products, mut count) = (vec![0.0; COUNT * COUNT], 0.0);
        for (x, y) in (0..side as usize).flat_map(|i| (0..side as usize).map(move |j| (place(i), place(j)))) {
            if x.hypot(y) > 1.0 {
                continue;
            }
            let values = at(x, y);
            count += 1.0;
            for i in 0..COUNT {
                (0..COUNT).for_each(|j| products[i * COUNT + j] += values[i] * values[j]);
            }
        }
        for (i, j) in (0..COUNT).flat_map(|i| (0..COUNT).map(move |j| (i, j))) {
            let wanted = if i == j { 1.0 } else { 0.0 };
            assert!(
                (products[i * COUNT + j] / count - wanted).abs() < 0.03,
                "{i}, {j}: {}",
                products[i * COUNT + j] / count
            );
        }
    }
}
