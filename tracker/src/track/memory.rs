//! What a track remembers: the last good parameters, what they were worth, and how the target moves.
//!
//! What comes in: fits that are believed, with their time. What goes out: where the next fit begins, and what is expected of
//! it. It never knows a frame.

use isophote_symbolic::ParameterId;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::candidate::Candidate;
use super::ground::Ground;
use super::looks::Likeness;
use super::noise::NoiseLevel;
use super::past::Past;
use super::rival::Rival;
use super::rows::RowLevel;
use super::shared::SharedParameters;
use super::solver::{Attempt, Solver};
use crate::estimate::Ahead;
use crate::options::PredictOptions;
use crate::outline::{half_widths, sizes};
use crate::solve::exact;
use crate::solve::sampling::Chosen;
use crate::track::motion::{Measured, Mover, Predicted};
use crate::verdict::Verdict;

/// From this many measurements on the velocity is known.
const MOVING: u32 = 2;
/// Relative drift of A's entries in a second, while nothing is seen.
const DRIFT: f64 = 1.0;

/// From frame to frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Memory {
    /// Where the next fit starts: all parameters, those of a swapped model that have a value, or nothing.
    #[serde(with = "exact")]
    pub warm: Option<Vec<Option<f64>>>,
    /// The last good parameters; NaN for those that a swapped model does not share.
    #[serde(with = "exact")]
    pub last: Vec<f64>,
    /// Their covariance, of the free ones of the last stage.
    #[serde(with = "exact")]
    pub covariance: Option<DMatrix<f64>>,
    /// χ²/ν of the last good fit for which all kernels were there.
    #[serde(with = "exact")]
    pub reduced: Option<f64>,
    /// The last good fit met saturated pixels.
    pub clipped: bool,
    /// It was one of the model's alternatives.
    pub is_substitute: bool,
    /// The target was found once.
    pub found: bool,
    /// Knowledge of its pixels, and of those beside it.
    pub ground: Ground,
    /// How likely it is the target.
    pub verdict: Option<Verdict>,
    /// The other pose that may be the true one.
    pub rival: Option<Rival>,
    /// Of a pose: what else is remembered of it.
    pub past: Past,
    /// How pixels were sampled when it was seen last.
    pub chosen: Option<Chosen>,
    /// How noisy its pixels are, where the model says what they should be.
    pub noise: NoiseLevel,
    /// What rows are off by, where nobody says it.
    #[serde(default)]
    pub rows: RowLevel,
    /// How large it is.
    #[serde(default)]
    pub looks: Likeness,
    motion: Option<Mover>,
    /// What was seen last was seen by another model: looks and misfit cannot be compared.
    is_swapped: bool,
}

impl Memory {
    /// What is left of it for another model.
    pub fn swapped(&self, shared: &SharedParameters) -> Memory {
        let last: Vec<Option<f64>> = self.last.iter().copied().map(Some).collect();
        let motion = self.motion.as_ref().zip(shared.places.as_ref());
        let memory = Memory {
            warm: shared.known(self.warm.as_deref()),
            last: shared.known(Some(&last)).map(|last| shared.with_places(last)).unwrap_or_default(),
            covariance: self.covariance.as_ref().and_then(|covariance| shared.covariance(covariance)),
            clipped: self.clipped,
            found: self.found,
            ground: self.ground,
            verdict: self.verdict,
            motion: motion.and_then(|(motion, places)| motion.of_places(places)),
            rows: self.rows,
            looks: self.looks.swapped(),
            is_swapped: true,
            ..Memory::default()
        };
        match shared.is_same {
            true => Memory {
                reduced: self.reduced,
                looks: self.looks.clone(),
                rival: self.rival.clone(),
                noise: self.noise,
                is_swapped: self.is_swapped,
                ..memory
            },
            false => memory,
        }
    }

    /// Whether it has as many parameters and places as the model.
    pub fn suits(&self, solver: &Solver) -> bool {
        let parameters = solver.model().parameters().len();
        let free = solver.compiled.last_parameters().len();
        let is_whole = |values: &Vec<f64>| values.len() == parameters;
        self.warm.as_ref().is_none_or(|warm| warm.len() == parameters)
            && (self.last.is_empty() || is_whole(&self.last))
            && self.covariance.as_ref().is_none_or(|covariance| covariance.shape() == (free, free))
            && self.rival.as_ref().is_none_or(|rival| is_whole(rival.parameters()))
            && self.past.turned().is_none_or(is_whole)
            && self.chosen.as_ref().is_none_or(|chosen| chosen.suits(parameters))
            && self.motion.as_ref().is_none_or(|motion| motion.foresees().count() == places(solver).count())
    }

    /// Where a fit of this frame starts: the last parameters with the centre where it is predicted; `None` without a complete
    /// set. A coordinate whose predictions have been farther off than its last measurement starts from that.
    pub fn start(&self, solver: &Solver, predicted: Option<&Predicted>) -> Option<Vec<f64>> {
        let mut start = self.last_start()?;
        let motion = self.motion.as_ref().filter(|motion| motion.measurements >= MOVING);
        if let Some((motion, predicted)) = motion.zip(predicted) {
            let foreseen = places(solver).zip(predicted.positions()).zip(motion.foresees());
            for ((parameter, value), _) in foreseen.filter(|(_, foresees)| *foresees) {
                start[parameter.index()] = value;
            }
        }
        Some(start)
    }

    /// Whether that is where the last parameters are, all of which are known.
    pub fn starts_at(&self, start: &[f64]) -> bool {
        let is_same = |(value, start): (&Option<f64>, &f64)| *value == Some(*start);
        self.warm.as_ref().is_some_and(|warm| warm.iter().zip(start).all(is_same))
    }

    /// Parameters with the target where it should be.
    pub fn foreseen(&self, solver: &Solver, mut parameters: Vec<Option<f64>>, time_s: f64) -> Vec<Option<f64>> {
        if let Some(predicted) = self.predicted(time_s) {
            let (state, _) = predicted.places();
            places(solver).zip(state.iter()).for_each(|(place, at)| parameters[place.index()] = Some(*at));
        }
        parameters
    }

    /// The last parameters as they were.
    pub fn last_start(&self) -> Option<Vec<f64>> {
        self.warm.as_ref()?.iter().copied().collect()
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
        self.motion.as_ref().map(Mover::time_s)
    }

    /// Inside the gate, or no farther off than the target is large; true where nothing was expected.
    pub fn is_near(&self, solver: &Solver, attempt: &Attempt, time_s: f64) -> bool {
        let (Some(predicted), Some(measured)) = (self.predicted(time_s), measured(solver, attempt)) else {
            return true;
        };
        if predicted.admits(&measured) {
            return true;
        }
        let state = DVector::from_iterator(measured.values.len(), predicted.positions());
        let dimensions = solver.model().coordinates().len();
        let mut at = 0;
        let centres = solver.model().roles().iter().all(|roles| {
            let n = roles.centre.len();
            let off = (measured.values.rows(at, n) - state.rows(at, n)).norm();
            at += n;
            let widest = half_widths(roles, dimensions, &self.last).map(|widths| widths.fold(0.0, f64::max));
            off <= widest.unwrap_or_else(|| sizes(solver.model(), &self.last).into_iter().fold(0.0, f64::max))
        });
        let positions = measured.values.len() - at;
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

    /// The last good parameters, where this model has seen them.
    pub fn looked(&self) -> Option<&[f64]> {
        (!self.last.is_empty() && !self.is_swapped).then_some(&self.last)
    }

    /// The factor by which the area of the outline changed, up or down; 1 where unknown.
    pub fn area_change(&self, solver: &Solver, parameters: &[f64]) -> f64 {
        let Some(last) = self.looked() else { return 1.0 };
        match (solver.looks(last).0, solver.looks(parameters).0) {
            (Some(old), Some(new)) => (old - new).abs().exp(),
            _ => 1.0,
        }
    }

    /// Takes over what was seen.
    pub fn saw(&mut self, solver: &Solver, candidate: &Candidate, time_s: f64) {
        let Some(fit) = &candidate.attempt.fit else { return };
        let measured = measured(solver, &candidate.attempt);
        let is_near = candidate.near.unwrap_or_else(|| self.is_near(solver, &candidate.attempt, time_s));
        self.motion = match (self.motion.take(), measured) {
            (Some(mut motion), Some(measured)) => {
                match is_near {
                    true => motion.update(&measured, time_s),
                    false => motion.begin_again(&measured, time_s),
                }
                Some(motion)
            }
            (None, Some(measured)) => Some(Mover::begin(&measured, time_s, solver.options.motion.density())),
            (_, None) => None,
        };
        if solver.geometry.is_some() {
            let last = self.last_start();
            self.past.saw(solver, last.as_deref(), &candidate.attempt);
        }
        self.looks.saw(solver, &candidate.attempt, time_s);
        let mut next = fit.parameters.clone();
        if let Some(geometry) = &solver.geometry {
            geometry.fold(&mut next);
        }
        let warm = self.warm.get_or_insert_default();
        warm.clear();
        warm.extend(next.into_iter().map(Some));
        self.rival = candidate.attempt.rival.clone();
        self.last.clone_from(&fit.parameters);
        self.covariance.clone_from(fit.worth.as_ref().map_or(&None, |worth| &worth.covariance));
        if !candidate.is_lacking {
            self.reduced = candidate.attempt.reduced();
        }
        self.is_substitute = candidate.is_substitute();
        self.clipped = fit.worth.as_ref().is_some_and(|worth| worth.saturated > 0.0);
        (self.ground, self.verdict) = (candidate.ground, candidate.verdict);
        if let Some(own) = self.ground.own.filter(|_| solver.model().has_noise())
            && fit.choice.is_none()
            && fit.ending.is_converged()
        {
            candidate.attempt.reduced().into_iter().for_each(|reduced| self.noise.saw(reduced, own));
        }
        let own = self.ground.own;
        let rows = fit.worth.as_ref().and_then(|worth| solver.of_plane(worth.row_variance?));
        self.rows.saw(rows, own.and_then(|own| own.rows));
        self.chosen.clone_from(&fit.chosen);
        (self.found, self.is_swapped) = (true, false);
    }

    /// Nobody knows where it is.
    pub fn lose(&mut self) {
        (self.warm, self.reduced, self.motion, self.rival) = (None, None, None, None);
        self.past.lose();
    }

    /// The last good parameters are known, at least those that say where it is.
    pub fn is_complete(&self) -> bool {
        !self.last.is_empty()
    }

    /// The parameters and their covariance at a predicted place: what is not a place is as it was, and outlines drift. Of a
    /// memory that is complete.
    pub fn coasted(&self, solver: &Solver, predicted: &Predicted, time_s: f64) -> (Vec<f64>, Option<DMatrix<f64>>) {
        let mut parameters = self.last.clone();
        place(solver, &mut parameters, predicted);
        let (_, spread) = predicted.places();
        let order = solver.compiled.last_parameters();
        let row = |parameter: &ParameterId| order.iter().position(|one| one == parameter);
        let rows: Vec<Option<usize>> = places(solver).map(row).collect();
        let unseen_s = self.seen_s().map_or(0.0, |seen_s| time_s - seen_s);
        let covariance = self.covariance.clone().map(|mut covariance| {
            for row in rows.iter().flatten() {
                covariance.row_mut(*row).fill(0.0);
                covariance.column_mut(*row).fill(0.0);
            }
            for (i, j) in (0..rows.len()).flat_map(|i| (0..rows.len()).map(move |j| (i, j))) {
                if let (Some(row), Some(column)) = (rows[i], rows[j]) {
                    covariance[(row, column)] = spread[(i, j)];
                }
            }
            for roles in solver.model().roles() {
                // An entry of A off the diagonal may be 0, so all drift by the largest.
                let largest = roles.shape.iter().map(|entry| parameters[entry.index()].abs()).fold(0.0, f64::max);
                for row in roles.shape.iter().filter_map(row) {
                    covariance[(row, row)] += (DRIFT * largest).powi(2) * unseen_s;
                }
            }
            covariance
        });
        (parameters, covariance)
    }
}

/// Parameters that say where things are.
fn places(solver: &Solver) -> impl Iterator<Item = &ParameterId> {
    super::shared::places(solver.model())
}

/// Moves centres and position to where they are predicted.
fn place(solver: &Solver, parameters: &mut [f64], predicted: &Predicted) {
    let (state, _) = predicted.places();
    for (parameter, value) in places(solver).zip(state.iter()) {
        parameters[parameter.index()] = *value;
    }
}

/// Places of a fit; `None` when they are not all free in the last stage, or their covariance is not known.
fn measured(solver: &Solver, attempt: &Attempt) -> Option<Measured> {
    let fit = attempt.fit.as_ref()?;
    let whole = fit.worth.as_ref()?.covariance.as_ref()?;
    let order = solver.compiled.last_parameters();
    let rows = places(solver).map(|place| order.iter().position(|parameter| parameter == place));
    let rows: Vec<usize> = rows.collect::<Option<_>>()?;
    if rows.is_empty() {
        return None;
    }
    let values = DVector::from_iterator(rows.len(), places(solver).map(|place| fit.parameters[place.index()]));
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| whole[(rows[i], rows[j])]);
    Some(Measured { values, covariance })
}
