//! Stores a [`Finding`] in memory and makes an [`Estimate`] of it.

use isophote_jit::Window;
use nalgebra::DMatrix;

use super::memory::Memory;
use super::pixel_statistics::{log_likelihood, scale};
use super::solver::Solver;
use super::{Finding, RejectedAttempt, quality};
use crate::budget::Spend;
use crate::estimate::{Ending, Estimate, Quality, RejectedFit, TrackState};
use crate::verdict::Verdict;

/// A frame's data for an estimate of a target.
pub(crate) struct EstimateInputs<'a> {
    /// The target's id.
    pub name: String,
    pub sequence: u64,
    pub capture_ns: Option<u64>,
    /// On the clock of the predictions.
    pub time_s: f64,
    /// The part of the frame that may be used.
    pub usable_window: Option<Window>,
    /// Pixel values from here on did not take part; infinite where `observed` is not a plane.
    pub saturation: f64,
    /// Of the frame's budget.
    pub spend: Spend<'a>,
}

/// Stores a frame's outcome for a target in memory, and makes its estimate.
pub(crate) fn estimate(solver: &Solver, memory: &mut Memory, outcome: Finding, inputs: EstimateInputs) -> Estimate {
    let EstimateInputs { name, sequence, capture_ns, time_s, usable_window, saturation, spend } = inputs;
    let (state, attempt, covariance, parameters, verdict, pose) = match outcome {
        Finding::Seen(mut candidate) => {
            memory.update(solver, &candidate, time_s);
            // Published covariances are scaled by the learned noise, this frame's misfit and the correlation of its
            // residuals; the motion model's are not.
            let fit = candidate.attempt.fit.as_ref();
            let noise = memory.noise.ratio().unwrap_or(1.0).powi(2);
            let times = fit.map_or(noise, |fit| scale(solver, fit, candidate.statistics, noise));
            let summary = candidate.attempt.fit.as_mut().and_then(|fit| fit.summary.as_mut());
            if let Some(covariance) = summary.and_then(|summary| summary.covariance.as_mut()) {
                *covariance *= times;
            }
            memory.covariance.iter_mut().for_each(|covariance| *covariance *= times);
            let pose = solver.pose(&candidate.attempt, saturation, spend);
            let summary = candidate.attempt.fit.as_mut().and_then(|fit| fit.summary.as_mut());
            let covariance = summary.and_then(|summary| summary.covariance.take());
            (TrackState::Tracking, candidate.attempt, covariance, memory.last.clone(), candidate.verdict, pose)
        }
        Finding::Coasting(RejectedAttempt { attempt, verdict }, predicted) => {
            let (parameters, covariance) = memory.coasted(solver, &predicted, time_s);
            let pose = solver.pose_of(&parameters, covariance.as_ref());
            (TrackState::Coasting, attempt, covariance, parameters, verdict, pose)
        }
        Finding::Missing(RejectedAttempt { attempt, verdict }) => {
            if !attempt.ending.is_unfinished() {
                memory.lose();
            }
            let state = if memory.found { TrackState::Lost } else { TrackState::Searching };
            (state, attempt, None, memory.last.clone(), verdict, None)
        }
    };
    let good = state == TrackState::Tracking;
    let confidence = verdict.as_ref().map(Verdict::probability);
    let noise = memory.noise.ratio();
    let quality = quality::of(solver, usable_window, &attempt, verdict.as_ref(), memory.noise);
    let (quality, candidate) = match attempt.fit.as_ref().zip(attempt.rejection) {
        _ if good => (quality, None),
        Some((fit, rejection)) => {
            let parameters = fit.parameters.clone();
            (Vec::new(), Some(RejectedFit { parameters, confidence, rejection, quality }))
        }
        None => (Vec::new(), None),
    };
    let ahead = solver.options.predict.map(|options| memory.ahead(time_s, options)).unwrap_or_default();
    let sampled = attempt.fit.as_ref().and_then(|fit| solver.sampled(fit)).filter(|_| good);
    let (stages, summary, substitute) =
        attempt.fit.map_or((Vec::new(), None, None), |fit| (fit.stages, fit.summary, fit.choice));
    let reported = summary.as_ref().filter(|_| good);
    let order = solver.compiled.last_parameters();
    let photometry = match good {
        true => {
            let free = (order, covariance.as_ref());
            solver.profiles.photometry(solver.model(), &solver.constants, &parameters, free)
        }
        false => None,
    };
    let mut estimate = Estimate {
        target: name,
        sequence,
        capture_ns,
        state,
        parameters,
        order: order.to_vec(),
        covariance: covariance.as_ref().map(rows),
        objective: reported.map(|summary| summary.objective),
        reduced_chi_square: reported.and_then(|summary| summary.reduced_chi_square),
        noise_ratio: noise.filter(|_| good),
        log_likelihood: reported.and_then(|summary| log_likelihood(summary, solver.model())),
        confidence: confidence.filter(|_| state != TrackState::Coasting),
        exposure_advice: None,
        ahead,
        pixels: summary.as_ref().map_or(0, |summary| summary.pixels),
        left_out: solver.gaps.as_ref().and(summary.as_ref()).map(|summary| summary.left_out),
        saturated: summary.as_ref().map_or(0.0, |summary| summary.saturated),
        iterations: stages.iter().map(|stage| stage.iterations).collect(),
        converged: good && attempt.ending == Ending::SmallStep,
        ending: attempt.ending,
        rejection: attempt.rejection.filter(|_| !good),
        quality,
        candidate,
        stages,
        substitute: substitute.filter(|_| good),
        sampled,
        strongest: attempt.strongest.filter(|_| !good),
        photometry,
        pose,
    };
    if good {
        let parameters = estimate.at_bounds(solver.model());
        estimate.quality.extend((!parameters.is_empty()).then_some(Quality::AtBound { parameters }));
    }
    estimate
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
