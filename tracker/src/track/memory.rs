//! What a track remembers: the last good parameters, what they were worth, and how the target moves.

use isophote_symbolic::ParameterId;
use nalgebra::{DMatrix, DVector};

use super::evidence::Ground;
use super::rival::Rival;
use super::search::Candidate;
use super::solver::{Attempt, Solver};
use super::window::half_widths;
use crate::estimate::Ahead;
use crate::options::PredictOptions;
use crate::track::motion::{Measured, Motion, Predicted};

/// From this many measurements on the velocity is known.
const MOVING: u32 = 2;

/// From frame to frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    /// Where the next fit starts: all parameters, those of a swapped model that have a value, or nothing.
    pub warm: Option<Vec<Option<f64>>>,
    /// The last good parameters.
    pub last: Vec<f64>,
    /// Their covariance, of the free ones of the last stage.
    pub covariance: Option<DMatrix<f64>>,
    /// χ²/ν of the last good fit.
    pub reduced: Option<f64>,
    /// The last good fit met saturated pixels.
    pub clipped: bool,
    /// The target was found once.
    pub found: bool,
    /// What was beside it when it was found.
    pub ground: Option<Ground>,
    /// The other pose that may be the true one.
    pub rival: Option<Rival>,
    motion: Option<Motion>,
}

impl Memory {
    /// What is left of it for another model: the values that it takes over.
    pub fn swapped(&self, warm: Option<Vec<Option<f64>>>) -> Memory {
        Memory { warm, clipped: self.clipped, found: self.found, ..Memory::default() }
    }

    /// Where a fit of this frame starts: the last parameters with the centre where it should be; `None` without a complete
    /// set.
    pub fn start(&self, solver: &Solver, time_s: f64) -> Option<Vec<f64>> {
        let mut start: Vec<f64> = self.warm.as_ref()?.iter().copied().collect::<Option<_>>()?;
        if let Some(predicted) = self.predicted(time_s).filter(|_| self.measurements() >= MOVING) {
            place(solver, &mut start, &predicted);
        }
        Some(start)
    }

    /// The target at a time.
    pub fn predicted(&self, time_s: f64) -> Option<Predicted> {
        Some(self.motion.as_ref()?.predict(time_s))
    }

    /// The target from a time on, to a horizon.
    pub fn ahead(&self, time_s: f64, options: PredictOptions) -> Vec<Ahead> {
        let step = |step: usize| {
            let after_s = options.horizon_s * step as f64 / options.steps as f64;
            let (state, spread) = self.predicted(time_s + after_s)?.moving();
            let centres = state.len() / 2;
            Some(Ahead {
                after_s,
                centre: state.rows(0, centres).iter().copied().collect(),
                velocity: state.rows(centres, centres).iter().copied().collect(),
                covariance: spread.row_iter().map(|row| row.iter().copied().collect()).collect(),
            })
        };
        (1..=options.steps).filter_map(step).collect()
    }

    /// Frames in which it was seen since it was found.
    pub fn measurements(&self) -> u32 {
        self.motion.as_ref().map_or(0, |motion| motion.measurements)
    }

    /// When it was seen last.
    pub fn seen_s(&self) -> Option<f64> {
        self.motion.as_ref().map(Motion::time_s)
    }

    /// yᵀS⁻¹y of a fit's centre.
    pub fn distance(&self, solver: &Solver, attempt: &Attempt, time_s: f64) -> Option<(f64, usize)> {
        let measured = measured(solver, attempt)?;
        Some((self.predicted(time_s)?.distance(&measured)?, measured.centres))
    }

    /// Inside the gate, or no farther off than the target is large; true where nothing was expected.
    pub fn is_near(&self, solver: &Solver, attempt: &Attempt, time_s: f64) -> bool {
        let (Some(predicted), Some(measured)) = (self.predicted(time_s), measured(solver, attempt)) else {
            return true;
        };
        if predicted.admits(&measured) {
            return true;
        }
        let (state, _) = predicted.measurable();
        let dimensions = solver.model().coordinates().len();
        let mut at = 0;
        let centres = solver.model().roles().iter().all(|roles| {
            let n = roles.centre.len();
            let off = (measured.values.rows(at, n) - state.rows(at, n)).norm();
            at += n;
            let widths = half_widths(roles, dimensions, &self.last).unwrap_or_default();
            off <= widths.into_iter().fold(0.0, f64::max)
        });
        let positions = measured.centres - at;
        let moved_mm = (measured.values.rows(at, positions) - state.rows(at, positions)).norm();
        centres && (positions == 0 || moved_mm <= solver.target_size_mm())
    }

    /// Half the width of what was seen last, the narrowest of all targets of the model, px.
    pub fn size_px(&self, solver: &Solver) -> Option<f64> {
        let dimensions = solver.model().coordinates().len();
        let known = solver.model().roles().iter().filter(|_| !self.last.is_empty());
        let widths = known.filter_map(|roles| half_widths(roles, dimensions, &self.last)).flatten();
        widths.reduce(f64::min)
    }

    /// The factor by which the area of the outline changed, up or down; 1 where unknown.
    pub fn area_change(&self, solver: &Solver, parameters: &[f64]) -> f64 {
        if self.last.is_empty() {
            return 1.0;
        }
        match (solver.looks(&self.last).0, solver.looks(parameters).0) {
            (Some(old), Some(new)) => (old - new).abs().exp(),
            _ => 1.0,
        }
    }

    /// e-folds between the last looks of the target, or the given ones, and a fit's.
    pub fn strangeness(&self, solver: &Solver, attempt: &Attempt) -> f64 {
        let Some(fit) = &attempt.fit else { return 0.0 };
        let expected = if self.last.is_empty() { solver.given_looks() } else { solver.looks(&self.last) };
        let seen = solver.looks(&fit.parameters);
        let apart = |expected: Option<f64>, seen: Option<f64>| expected.zip(seen).map_or(0.0, |(a, b)| a - b);
        apart(expected.0, seen.0).hypot(apart(expected.1, seen.1))
    }

    /// Takes over what was seen.
    pub fn saw(&mut self, solver: &Solver, candidate: &Candidate, time_s: f64) {
        let Some(fit) = &candidate.attempt.fit else { return };
        let measured = measured(solver, &candidate.attempt);
        let is_near = self.is_near(solver, &candidate.attempt, time_s);
        let acceleration = solver.options.motion.acceleration_px_s2;
        self.motion = match (self.motion.take(), measured) {
            (Some(mut motion), Some(measured)) if is_near => {
                motion.update(&measured, time_s);
                Some(motion)
            }
            (_, Some(measured)) => Some(Motion::begin(&measured, time_s, acceleration)),
            (_, None) => None,
        };
        let mut next = fit.parameters.clone();
        if let Some(geometry) = &solver.geometry {
            geometry.fold(&mut next);
        }
        self.warm = Some(next.into_iter().map(Some).collect());
        self.rival = candidate.attempt.rival.clone();
        self.last = fit.parameters.clone();
        self.covariance = fit.worth.as_ref().and_then(|worth| worth.covariance.clone());
        self.reduced = candidate.attempt.reduced();
        self.clipped = fit.worth.as_ref().is_some_and(|worth| worth.saturated > 0.0);
        self.ground = candidate.ground.or(self.ground);
        self.found = true;
    }

    /// Nobody knows where it is.
    pub fn lose(&mut self) {
        (self.warm, self.reduced, self.motion, self.rival) = (None, None, None, None);
    }

    /// The parameters and their covariance at a predicted place: what the filter does not cover is as it was.
    pub fn coasted(&self, solver: &Solver, predicted: &Predicted) -> (Vec<f64>, Option<DMatrix<f64>>) {
        let mut parameters = self.last.clone();
        place(solver, &mut parameters, predicted);
        let (_, spread) = predicted.measurable();
        let order = solver.compiled.last_parameters();
        let covered: Vec<Option<usize>> = covered(solver)
            .into_iter()
            .map(|index| order.iter().position(|parameter| parameter.index() == index))
            .collect();
        let covariance = self.covariance.clone().map(|mut covariance| {
            for (i, row) in covered.iter().enumerate().filter_map(|(i, row)| Some((i, (*row)?))) {
                covariance.row_mut(row).fill(0.0);
                covariance.column_mut(row).fill(0.0);
                covariance[(row, row)] = spread[(i, i)];
            }
            for (i, j) in (0..covered.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
                if let (Some(row), Some(column)) = (covered[i], covered[j]) {
                    covariance[(row, column)] = spread[(i, j)];
                    covariance[(column, row)] = spread[(i, j)];
                }
            }
            covariance
        });
        (parameters, covariance)
    }
}

/// Parameters that say where things are: the centres of all targets of the model, px, then the position of a pose, mm.
fn places(solver: &Solver) -> impl Iterator<Item = &ParameterId> {
    let roles = solver.model().roles();
    roles.iter().flat_map(|r| &r.centre).chain(roles.iter().flat_map(|r| &r.position))
}

/// Parameters that the filter covers: the places, then the shapes, as indices.
fn covered(solver: &Solver) -> Vec<usize> {
    let shapes = solver.model().roles().iter().flat_map(|r| &r.shape);
    places(solver).chain(shapes).map(|parameter| parameter.index()).collect()
}

/// Moves centres and position to where they are predicted.
fn place(solver: &Solver, parameters: &mut [f64], predicted: &Predicted) {
    let (state, _) = predicted.measurable();
    for (parameter, value) in places(solver).zip(state.iter()) {
        parameters[parameter.index()] = *value;
    }
}

/// Places and shapes of a fit; `None` when they are not all free in the last stage, or their covariance is not known.
fn measured(solver: &Solver, attempt: &Attempt) -> Option<Measured> {
    let fit = attempt.fit.as_ref()?;
    let whole = fit.worth.as_ref()?.covariance.as_ref()?;
    let order = solver.compiled.last_parameters();
    let covered = covered(solver);
    let rows: Option<Vec<usize>> =
        covered.iter().map(|&index| order.iter().position(|parameter| parameter.index() == index)).collect();
    let rows = rows?;
    let centres = places(solver).count();
    if centres == 0 {
        return None;
    }
    let values = DVector::from_iterator(covered.len(), covered.iter().map(|&index| fit.parameters[index]));
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| whole[(rows[i], rows[j])]);
    Some(Measured { centres, values, covariance })
}
