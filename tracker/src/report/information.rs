//! The Fisher information of a synthetic picture about the parameters of the last stage, its condition and its inverse,
//! at the model's noise or at a noise of one pixel value.
//!
//! The picture is the model's own prediction, so residuals are rounding errors.

use isophote_symbolic::ParameterId;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::points::ModelPoint;
use crate::exposure::{Kernels, RenderedLight};
use crate::scaled;
use crate::track::solver::Solver;

/// Share of the target's pixels saturated by a short dynamic range.
const SATURATED: f64 = 0.3;
/// Least share of the picture's contrast for a pixel to belong to the target.
const TARGET: f64 = 0.05;
/// Negligible diagonal entry relative to the largest, for parameters scaled by their magnitude.
const SILENT: f64 = 1e-12;
/// Significant entries of a null vector, relative to the largest.
const LARGE: f64 = 0.05;
/// Sweeps of the eigenvalue iteration, per parameter.
const SWEEPS: usize = 200;

/// The information about the parameters of the last stage, in their order.
#[derive(Clone, Debug)]
pub(crate) struct Information {
    order: Vec<ParameterId>,
    matrix: DMatrix<f64>,
    /// Magnitudes of the parameters, at least 1.
    magnitudes: Vec<f64>,
}

/// The condition of an information matrix.
#[derive(Clone, Debug)]
pub(crate) struct Condition {
    /// Least over largest eigenvalue at unit diagonal: 1 for independent parameters, 0 when one has no effect or some
    /// are degenerate.
    pub reciprocal: f64,
    /// Parameters without effect on any pixel.
    pub silent: Vec<ParameterId>,
    /// Of the others, the degenerate ones of a singular matrix.
    pub alike: Vec<ParameterId>,
    /// Dimension of their null space.
    pub nullity: usize,
    /// As `reciprocal`, without the silent ones.
    pub others: f64,
}

impl Information {
    /// Information without saturation. `None` with fewer pixels than parameters, or non-finite entries.
    pub fn of(solver: &Solver, kernels: &Kernels, point: &ModelPoint) -> Option<Information> {
        let light = RenderedLight::of(solver, kernels, &point.parameters, point.window)?;
        Information::at(solver, kernels, point, &light, f64::INFINITY)
    }

    /// Information with a share of [`SATURATED`] of the target saturated.
    pub fn saturated(solver: &Solver, kernels: &Kernels, point: &ModelPoint) -> Option<Information> {
        let light = RenderedLight::of(solver, kernels, &point.parameters, point.window)?;
        let limit = quantile(&light.pixels().collect::<Vec<f32>>())?;
        Information::at(solver, kernels, point, &light, limit)
    }

    fn at(
        solver: &Solver,
        kernels: &Kernels,
        point: &ModelPoint,
        light: &RenderedLight,
        limit: f64,
    ) -> Option<Information> {
        let order = solver.compiled.last_parameters().to_vec();
        let (matrix, sums) = kernels.information(solver, &point.parameters, light, limit)?;
        let is_enough = sums.pixels + sums.saturated > order.len() as u64;
        let magnitudes = order.iter().map(|p| point.parameters[p.index()].abs().max(1.0)).collect();
        (is_enough && matrix.iter().all(|x| x.is_finite())).then_some(Information { order, matrix, magnitudes })
    }

    /// The condition for a subset of the parameters; `None` when the last stage does not free all of them.
    pub fn condition(&self, subset: &[ParameterId], singular: f64) -> Option<Condition> {
        let at: Option<Vec<usize>> = subset.iter().map(|p| self.order.iter().position(|q| q == p)).collect();
        let at = at?;
        let effect = |i: usize| self.matrix[(i, i)].max(0.0).sqrt() * self.magnitudes[i];
        let largest = at.iter().map(|i| effect(*i)).fold(0.0, f64::max);
        let (heard, silent): (Vec<usize>, Vec<usize>) =
            at.into_iter().partition(|i| self.matrix[(*i, *i)] > 0.0 && effect(*i) > SILENT * largest);
        let name = |i: &usize| self.order[*i];
        let silent: Vec<ParameterId> = silent.iter().map(name).collect();
        if heard.is_empty() {
            return Some(Condition { reciprocal: 0.0, silent, alike: Vec::new(), nullity: 0, others: 1.0 });
        }
        let scaled = self.scaled(&heard);
        let eigen = SymmetricEigen::try_new(scaled, f64::EPSILON, SWEEPS * heard.len())?;
        let most = eigen.eigenvalues.amax();
        let null: Vec<usize> = (0..heard.len()).filter(|k| eigen.eigenvalues[*k] <= singular * most).collect();
        let others = (eigen.eigenvalues.min() / most).max(0.0);
        let share = |i: usize| null.iter().map(|k| eigen.eigenvectors[(i, *k)].powi(2)).sum::<f64>().sqrt();
        let shares = DVector::from_fn(heard.len(), |i, _| share(i));
        let mut alike: Vec<usize> = (0..heard.len()).filter(|i| shares[*i] > LARGE * shares.amax()).collect();
        if null.is_empty() {
            alike.clear();
        }
        let alike = alike.into_iter().map(|i| name(&heard[i])).collect();
        let reciprocal = if silent.is_empty() { others } else { 0.0 };
        Some(Condition { reciprocal, silent, alike, nullity: null.len(), others })
    }

    /// The Cramér–Rao bound as standard deviations, in the order of the last stage's parameters; `None` when singular.
    pub fn deviations(&self) -> Option<Vec<f64>> {
        Some(scaled::inverse(&self.matrix)?.diagonal().iter().map(|variance| variance.sqrt()).collect())
    }

    fn scaled(&self, at: &[usize]) -> DMatrix<f64> {
        let scale: Vec<f64> = at.iter().map(|i| self.matrix[(*i, *i)].sqrt()).collect();
        DMatrix::from_fn(at.len(), at.len(), |i, j| self.matrix[(at[i], at[j])] / (scale[i] * scale[j]))
    }
}

/// The value that a share of [`SATURATED`] of the target's pixels reach. NaN is outside the domain; f32::min and max ignore it.
fn quantile(pixels: &[f32]) -> Option<f64> {
    let (least, most) = pixels.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
    let floor = least + TARGET as f32 * (most - least);
    let mut target: Vec<f32> = pixels.iter().copied().filter(|pixel| *pixel > floor).collect();
    let rank = (SATURATED * target.len() as f64) as usize;
    if rank == 0 || rank >= target.len() {
        return None;
    }
    let (_, value, _) = target.select_nth_unstable_by(rank, |a, b| b.total_cmp(a));
    Some(f64::from(*value))
}
