//! The spline passes through its samples, is smooth, is constant beyond its ends, and approximates smooth functions
//! closely.
#![allow(clippy::unwrap_used)]

use super::*;

fn axis(first: f64, step: f64, count: usize) -> Axis {
    Axis { first, step, count }
}

fn sampled(axis: Axis, f: impl Fn(f64) -> f64) -> Table {
    let samples: Vec<f64> = (0..axis.count).map(|i| f(axis.first + axis.step * i as f64)).collect();
    Table::through(&[axis], &samples).unwrap()
}

#[test]
fn splines_pass_through_samples_and_are_constant_beyond_the_edges() {
    let samples = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0];
    let table = Table::through(&[axis(-2.0, 0.5, 6)], &samples).unwrap();
    for (i, sample) in samples.iter().enumerate() {
        assert!((table.value(&[-2.0 + 0.5 * i as f64]) - sample).abs() < 1e-14);
    }
    for (s, edge) in [(-2.1, 3.0), (-1e300, 3.0), (f64::NEG_INFINITY, 3.0), (0.7, 9.0), (f64::INFINITY, 9.0)] {
        assert!((table.value(&[s]) - edge).abs() < 1e-14, "{s}: {}", table.value(&[s]));
    }
    assert!(table.value(&[f64::NAN]).is_nan());
}

#[test]
fn splines_are_smooth_and_have_slope_0_at_the_ends() {
    let samples = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0];
    let table = Table::through(&[axis(0.0, 1.0, 6)], &samples).unwrap();
    let h = 1e-4;
    let at = |s: f64| table.value(&[s]);
    let slope = |s: f64| (at(s + h) - at(s - h)) / (2.0 * h);
    let bend = |s: f64| (at(s + h) - 2.0 * at(s) + at(s - h)) / (h * h);
    for knot in 0..6 {
        let knot = f64::from(knot);
        let [left, right] = [knot - 2.0 * h, knot + 2.0 * h];
        assert!((at(left) - at(right)).abs() < 0.02, "{knot}");
        assert!((slope(left) - slope(right)).abs() < 0.05, "{knot}");
        if (0.5..4.5).contains(&knot) {
            assert!((bend(left) - bend(right)).abs() < 0.05, "{knot}: {} {}", bend(left), bend(right));
        } else {
            assert!(slope(knot).abs() < 0.01, "{knot}: {}", slope(knot));
        }
    }
}

#[test]
fn errors_fall_with_the_fourth_power_of_the_step() {
    let worst = |step: f64| {
        let table = sampled(axis(-6.0, step, 1 + (12.0 / step).round() as usize), |s| (-s * s).exp());
        (0..1000)
            .map(|i| -6.0 + 0.012 * f64::from(i))
            .map(|s| (table.value(&[s]) - (-s * s).exp()).abs())
            .fold(0.0, f64::max)
    };
    let [coarse, fine] = [worst(0.2), worst(0.1)];
    assert!(fine < 1e-5 && (10.0..24.0).contains(&(coarse / fine)), "{coarse:e} {fine:e}");
}

#[test]
fn splines_over_two_axes_reproduce_products() {
    let (x, y) = (axis(-3.0, 0.25, 25), axis(-2.0, 0.5, 9));
    let f = |s: f64| (-s * s).exp();
    let g = |s: f64| 1.0 / (1.0 + s * s);
    let (tf, tg) = (sampled(x, f), sampled(y, g));
    let place = |axis: Axis, i: usize| axis.first + axis.step * i as f64;
    let samples: Vec<f64> =
        (0..y.count).flat_map(|j| (0..x.count).map(move |i| f(place(x, i)) * g(place(y, j)))).collect();
    let table = Table::through(&[x, y], &samples).unwrap();
    for i in 0..200 {
        let (u, v) = (-3.5 + 0.035 * f64::from(i), 2.6 - 0.027 * f64::from(i));
        let expected = tf.value(&[u]) * tg.value(&[v]);
        assert!((table.value(&[u, v]) - expected).abs() < 1e-14, "{u} {v}");
    }
}

#[test]
fn invalid_tables_are_refused() {
    let samples = [1.0, 2.0, 3.0, 4.0];
    assert!(Table::through(&[axis(0.0, 1.0, 4)], &samples).is_some());
    assert!(Table::through(&[axis(0.0, 1.0, 3)], &samples[..3]).is_none());
    assert!(Table::through(&[axis(0.0, 1.0, 4)], &samples[..3]).is_none());
    assert!(Table::through(&[axis(0.0, 0.0, 4)], &samples).is_none());
    assert!(Table::through(&[axis(f64::NAN, 1.0, 4)], &samples).is_none());
    assert!(Table::through(&[axis(0.0, 1.0, 4)], &[1.0, 2.0, f64::INFINITY, 4.0]).is_none());
    assert!(Table::through(&[axis(0.0, 1.0, 4)], &[f64::MAX, f64::MIN, f64::MAX, f64::MIN]).is_none());
    assert!(Table::through(&[], &[]).is_none());
}

#[test]
fn missing_lookups_are_nan() {
    let tables = Tables::of(vec![sampled(axis(0.0, 1.0, 4), |s| s)]);
    assert!(tables.has(Lookup { table: 0, coefficient: 3 }) && !tables.has(Lookup { table: 0, coefficient: 4 }));
    assert!(!tables.has(Lookup { table: 1, coefficient: 0 }));
    assert!(tables.look_up(Lookup { table: 1, coefficient: 0 }, 0.0, 0.0).is_nan());
    assert_eq!(tables.numbers().len(), 20);
    assert_eq!(tables.start(1), 20);
    let other = |step: f64| Tables::of(vec![sampled(axis(0.0, step, 4), |s| s / step)]);
    assert!(tables == other(1.0) && other(1.0) != other(2.0) && tables != Tables::default());
}

#[test]
fn tables_share_one_copy_of_their_numbers() {
    let each = [sampled(axis(0.0, 1.0, 4), |s| s), sampled(axis(-1.0, 0.5, 7), |s| s * s)];
    let tables = Tables::of(each.to_vec());
    for (i, (alone, together)) in each.iter().zip(tables.all()).enumerate() {
        assert_eq!(alone, together);
        assert_eq!(alone.value(&[0.7]), together.value(&[0.7]));
        let start = tables.start(i as u16);
        assert!(std::ptr::eq(&tables.numbers()[start..start + together.numbers().len()], together.numbers()));
    }
}
