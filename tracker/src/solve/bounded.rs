//! A trust-region step with bounds: an active set from the projected gradient, then exact steps in the free subspace (C.-J.
//! Lin and J. J. Moré, "Newton's method for large bound-constrained optimization problems", SIAM J. Optim. 9, 1999).
//!
//! A parameter at its bound whose gradient pushes outwards is held. Where the step of the others crosses bounds, the first
//! one crossed is fixed there and the rest is minimised again, until none is crossed. This descends for convex quadratics
//! of nearly independent parameters; of the result and the first step, cut where it meets a bound, the one with the larger
//! predicted reduction is taken.

use nalgebra::DVector;

use crate::solve::trust::{Quadratic, Spectrum, TrustStep};

/// A quadratic with bounds.
pub(super) struct Bounded<'a> {
    quadratic: &'a Quadratic,
    scale: &'a DVector<f64>,
    resolution: f64,
    /// How far each parameter may go down, ≤ 0, and up, ≥ 0.
    step_ranges: &'a [[f64; 2]],
    /// The fixed steps of held parameters, which are those at their bounds.
    held: Vec<Option<f64>>,
    /// The spectrum of the free parameters.
    pub spectrum: Spectrum,
}

/// Whether a bound holds a parameter with this slope and range.
fn is_held(slope: f64, [low, high]: [f64; 2]) -> bool {
    low == 0.0 && slope > 0.0 || high == 0.0 && slope < 0.0
}

impl Quadratic {
    /// Zeroes the slopes of held parameters and their off-diagonal entries of H; keeps their own curvature.
    pub(super) fn fix_at_bounds(&mut self, bounds: &[[f64; 2]], at: impl Fn(usize) -> f64) {
        for (i, bounds) in bounds.iter().enumerate() {
            if is_held(self.gradient[i], bounds.map(|bound| bound - at(i))) {
                self.alone(i);
            }
        }
    }

    fn alone(&mut self, i: usize) {
        let own = self.hessian[(i, i)];
        self.hessian.row_mut(i).fill(0.0);
        self.hessian.column_mut(i).fill(0.0);
        self.hessian[(i, i)] = own;
        self.gradient[i] = 0.0;
    }

    /// Restricts the quadratic to the free parameters, with the others at their fixed steps: these keep no slope and no
    /// off-diagonal entry of H.
    fn fix(&mut self, held: &[Option<f64>]) {
        for (i, at) in held.iter().enumerate() {
            if let Some(at) = at.filter(|at| *at != 0.0) {
                self.gradient.axpy(at, &self.hessian.column(i), 1.0);
            }
        }
        (0..held.len()).filter(|i| held[*i].is_some()).for_each(|i| self.alone(i));
    }
}

impl<'a> Bounded<'a> {
    /// `None` when H is not finite.
    pub fn new(
        quadratic: &'a Quadratic,
        scale: &'a DVector<f64>,
        resolution: f64,
        step_ranges: &'a [[f64; 2]],
    ) -> Option<Bounded<'a>> {
        let slopes = quadratic.gradient.iter().zip(step_ranges);
        let held: Vec<Option<f64>> = slopes.map(|(slope, range)| is_held(*slope, *range).then_some(0.0)).collect();
        let spectrum = of_free(quadratic, &held, scale, resolution)?;
        Some(Bounded { quadratic, scale, resolution, step_ranges, held, spectrum })
    }

    /// An approximate minimiser within `radius` and the bounds.
    pub fn step(&self, radius: f64) -> TrustStep {
        let mut free = self.spectrum.step(radius);
        // Exactly 0: eigenvectors are rounded.
        free.delta.iter_mut().zip(&self.held).filter(|(_, held)| held.is_some()).for_each(|(delta, _)| *delta = 0.0);
        let Some((first, share)) = self.crossing(&free.delta, &self.held) else { return free };
        // Clamped: rounding may put the product beyond the bound.
        let cut = DVector::from_fn(self.held.len(), |i, _| {
            (share * free.delta[i]).clamp(self.step_ranges[i][0], self.step_ranges[i][1])
        });
        let mut best = self.finish(cut, false);
        let (mut held, mut crossed) = (self.held.clone(), Some((first, free.delta[first])));
        while let Some((i, towards)) = crossed {
            held[i] = Some(self.step_ranges[i][usize::from(towards > 0.0)]);
            let fixed = held.iter().zip(self.scale.iter()).filter_map(|(at, scale)| Some(at.as_ref()? * scale));
            let square = radius * radius - fixed.map(|length| length * length).sum::<f64>();
            let Some(spectrum) = of_free(self.quadratic, &held, self.scale, self.resolution).filter(|_| square > 0.0)
            else {
                return best;
            };
            let rest = spectrum.step(square.sqrt());
            let delta = DVector::from_fn(held.len(), |i, _| held[i].unwrap_or(rest.delta[i]));
            crossed = self.crossing(&delta, &held).map(|(i, _)| (i, delta[i]));
            if crossed.is_none() {
                let step = self.finish(delta, rest.interior);
                if step.reduction >= best.reduction {
                    best = step;
                }
            }
        }
        best
    }

    /// The first parameter whose bound a step crosses, and the fraction of the step up to it.
    fn crossing(&self, delta: &DVector<f64>, held: &[Option<f64>]) -> Option<(usize, f64)> {
        let share = |i: usize| {
            let [low, high] = self.step_ranges[i];
            let is_beyond = held[i].is_none() && (delta[i] < low || delta[i] > high);
            is_beyond.then(|| (i, if delta[i] > 0.0 { high } else { low } / delta[i]))
        };
        (0..delta.len()).filter_map(share).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// A step with its reduction and slope by the whole quadratic.
    fn finish(&self, delta: DVector<f64>, interior: bool) -> TrustStep {
        let slope = self.quadratic.gradient.dot(&delta);
        let bend = delta.dot(&(&self.quadratic.hessian * &delta));
        let length = delta.component_mul(self.scale).norm();
        TrustStep { delta, length, reduction: -slope - 0.5 * bend, slope: slope.min(0.0), interior }
    }
}

fn of_free(quadratic: &Quadratic, held: &[Option<f64>], scale: &DVector<f64>, resolution: f64) -> Option<Spectrum> {
    if held.iter().all(Option::is_none) {
        return Spectrum::new(quadratic, scale, resolution);
    }
    let mut free = quadratic.clone();
    free.fix(held);
    Spectrum::new(&free, scale, resolution)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::DMatrix;

    use super::*;
    use crate::solve::trust::Curvature;

    fn quadratic(hessian: DMatrix<f64>, gradient: DVector<f64>) -> Quadratic {
        Quadratic { objective: 0.0, gradient, hessian, curvature: Curvature::GaussNewton }
    }

    #[test]
    fn a_bound_holds_only_its_own_parameter() {
        // Minimum at (3, 2), with x ≤ 1: then y = 2 + (3 − 1)/2 · ½ through the coupling.
        let hessian = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0]);
        let quadratic = quadratic(hessian.clone(), -&hessian * DVector::from_vec(vec![3.0, 2.0]));
        let (scale, step_ranges) = (DVector::from_vec(vec![1.0, 1.0]), [[-10.0, 1.0], [-10.0, 10.0]]);
        let step = Bounded::new(&quadratic, &scale, 1e-15, &step_ranges).unwrap().step(f64::INFINITY);
        assert!((step.delta - DVector::from_vec(vec![1.0, 3.0])).amax() < 1e-12 && step.interior);
        // From the bound, pushed outwards, the other parameter still moves.
        let step_ranges = [[-10.0, 0.0], [-10.0, 10.0]];
        let bounded = Bounded::new(&quadratic, &scale, 1e-15, &step_ranges).unwrap();
        let step = bounded.step(f64::INFINITY);
        assert!((step.delta - DVector::from_vec(vec![0.0, 3.5])).amax() < 1e-12 && step.interior);
        // Limited by the radius.
        let step = bounded.step(0.5);
        assert!((step.delta - DVector::from_vec(vec![0.0, 0.5])).amax() < 1e-6 && !step.interior);
    }

    #[test]
    fn bounded_steps_lower_the_quadratic() {
        let mut number = 1_u64;
        let mut random = || {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (number >> 40) as f64 / (1_u64 << 23) as f64 - 1.0
        };
        for _ in 0..2000 {
            let root = DMatrix::from_fn(4, 4, |_, _| random());
            let quadratic = quadratic(&root * root.transpose(), DVector::from_fn(4, |_, _| random()));
            let mut side = || if random() > 0.4 { 0.0 } else { random().abs() };
            let step_ranges = [(); 4].map(|()| [-side(), side()]);
            let (scale, radius) = (DVector::from_element(4, 1.0), 0.1 + 2.0 * random().abs());
            let bounded = Bounded::new(&quadratic, &scale, 1e-15, &step_ranges).unwrap();
            let step = bounded.step(radius);
            let is_inside = |(delta, [low, high]): (&f64, &[f64; 2])| (*low..=*high).contains(delta);
            assert!(
                step.delta.iter().zip(&step_ranges).all(is_inside) && step.length <= radius * (1.0 + 1e-6),
                "{step:?}"
            );
            let free = (0..4).any(|i| {
                let slope = quadratic.gradient[i];
                slope.abs() > 1e-9 && if slope > 0.0 { step_ranges[i][0] < 0.0 } else { step_ranges[i][1] > 0.0 }
            });
            assert_eq!(step.reduction > 0.0, free, "{quadratic:?} {step_ranges:?} {step:?}");
        }
    }
}
