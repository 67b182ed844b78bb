//! The Cramér–Rao bound: the least error of an unbiased estimate, given light and noise.
//!
//! Fisher information `JᵀWJ`: J by central differences of the light, W = 1/σ² of each pixel that is neither saturated
//! nor covered. (Censored instead of dropped, saturated pixels would add 0 to 1 % of information.)

use nalgebra::DMatrix;

use super::scene::{Beside, Scene};
use super::sensor::variance;

/// Pixels of at least this light read 255.
const CLIPPED: f64 = 254.5;

/// Variances of the unknowns, with the benches' usual camera.
pub fn variances(scene: &Scene, beside: Beside) -> Vec<f64> {
    variances_of(scene, beside, &variance)
}

/// The same with a camera's own variance of a pixel, DN².
pub fn variances_of(scene: &Scene, beside: Beside, variance: &dyn Fn(f64) -> f64) -> Vec<f64> {
    let truth = scene.unknowns(beside);
    let [a1, _, a3] = scene.shape;
    let steps: Vec<f64> = match beside {
        Beside::Lobe => vec![1e-3, 1e-3, 1e-3, 1e-2],
        Beside::Plane | Beside::Even => vec![1e-4, 1e-4],
    };
    let steps = [1e-3, 1e-3, a1 * 1e-4, a1 * 1e-4, a3 * 1e-4, 1e-2, 1e-2].into_iter().chain(steps);
    let (light, kept) = (scene.light(&truth), scene.seen().1);
    let weight = |(light, kept): (&f64, &bool)| if *kept && *light < CLIPPED { 1.0 / variance(*light) } else { 0.0 };
    let weights: Vec<f64> = light.iter().zip(&kept).map(weight).collect();
    let columns: Vec<Vec<f64>> = steps
        .take(truth.len())
        .enumerate()
        .map(|(i, step)| {
            let at = |sign: f64| {
                let mut unknowns = truth.clone();
                unknowns[i] += sign * step;
                scene.light(&unknowns)
            };
            at(1.0).iter().zip(at(-1.0)).map(|(plus, minus)| (plus - minus) / (2.0 * step)).collect()
        })
        .collect();
    let n = truth.len();
    let product = |i: usize, j: usize| {
        let all = columns[i].iter().zip(&columns[j]).zip(&weights).map(|((a, b), w)| a * b * w).sum::<f64>();
        all - shared(scene, [&columns[i], &columns[j]], &weights)
    };
    let fisher: DMatrix<f64> = DMatrix::from_fn(n, n, |i, j| if i <= j { product(i, j) } else { 0.0 });
    let fisher = DMatrix::from_fn(n, n, |i, j| fisher[(i.min(j), i.max(j))]);
    // Units of the unknowns range from px to px⁻²: scale to a unit diagonal before inversion.
    let scale = fisher.diagonal().map(|entry| 1.0 / entry.sqrt());
    let scaled = DMatrix::from_fn(n, n, |i, j| fisher[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.try_inverse().unwrap();
    (0..n).map(|i| inverse[(i, i)] * scale[i] * scale[i]).collect()
}

/// Information lost from `Σ w a b` to unknown row offsets: `Σ κ (Σ w a)(Σ w b)` over rows, with `κ = τ²/(1 + τ² Σ w)`.
fn shared(scene: &Scene, [a, b]: [&[f64]; 2], weights: &[f64]) -> f64 {
    let (side, variance) = (scene.condition.side_px, scene.condition.row_noise.powi(2));
    let row = |first: usize| {
        let sum = |of: &dyn Fn(usize) -> f64| (first..first + side).map(|i| weights[i] * of(i)).sum::<f64>();
        variance / (1.0 + variance * sum(&|_| 1.0)) * sum(&|i| a[i]) * sum(&|i| b[i])
    };
    if variance > 0.0 { (0..side).map(|y| row(y * side)).sum() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::condition::condition;
    use crate::accuracy::sensor::Random;

    /// The notes' figures, from twelve other drawings by another program, to 2 %.
    #[test]
    fn bounds_match_the_notes() {
        for (name, beside, expected) in [
            ("S0", Beside::Even, 0.0079),
            ("S30", Beside::Even, 0.0046),
            ("S60", Beside::Even, 0.0031),
            ("dark", Beside::Even, 0.0372),
            ("glareLin", Beside::Plane, 0.0058),
            ("small_S0", Beside::Even, 0.0082),
        ] {
            let all = (0..6).map(|number| {
                let scene = Scene::draw(condition(name), &mut Random::of(name, number));
                let variances = variances(&scene, beside);
                (variances[0] + variances[1]) / 2.0
            });
            let bound = (all.sum::<f64>() / 6.0).sqrt();
            assert!((bound / expected - 1.0).abs() < 0.02, "{name}: {bound} for {expected}");
        }
    }
}
