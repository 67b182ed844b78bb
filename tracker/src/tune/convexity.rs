//! Where F is convex: the thesis' Table 4.1, sampled at many starts around an answer.

use nalgebra::DMatrix;
use serde::Serialize;

use super::bench::{Bench, Goal};
use super::starts::{self, Offset};
use crate::solve::fit::pass_at;
use crate::solve::stage::eigen_resolution;
use crate::solve::stage_kernels::CompileFailure;
use crate::track::window::Margin;
use isophote_frame::Frame;

/// The grid of starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Distances from the answer, the nearest first.
    pub offsets: Vec<Offset>,
    /// Directions at each distance.
    pub directions: u64,
    /// Seed of the directions.
    pub seed: u64,
}

/// Definiteness of the full Hessian of a subset of the parameters around the answer, all others being right.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Convexity {
    /// Number of points, including the answer.
    pub starts: u32,
    /// Number of points with a positive definite Hessian.
    pub convex: u32,
    /// It is positive definite at all points up to this distance; absent when it is not even at the answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<Offset>,
    /// Its smallest and largest eigenvalue at the answer; absent when it has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eigenvalues: Option<[f64; 2]>,
    /// Largest number of negative eigenvalues at any point.
    pub negative_max: usize,
}

impl Convexity {
    /// Merges two frames: all points of both, the smaller radius, the outer eigenvalues.
    pub fn and(&self, other: &Convexity) -> Convexity {
        let smaller = |a: Offset, b: Offset| if (b.centre_px, b.share) < (a.centre_px, a.share) { b } else { a };
        Convexity {
            starts: self.starts + other.starts,
            convex: self.convex + other.convex,
            radius: self.radius.zip(other.radius).map(|(a, b)| smaller(a, b)),
            eigenvalues: self.eigenvalues.zip(other.eigenvalues).map(|(a, b)| [a[0].min(b[0]), a[1].max(b[1])]),
            negative_max: self.negative_max.max(other.negative_max),
        }
    }
}

/// Signs of a Hessian's eigenvalues.
struct Inertia {
    /// None is negative or vanishes.
    is_definite: bool,
    negative: usize,
    /// The least and the largest.
    outer: [f64; 2],
}

impl Bench {
    /// Evaluates the Hessian of stage number `stage`, which must use Newton's method, at the answer and at all points
    /// of the grid, in that stage's parameters. `None` when the frame does not suit the model.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn convexity(
        &self,
        frame: &Frame,
        goal: &Goal,
        stage: usize,
        grid: &Grid,
    ) -> Result<Option<Convexity>, CompileFailure> {
        let here = Offset { centre_px: 0.0, share: 0.0 };
        let Some(answer) = self.inertia(frame, goal, stage, &goal.parameters)? else { return Ok(None) };
        let mut found = Convexity {
            starts: 1,
            convex: u32::from(answer.is_definite),
            radius: answer.is_definite.then_some(here),
            eigenvalues: answer.outer.iter().all(|value| value.is_finite()).then_some(answer.outer),
            negative_max: answer.negative,
        };
        let model = self.solver.model();
        let varied = &model.stages()[stage].parameters;
        let mut is_convex = answer.is_definite;
        for (level, &offset) in grid.offsets.iter().enumerate() {
            for direction in 0..grid.directions {
                let number = grid.seed.wrapping_add(level as u64 * grid.directions + direction);
                let point = starts::start(model, &self.solver.constants, &goal.parameters, varied, offset, number);
                let inertia = self.inertia(frame, goal, stage, &point)?;
                let is_definite = inertia.as_ref().is_some_and(|inertia| inertia.is_definite);
                found.starts += 1;
                found.convex += u32::from(is_definite);
                found.negative_max = found.negative_max.max(inertia.map_or(0, |inertia| inertia.negative));
                is_convex &= is_definite;
            }
            if is_convex {
                found.radius = Some(offset);
            }
        }
        Ok(Some(found))
    }

    /// At a point, on that point's own pixel set, as a solver would see it.
    fn inertia(
        &self,
        frame: &Frame,
        goal: &Goal,
        stage: usize,
        point: &[f64],
    ) -> Result<Option<Inertia>, CompileFailure> {
        let frame = self.solver.mended(frame);
        let Some(context) = self.solver.context(&frame) else { return Ok(None) };
        let window = self.solver.window(&context, point, Margin::NONE);
        let view = self.solver.view(&context, window);
        let compiled = &self.solver.compiled;
        let pass = pass_at(compiled, &view, &self.solver.constants, stage, goal.handling, point)?;
        let resolution = eigen_resolution(compiled.precision());
        Ok(pass.and_then(|pass| inertia(&pass.quadratic.hessian, resolution)))
    }
}

/// Counts signs of the eigenvalues of `D⁻¹HD⁻¹`, D² the magnitude of H's diagonal: the same signs as H (Sylvester),
/// better resolved. `None` when H is not finite.
fn inertia(hessian: &DMatrix<f64>, resolution: f64) -> Option<Inertia> {
    if !hessian.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let n = hessian.nrows();
    let scale = hessian.diagonal().map(|entry| if entry == 0.0 { 1.0 } else { entry.abs().sqrt() });
    let scaled = DMatrix::from_fn(n, n, |row, column| hessian[(row, column)] / (scale[row] * scale[column]));
    let signs = scaled.symmetric_eigenvalues();
    let zero = resolution * n as f64 * signs.amax();
    let outer = hessian.symmetric_eigenvalues();
    Some(Inertia {
        is_definite: signs.min() > zero,
        negative: signs.iter().filter(|value| **value < -zero).count(),
        outer: [outer.min(), outer.max()],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_of_eigenvalues_are_counted() {
        let of = |rows: &[f64]| inertia(&DMatrix::from_row_slice(2, 2, rows), f64::EPSILON);
        // Far apart in magnitude, and still definite: as px and px⁻².
        assert!(of(&[1e17, 1e6, 1e6, 1.0]).is_some_and(|i| i.is_definite && i.negative == 0));
        assert!(of(&[1.0, 2.0, 2.0, 1.0]).is_some_and(|i| !i.is_definite && i.negative == 1));
        assert!(of(&[-1.0, 0.0, 0.0, -2.0]).is_some_and(|i| i.negative == 2 && i.outer == [-2.0, -1.0]));
        assert!(of(&[1.0, 1.0, 1.0, 1.0]).is_some_and(|i| !i.is_definite && i.negative == 0), "singular");
        assert!(of(&[f64::NAN, 0.0, 0.0, 1.0]).is_none());
    }
}
