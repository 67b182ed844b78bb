//! From an outcome to an [`Estimate`], and into memory.

use isophote_jit::Window;
use nalgebra::DMatrix;

use super::ground::{log_likelihood, scale};
use super::memory::Memory;
use super::solver::Solver;
use super::{Finding, NotTaken, quality};
use crate::budget::Spend;
use crate::estimate::{Ending, Estimate, Quality, RejectedFit, TrackState};
use crate::verdict::Verdict;

/// What an estimate says about its frame and target.
pub(crate) struct Told<'a> {
    /// The target's id.
    pub name: String,
    pub sequence: u64,
    pub capture_ns: Option<u64>,
    /// On the clock of the predictions.
    pub time_s: f64,
    /// All that may be looked at.
    pub whole: Option<Window>,
    /// Pixel values from here on did not take part; infinite where `observed` is not a plane.
    pub saturation: f64,
    /// Of the frame's budget.
    pub spend: Spend<'a>,
}

/// Remembers what a frame said about a target, and says it.
pub(crate) fn estimate(solver: &Solver, memory: &mut Memory, outcome: Finding, told: Told) -> Estimate {
    let Told { name, sequence, capture_ns, time_s, whole, saturation, spend } = told;
    let (state, attempt, covariance, parameters, verdict, pose) = match outcome {
        Finding::Seen(mut candidate) => {
            memory.saw(solver, &candidate, time_s);
            // What is published follows the noise that there is, what this frame leaves unexplained, and what hangs together in its
            // residuals; where the target is looked for does not.
            let fit = candidate.attempt.fit.as_ref();
            let noise = memory.noise.ratio().unwrap_or(1.0).powi(2);
            let times = fit.map_or(noise, |fit| scale(solver, fit, candidate.ground, noise));
            let worth = candidate.attempt.fit.as_mut().and_then(|fit| fit.worth.as_mut());
            if let Some(covariance) = worth.and_then(|worth| worth.covariance.as_mut()) {
                *covariance *= times;
            }
            let pose = solver.pose(&candidate.attempt, saturation, spend);
            let worth = candidate.attempt.fit.as_mut().and_then(|fit| fit.worth.as_mut());
            let covariance = worth.and_then(|worth| worth.covariance.take());
            (TrackState::Tracking, candidate.attempt, covariance, memory.last.clone(), candidate.verdict, pose)
        }
        Finding::Coasting(NotTaken { attempt, verdict }, predicted) => {
            let (parameters, covariance) = memory.coasted(solver, &predicted, time_s);
            let pose = solver.pose_of(&parameters, covariance.as_ref());
            (TrackState::Coasting, attempt, covariance, parameters, verdict, pose)
        }
        Finding::Missing(NotTaken { attempt, verdict }) => {
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
    let quality = quality::of(solver, whole, &attempt, verdict.as_ref(), noise);
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
    let (stages, worth, substitute) =
        attempt.fit.map_or((Vec::new(), None, None), |fit| (fit.stages, fit.worth, fit.choice));
    let told = worth.as_ref().filter(|_| good);
    let mut estimate = Estimate {
        target: name,
        sequence,
        capture_ns,
        state,
        parameters,
        order: solver.compiled.last_parameters().to_vec(),
        covariance: covariance.as_ref().map(rows),
        objective: told.map(|worth| worth.objective),
        reduced_chi_square: told.and_then(|worth| worth.reduced),
        noise_ratio: noise.filter(|_| good),
        log_likelihood: told.and_then(|worth| log_likelihood(worth, solver.model())),
        confidence: confidence.filter(|_| state != TrackState::Coasting),
        exposure_advice: None,
        ahead,
        pixels: worth.as_ref().map_or(0, |worth| worth.pixels),
        left_out: solver.gaps.as_ref().and(worth.as_ref()).map(|worth| worth.left_out),
        saturated: worth.as_ref().map_or(0.0, |worth| worth.saturated),
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
