//! A hot swap in two steps: the model is prepared and measured beside the session, then handed to its fit thread.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use isophote_machine::{elapsed_ms, monotonic_ns};
use isophote_tracker::{Carried, Compiled, TrackError, Tracker, TrackerOptions};
use isophote_wire::{SessionDocument, SourceDocument};
use tokio::sync::oneshot;

use super::checks::{check_document, check_shape, tracker, wrong_options};
use super::shared::Shared;
use super::swap::{self, Active, Swap, Swapped};
use super::trial::{FitCost, TrialPair, TrialResult};
use super::{Session, exposed};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::compiler::Owner;
use crate::service::turns::FairWorkers;
use crate::source::{FrameShape, Source, pixel_format, realtime_hz};
use isophote_jit::PixelFormat;

/// A tracker of another model for the session's frames.
pub(super) struct NewTracker {
    pub compiled: Arc<Compiled>,
    pub options: TrackerOptions,
    /// A tracker without history, or the reason why the session's options do not suit the model.
    pub tracker: Result<Tracker, TrackError>,
    /// Time spent on compilation, ms.
    pub compile_ms: f64,
}

/// Whether a swap accepts a model whose fits exceed the source's frame budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlowModels {
    /// Refused, unless the session's document allows it.
    Refused,
    /// Accepted.
    Allowed,
}

/// A model that is ready to be swapped in.
pub struct PreparedSwap {
    swap: Swap,
    answer: oneshot::Receiver<Swapped>,
    /// Time spent on compilation, ms.
    pub compile_ms: f64,
    requested: Requested,
}

impl PreparedSwap {
    /// Whether a shadow takes over.
    pub fn is_promotion(&self) -> bool {
        self.swap.warm.is_some()
    }

    /// Its constants beside the session's.
    pub fn constants(&self) -> &BTreeMap<String, f64> {
        &self.swap.active.constants
    }

    /// Wraps a swap with the receiver of its result, the compilation time and the request to withdraw on failure.
    pub(super) fn new(
        swap: Swap,
        answer: oneshot::Receiver<Swapped>,
        compile_ms: f64,
        requested: Requested,
    ) -> PreparedSwap {
        PreparedSwap { swap, answer, compile_ms, requested }
    }
}

/// Shows a model as the session's requested model; restores the previous one on drop unless the swap is committed.
pub(super) struct Requested {
    shared: Arc<Shared>,
    model: String,
    before: Option<String>,
}

impl Requested {
    pub(super) fn of(shared: &Arc<Shared>, model: &str) -> Requested {
        let before = std::mem::replace(&mut shared.status().requested_model, model.to_string());
        Requested { shared: shared.clone(), model: model.to_string(), before: Some(before) }
    }

    fn keep(mut self) {
        self.before = None;
        self.shared.status().requested_model = std::mem::take(&mut self.model);
    }
}

impl Drop for Requested {
    fn drop(&mut self) {
        if let Some(before) = self.before.take() {
            self.shared.status().requested_model = before;
        }
    }
}

impl Session {
    /// Compiles a model and measures its fit on the newest frame, starting from the session's track. Refuses it if a fit
    /// exceeds the source's frame budget, unless `slow` or the session's document allows that.
    pub fn prepare_swap(
        &self,
        entry: &ModelEntry,
        slow: SlowModels,
        workers: &FairWorkers,
    ) -> Result<PreparedSwap, Problem> {
        let requested = Requested::of(&self.shared, entry.name.as_str());
        let NewTracker { compiled, options, tracker, compile_ms } =
            self.new_tracker(entry, BTreeMap::new(), workers)?;
        // Proves that the session's options suit the model: the swap itself cannot fail.
        let proof = tracker.map_err(|error| Problem::conflict("not-applicable", error.to_string()))?;
        if self.document.options.exposure.control && !proof.advises_exposure() {
            return Err(Problem::conflict("not-applicable", exposed::UNADVISED));
        }
        let (reply, answer) = oneshot::channel();
        let (warm, carried) = (None, Carried::default());
        let active = Active::new(entry, BTreeMap::new());
        let swap = Swap { active, compiled, options, warm, carried, reply };
        if slow == SlowModels::Refused {
            self.check_cost(&swap, workers)?;
        }
        Ok(PreparedSwap { swap, answer, compile_ms, requested })
    }

    /// A tracker of that model with the session's options, as far as they apply, and constants of its own.
    pub(super) fn new_tracker(
        &self,
        entry: &ModelEntry,
        constants: BTreeMap<String, f64>,
        workers: &FairWorkers,
    ) -> Result<NewTracker, Problem> {
        let shape = self.shared.status().shape.clone().unwrap_or_else(|| self.source.source.shape().clone());
        check_shape(&entry.model, &shape).map_err(|message| Problem::conflict("not-applicable", message))?;
        let start_ns = monotonic_ns();
        let compiled = entry.kernels_by(self.document.options.precision, workers)?;
        if let Some(format) = shape.format_for(&entry.model) {
            compiled.warm(self.document.camera.seen_format(format), workers)?;
        }
        let compile_ms = elapsed_ms(start_ns);
        let mut options = swap::options_known(&self.document, &entry.model);
        options.constants.extend(constants);
        let tracker = workers.piece(|| tracker(compiled.clone(), options.clone(), &shape));
        Ok(NewTracker { compiled, options, tracker, compile_ms })
    }

    /// 409 if fits would exceed the frame budget, unless the session's document allows that. Without a frame to measure on,
    /// accepts.
    pub(super) fn check_cost(&self, swap: &Swap, workers: &FairWorkers) -> Result<(), Problem> {
        let budget = self.source.source.frame_budget().filter(|_| !self.document.options.allow_slow);
        let Some(budget) = budget else { return Ok(()) };
        let source = &self.source.source;
        let Some(sample) = source.sample(&self.shared.inbox) else { return Ok(()) };
        let candidate = match &swap.warm {
            Some(warm) => warm.fork(),
            None => {
                let mut candidate = sample.tracker;
                candidate.swap(swap.compiled.clone(), swap.options.clone());
                candidate
            }
        };
        // A model that is cut short now and then is better than none; on a machine that is busy at the moment any model looks
        // slow.
        let most = (2 * budget).max(LIMITS.slow_fit_time);
        let frames = TrialPair::of(source, &self.shared.inbox, sample.delivery);
        let (cost, what) = match FitCost::measured(&candidate, &frames, workers, Some(most)) {
            TrialResult::Fit(cost) => (cost, "a frame, the median of five,"),
            TrialResult::Search(cost) => (cost, "a search that was left before its end"),
        };
        if !cost.exceeds(most) {
            return Ok(());
        }
        let (fit_ms, budget_ms) = (cost.milliseconds(), budget.as_secs_f64() * 1e3);
        let detail = format!(
            "with the model `{}` {what} takes {fit_ms:.1} ms of a processor or more, and frames of the source may take \
             {budget_ms:.1} ms; the running model goes on. With \"allow_slow\": true, in a swap or in the session's options, it \
             is taken even so: fits then end with their best so far",
            swap.active.name
        );
        let problem = Problem::conflict("too-slow", detail);
        Err(problem.with_figure("fit_ms", fit_ms).with_figure("budget_ms", budget_ms))
    }

    /// Hands a model to the fit thread, which takes it between two frames; returns the receiver of its result.
    pub fn commit_swap(
        &self,
        _owner: &mut Owner,
        prepared: PreparedSwap,
    ) -> Result<oneshot::Receiver<Swapped>, Problem> {
        let PreparedSwap { swap, answer, requested, .. } = prepared;
        let gone = |_| Problem::conflict("not-applicable", "the session has ended");
        self.shared.inbox.swap(Box::new(swap)).map_err(gone)?;
        self.swaps.fetch_add(1, Ordering::SeqCst);
        requested.keep();
        Ok(answer)
    }
}

/// Keeps what a session needs at its start compiled while held.
pub struct PreparedSession {
    _compiled: Arc<Compiled>,
    /// Time spent on compilation, ms.
    pub compile_ms: f64,
    /// Frames per second; `None` if they wait for their fits.
    pub realtime_hz: Option<f64>,
    /// Time of a fit, ms, if there was a frame to measure it on.
    pub fit_ms: Option<f64>,
}

/// Compiles the model of a session and, if its source runs in realtime, measures a fit on the newest frame.
pub fn prepare_session(
    document: &SessionDocument,
    running: Option<&Source>,
    own: Option<&SourceDocument>,
    entry: &ModelEntry,
    workers: &FairWorkers,
) -> Result<PreparedSession, Problem> {
    check_document(document)?;
    let shape = match (running, own) {
        (Some(source), _) => source.shape().clone(),
        (None, own) => FrameShape { format: own.and_then(format_of), ..FrameShape::default() },
    };
    let start_ns = monotonic_ns();
    let compiled = entry.kernels_by(document.options.precision, workers)?;
    if let Some(format) = shape.format_for(&entry.model) {
        compiled.warm(document.camera.seen_format(format), workers)?;
    }
    let compile_ms = elapsed_ms(start_ns);
    let of_own = || own.and_then(|own| realtime_hz(own, None));
    let realtime_hz = running.map_or_else(of_own, Source::realtime_hz);
    let prepared = PreparedSession { _compiled: compiled.clone(), compile_ms, realtime_hz, fit_ms: None };
    let Some(source) = running.filter(|_| realtime_hz.is_some()) else { return Ok(prepared) };
    check_shape(&entry.model, &shape).map_err(|message| Problem::wrong_key("wrong-model", "model", message))?;
    let options = swap::options(document);
    let proof = workers.piece(|| tracker(compiled.clone(), options.clone(), &shape));
    proof.map_err(|error| wrong_options(document, entry, &error))?;
    let Some(inbox) = source.first_inbox() else { return Ok(prepared) };
    let Some(sample) = source.sample(&inbox) else { return Ok(prepared) };
    // Sessions on one source see the same: this session's target is probably where another one tracks its own.
    let mut candidate = sample.tracker;
    candidate.swap(compiled, options);
    let frames = TrialPair::of(source, &inbox, sample.delivery);
    let fit_ms = match FitCost::measured(&candidate, &frames, workers, None) {
        TrialResult::Fit(cost) => Some(cost.milliseconds()),
        TrialResult::Search(_) => None,
    };
    Ok(PreparedSession { fit_ms, ..prepared })
}

/// The pixel format of a source that does not run yet, if known.
fn format_of(document: &SourceDocument) -> Option<PixelFormat> {
    match document {
        SourceDocument::Synthetic(synthetic) if synthetic.bits <= 8 => Some(PixelFormat::U8),
        SourceDocument::Synthetic(_) => Some(PixelFormat::U16),
        SourceDocument::Pushed(pushed) => Some(pixel_format(pushed.format)),
        SourceDocument::Recording(_) | SourceDocument::Camera(_) => None,
    }
}
