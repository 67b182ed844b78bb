//! The tracker of a recorded session: restores snapshots, takes swaps and repeats fits under their recorded
//! conditions.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use isophote_jit::{KernelCache, Processor, VectorWidth};
use isophote_machine::Threads;
use isophote_symbolic::Model;
use isophote_tracker::{Compiled, Estimate, Frame, Stop, Tracker, TrackerOptions, Watch};
use isophote_wire::{
    EstimateView, LoggedFit, LoggedSession, LoggedSnapshot, LoggedStop, LoggedSwap, StopReason, options_known,
};

use super::log::RecordedFit;
use crate::failure::Failure;

/// A tracker that repeats recorded fits.
pub struct Refit {
    tracker: Tracker,
    /// The active model.
    pub model: Arc<Model>,
    id: String,
}

/// Stops a frame at the recorded pass.
struct RecordedWatch {
    stopped: Option<LoggedStop>,
    asked: AtomicU64,
    /// Searches still to be postponed.
    postponed: AtomicU32,
}

impl Watch for RecordedWatch {
    fn stop(&self) -> Option<Stop> {
        let pass = self.asked.fetch_add(1, Ordering::Relaxed);
        let stopped = self.stopped.filter(|stopped| pass >= stopped.pass)?;
        Some(match stopped.why {
            StopReason::Budget => Stop::Budget,
            StopReason::Cancelled => Stop::Cancelled,
        })
    }

    fn search(&self) -> Option<Stop> {
        let left = self.postponed.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
        left.is_ok().then_some(Stop::Postponed)
    }
}

/// The recording's vector width, if this processor has it.
fn width(swap: &LoggedSwap) -> Result<VectorWidth, Failure> {
    let bits = swap.vector_width;
    let known = VectorWidth::ALL.into_iter().find(|width| 8 * width.bytes() == bits);
    known.filter(|width| Processor::Host.has(*width)).ok_or_else(|| {
        let reason = format!("it was fitted with vectors of {bits} bits, which this processor does not have");
        Failure::Other(format!("the fits cannot be repeated bit for bit: {reason}"))
    })
}

/// Parses the document of a swap.
pub fn model(swap: &LoggedSwap) -> Result<Arc<Model>, Failure> {
    let read =
        if swap.media == "application/toml" { Model::from_toml(&swap.text) } else { Model::from_json(&swap.text) };
    read.map(Arc::new).map_err(|diagnostics| Failure::model(&swap.name, &diagnostics))
}

fn compiled(swap: &LoggedSwap, session: &LoggedSession) -> Result<(Arc<Model>, Arc<Compiled>), Failure> {
    let (model, cache) = (model(swap)?, Arc::new(KernelCache::of_width(width(swap)?)));
    let compiled = Compiled::with_cache(model.clone(), session.document.options.precision, cache, &Threads);
    let refused = |failure| Failure::model(&swap.name, &isophote_wire::explain::diagnostics(&failure));
    Ok((model, Arc::new(compiled.map_err(refused)?)))
}

/// The session's options for the swapped model.
fn options(swap: &LoggedSwap, session: &LoggedSession, model: &Model) -> TrackerOptions {
    TrackerOptions { constants: swap.constants.clone(), ..options_known(&session.document, model) }
}

impl Refit {
    /// A fresh tracker.
    pub fn new(swap: &LoggedSwap, session: &LoggedSession) -> Result<Refit, Failure> {
        let (model, compiled) = compiled(swap, session)?;
        let tracker = Tracker::new(compiled, options(swap, session, &model)).map_err(Failure::other)?;
        Ok(Refit { tracker, model, id: swap.model.clone() })
    }

    /// Swaps the model.
    pub fn swap(&mut self, swap: &LoggedSwap, session: &LoggedSession) -> Result<(), Failure> {
        let (model, compiled) = compiled(swap, session)?;
        self.tracker.swap(compiled, options(swap, session, &model));
        (self.model, self.id) = (model, swap.model.clone());
        Ok(())
    }

    /// Restores a snapshot.
    pub fn restore(&mut self, logged: &LoggedSnapshot) -> Result<(), Failure> {
        let snapshot = serde_json::from_value(logged.snapshot.clone())
            .map_err(|error| Failure::Other(format!("a snapshot cannot be read: {error}")))?;
        self.tracker.restore(snapshot).map_err(Failure::other)
    }

    /// The tracker's state.
    pub fn snapshot(&self) -> Result<serde_json::Value, Failure> {
        serde_json::to_value(self.tracker.snapshot()).map_err(Failure::other)
    }

    /// Repeats the fit of a frame; `None` without its pixels.
    pub fn fit(&mut self, recorded: &RecordedFit) -> Result<Option<Vec<(EstimateView, Estimate)>>, Failure> {
        let Some(frame) = frame(recorded)? else { return Ok(None) };
        let LoggedFit { ready, stopped, postponed, has_jumped, .. } = recorded.fit;
        if has_jumped {
            self.tracker.lose();
        }
        let watch = RecordedWatch { stopped, asked: AtomicU64::new(0), postponed: AtomicU32::new(postponed) };
        let estimates = self.tracker.track_all_again(&frame, ready, &watch);
        let view = |estimate: Estimate| (EstimateView::new(&self.model, &self.id, frame.sequence, &estimate), estimate);
        Ok(Some(estimates.into_iter().map(view).collect()))
    }
}

/// The frame of a fit, with its recorded times and number.
pub fn frame(recorded: &RecordedFit) -> Result<Option<Frame>, Failure> {
    let Some(picture) = &recorded.picture else { return Ok(None) };
    let fit = &recorded.fit;
    let frame = picture.frame().transpose().map_err(|error| Failure::Other(format!("frame {}: {error}", fit.frame)))?;
    Ok(frame.map(|frame| {
        let frame = frame.with_sequence(fit.frame).with_capture_ns(fit.capture_ns).with_time_s(fit.time_s);
        fit.largest.map_or_else(|| frame.clone(), |largest| frame.clone().with_largest(largest))
    }))
}
