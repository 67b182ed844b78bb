//! The memory of a track: the last accepted fit, its quality and the target's motion, which give the next fit's start and the
//! expected position.

use isophote_symbolic::ParameterId;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::appearance::Appearance;
use super::candidate::Candidate;
use super::drift::Drift;
use super::noise::NoiseLevel;
use super::pixel_statistics::PixelStatistics;
use super::pose_history::PoseHistory;
use super::rival::Rival;
use super::rows::RowLevel;
use super::shared::SharedParameters;
use super::solver::{Attempt, Solver};
use crate::estimate::Ahead;
use crate::options::PredictOptions;
use crate::outline::{half_widths, sizes};
use crate::solve::exact;
use crate::solve::sampling::SamplingChoice;
use crate::track::motion::{Measured, MotionFilter, Predicted};
use crate::verdict::Verdict;

/// Measurements that determine a velocity.
const MOVING: u32 = 2;

/// The state of a track between frames.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Memory {
    /// Start of the next fit: all parameters; after a swap, those with a carried or stated value; `None` when lost.
    #[serde(with = "exact")]
    pub warm: Option<Vec<Option<f64>>>,
    /// The last good parameters; NaN for those without a value after a swap.
    #[serde(with = "exact")]
    pub last: Vec<f64>,
    /// Their covariance: of the free parameters of the last stage.
    #[serde(with = "exact")]
    pub covariance: Option<DMatrix<f64>>,
    /// χ²/ν of the last good fit that had all kernels it asked for.
    #[serde(rename = "reduced", with = "exact")]
    pub reduced_chi_square: Option<f64>,
    /// The last good fit met saturated pixels.
    pub clipped: bool,
    /// The last good fit was a substitute.
    pub is_substitute: bool,
    /// The target has been found.
    pub found: bool,
    /// Statistics of its pixels.
    #[serde(rename = "ground")]
    pub statistics: PixelStatistics,
    /// The verdict on its identity.
    pub verdict: Option<Verdict>,
    /// Of a pose: the runner-up.
    pub rival: Option<Rival>,
    /// Of a pose: its turns and usual χ²/ν.
    #[serde(rename = "past")]
    pub pose_history: PoseHistory,
    /// Sampling of the pixels in the last good fit.
    #[serde(rename = "chosen")]
    pub sampling_choice: Option<SamplingChoice>,
    /// Pixel noise over the stated one, where the model states it.
    pub noise: NoiseLevel,
    /// Learned offsets of rows, where they are not stated.
    #[serde(default)]
    pub rows: RowLevel,
    /// Its size and brightness.
    #[serde(rename = "looks", default)]
    pub appearance: Appearance,
    motion: Option<MotionFilter>,
    /// Changes of parameters other than positions.
    drift: Drift,
    /// The last fit was of another model: its appearance and misfit cannot be compared.
    is_swapped: bool,
}

impl Memory {
    /// The memory for another model.
    pub fn swapped(&self, shared: &SharedParameters) -> Memory {
        let last: Vec<Option<f64>> = self.last.iter().copied().map(Some).collect();
        let motion = self.motion.as_ref().zip(shared.positions.as_ref());
        let memory = Memory {
            warm: shared.known(self.warm.as_deref()),
            last: shared.known(Some(&last)).map(|last| shared.with_places(last)).unwrap_or_default(),
            covariance: self.covariance.as_ref().and_then(|covariance| shared.covariance(covariance)),
            clipped: self.clipped,
            found: self.found,
            statistics: self.statistics,
            verdict: self.verdict,
            motion: motion.and_then(|(motion, positions)| motion.of_positions(positions)),
            rows: self.rows,
            appearance: self.appearance.swapped(),
            is_swapped: true,
            ..Memory::default()
        };
        match shared.is_same {
            true => Memory {
                reduced_chi_square: self.reduced_chi_square,
                appearance: self.appearance.clone(),
                rival: self.rival.clone(),
                noise: self.noise,
                drift: self.drift.clone(),
                is_swapped: self.is_swapped,
                ..memory
            },
            false => memory,
        }
    }

    /// True when it has as many parameters and positions as the model.
    pub fn suits(&self, solver: &Solver) -> bool {
        let parameters = solver.model().parameters().len();
        let free = solver.compiled.last_parameters().len();
        let is_whole = |values: &Vec<f64>| values.len() == parameters;
        self.warm.as_ref().is_none_or(|warm| warm.len() == parameters)
            && (self.last.is_empty() || is_whole(&self.last))
            && self.covariance.as_ref().is_none_or(|covariance| covariance.shape() == (free, free))
            && self.rival.as_ref().is_none_or(|rival| is_whole(rival.parameters()))
            && self.pose_history.turned().is_none_or(is_whole)
            && self.sampling_choice.as_ref().is_none_or(|sampling_choice| sampling_choice.suits(parameters))
            && self
                .motion
                .as_ref()
                .is_none_or(|motion| motion.predicts_well().count() == position_parameters(solver).count())
    }

    /// The start of a fit in this frame: the last parameters with the centre at its predicted position; `None` if incomplete. A
    /// coordinate starts from its last measurement where predictions have been farther off than that.
    pub fn start(&self, solver: &Solver, predicted: Option<&Predicted>) -> Option<Vec<f64>> {
        let mut start = self.last_start()?;
        let motion = self.motion.as_ref().filter(|motion| motion.measurements >= MOVING);
        if let Some((motion, predicted)) = motion.zip(predicted) {
            let predicted_positions =
                position_parameters(solver).zip(predicted.positions()).zip(motion.predicts_well());
            for ((parameter, value), _) in predicted_positions.filter(|(_, predicts_well)| *predicts_well) {
                start[parameter.index()] = value;
            }
        }
        Some(start)
    }

    /// True when the last parameters are complete and equal `start`.
    pub fn starts_at(&self, start: &[f64]) -> bool {
        let is_same = |(value, start): (&Option<f64>, &f64)| *value == Some(*start);
        self.warm.as_ref().is_some_and(|warm| warm.iter().zip(start).all(is_same))
    }

    /// `parameters` with the target at its predicted position.
    pub fn with_predicted_position(
        &self,
        solver: &Solver,
        mut parameters: Vec<Option<f64>>,
        time_s: f64,
    ) -> Vec<Option<f64>> {
        if let Some(predicted) = self.predicted(time_s) {
            let (state, _) = predicted.positions_with_covariance();
            position_parameters(solver)
                .zip(state.iter())
                .for_each(|(position, at)| parameters[position.index()] = Some(*at));
        }
        parameters
    }

    /// The last parameters, if complete.
    pub fn last_start(&self) -> Option<Vec<f64>> {
        self.warm.as_ref()?.iter().copied().collect()
    }

    /// The predicted positions at a time.
    pub fn predicted(&self, time_s: f64) -> Option<Predicted> {
        Some(self.motion.as_ref()?.predict(time_s))
    }

    /// Predictions from a time on, up to the horizon.
    pub fn ahead(&self, time_s: f64, options: PredictOptions) -> Vec<Ahead> {
        let step = |step: usize| {
            let after_s = options.horizon_s * step as f64 / options.steps as f64;
            let (state, spread) = self.predicted(time_s + after_s)?.state_with_covariance();
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

    /// Frames in which the target was seen since it was found.
    pub fn measurements(&self) -> u32 {
        self.motion.as_ref().map_or(0, |motion| motion.measurements)
    }

    /// The time of the last measurement.
    pub fn seen_s(&self) -> Option<f64> {
        self.motion.as_ref().map(MotionFilter::time_s)
    }

    /// True inside the gate, or no farther off than the target's size, or without a prediction.
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

    /// Half the width of the last fit, px: the narrowest of all targets of the model.
    pub fn size_px(&self, solver: &Solver) -> Option<f64> {
        let dimensions = solver.model().coordinates().len();
        let known = solver.model().roles().iter().filter(|_| !self.last.is_empty());
        let widths = known.filter_map(|roles| half_widths(roles, dimensions, &self.last)).flatten();
        widths.reduce(f64::min)
    }

    /// The last good parameters, if of this model.
    pub fn seen_parameters(&self) -> Option<&[f64]> {
        (!self.last.is_empty() && !self.is_swapped).then_some(&self.last)
    }

    /// The factor by which the outline's area changed, at least 1; 1 where unknown.
    pub fn area_change(&self, solver: &Solver, parameters: &[f64]) -> f64 {
        let Some(last) = self.seen_parameters() else { return 1.0 };
        match (solver.ln_size_and_brightness(last).0, solver.ln_size_and_brightness(parameters).0) {
            (Some(old), Some(new)) => (old - new).abs().exp(),
            _ => 1.0,
        }
    }

    /// Stores an accepted candidate.
    pub fn update(&mut self, solver: &Solver, candidate: &Candidate, time_s: f64) {
        let Some(fit) = &candidate.attempt.fit else { return };
        let measured = measured(solver, &candidate.attempt);
        let is_near = candidate.near.unwrap_or_else(|| self.is_near(solver, &candidate.attempt, time_s));
        self.motion = match (self.motion.take(), measured) {
            (Some(mut motion), Some(measured)) => {
                match is_near {
                    true => motion.update(&measured, time_s),
                    false => motion.reset(&measured, time_s),
                }
                Some(motion)
            }
            (None, Some(measured)) => Some(MotionFilter::new(&measured, time_s, solver.options.motion.density())),
            (_, None) => None,
        };
        if solver.geometry.is_some() {
            let last = self.last_start();
            self.pose_history.update(solver, last.as_deref(), &candidate.attempt);
        }
        self.appearance.update(solver, &candidate.attempt, time_s);
        let mut next = fit.parameters.clone();
        if let Some(geometry) = &solver.geometry {
            geometry.fold(&mut next);
        }
        if let Some(covariance) = fit.summary.as_ref().and_then(|summary| summary.covariance.as_ref()) {
            self.drift.update(solver, &next, covariance, time_s);
        }
        let warm = self.warm.get_or_insert_default();
        warm.clear();
        warm.extend(next.into_iter().map(Some));
        self.rival = candidate.attempt.rival.clone();
        self.last.clone_from(&fit.parameters);
        self.covariance.clone_from(fit.summary.as_ref().map_or(&None, |summary| &summary.covariance));
        if !candidate.lacks_kernels {
            self.reduced_chi_square = candidate.attempt.reduced_chi_square();
        }
        self.is_substitute = candidate.is_substitute();
        self.clipped = fit.summary.as_ref().is_some_and(|summary| summary.saturated > 0.0);
        (self.statistics, self.verdict) = (candidate.statistics, candidate.verdict);
        if let Some(residuals) = self.statistics.residuals.filter(|_| solver.model().has_noise())
            && fit.choice.is_none()
            && fit.ending.is_converged()
        {
            candidate
                .attempt
                .reduced_chi_square()
                .into_iter()
                .for_each(|reduced| self.noise.update(reduced, residuals));
        }
        let residuals = self.statistics.residuals;
        let rows = fit.summary.as_ref().and_then(|summary| solver.of_plane(summary.row_variance?));
        self.rows.update(rows, residuals.and_then(|residuals| residuals.rows));
        self.sampling_choice.clone_from(&fit.sampling_choice);
        (self.found, self.is_swapped) = (true, false);
    }

    /// Marks the target as lost: drops start and motion; keeps the last parameters, appearance and noise levels.
    pub fn lose(&mut self) {
        (self.warm, self.reduced_chi_square, self.motion, self.rival) = (None, None, None, None);
        self.drift = Drift::default();
        self.pose_history.lose();
    }

    /// True when the last good positions are known.
    pub fn is_complete(&self) -> bool {
        !self.last.is_empty()
    }

    /// Parameters and covariance at predicted positions, with the other parameters unchanged. Variances are those of the last
    /// estimate plus the growth of the filters' since. Requires a complete memory.
    pub fn coasted(&self, solver: &Solver, predicted: &Predicted, time_s: f64) -> (Vec<f64>, Option<DMatrix<f64>>) {
        let mut parameters = self.last.clone();
        set_positions(solver, &mut parameters, predicted);
        let seen_s = self.seen_s().unwrap_or(time_s);
        let seen = self.predicted(seen_s);
        let order = solver.compiled.last_parameters();
        let row = |parameter: &ParameterId| order.iter().position(|one| one == parameter);
        let covariance = self.covariance.clone().map(|mut covariance| {
            for (number, row) in position_parameters(solver).map(row).enumerate() {
                let Some(row) = row else { continue };
                let variance = |predicted: &Predicted| predicted.deviation(number).powi(2);
                let grown = variance(predicted) - seen.as_ref().map_or(0.0, variance);
                let before = covariance[(row, row)];
                covariance.row_mut(row).fill(0.0);
                covariance.column_mut(row).fill(0.0);
                covariance[(row, row)] = before + grown.max(0.0);
            }
            for (row, grown) in self.drift.grown(seen_s, time_s) {
                covariance[(row, row)] += grown.max(0.0);
            }
            covariance
        });
        (parameters, covariance)
    }
}

/// Parameters that are positions: centres, then the position of a pose.
fn position_parameters(solver: &Solver) -> impl Iterator<Item = &ParameterId> {
    super::shared::position_parameters(solver.model())
}

/// Sets centres and position to the predicted ones.
fn set_positions(solver: &Solver, parameters: &mut [f64], predicted: &Predicted) {
    let (state, _) = predicted.positions_with_covariance();
    for (parameter, value) in position_parameters(solver).zip(state.iter()) {
        parameters[parameter.index()] = *value;
    }
}

/// Positions of a fit; `None` when they are not all free in the last stage, or their covariance is unknown.
fn measured(solver: &Solver, attempt: &Attempt) -> Option<Measured> {
    let fit = attempt.fit.as_ref()?;
    let full = fit.summary.as_ref()?.covariance.as_ref()?;
    let order = solver.compiled.last_parameters();
    let rows = position_parameters(solver).map(|position| order.iter().position(|parameter| parameter == position));
    let rows: Vec<usize> = rows.collect::<Option<_>>()?;
    if rows.is_empty() {
        return None;
    }
    let values = DVector::from_iterator(
        rows.len(),
        position_parameters(solver).map(|position| fit.parameters[position.index()]),
    );
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| full[(rows[i], rows[j])]);
    Some(Measured { values, covariance })
}
