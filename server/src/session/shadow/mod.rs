//! A shadow: a second tracker, with another model, on the frames that a session has fitted; it publishes both estimates side by
//! side.
//!
//! It never slows its session: its thread runs at low priority, takes only the newest frame, and gets none while the session
//! drops frames. It ends with the session and is not declared.

mod fit;
mod slot;

use std::collections::BTreeMap;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_machine::monotonic_ns;
use isophote_tracker::{Compiled, Tracker, TrackerOptions};
use isophote_wire::{ShadowDocument, ShadowState, ShadowView};

use super::beside::PreparationThread;
use super::searches::SearchQuota;
use super::start::SessionStart;
use super::swap::Active;
use crate::http::preconditions::EntityTag;
use crate::hub::{End, Hub};
use crate::limits::LIMITS;
use crate::preview::Preview;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::capacity::busy;
use crate::source::Source;
use crate::thread::NamedThread;
use fit::ShadowFitter;
pub use slot::FittedPair;
use slot::ShadowSlot;

/// Length of the exponential average of the frame cost, frames.
const COST_FRAMES: u64 = 16;

/// A shadow that is ready to start.
pub struct PreparedShadow {
    /// The version of its model when it was requested.
    pub entry: Arc<ModelEntry>,
    /// Its kernels.
    pub compiled: Arc<Compiled>,
    /// The session's options, as far as they apply, with `constants`.
    pub options: TrackerOptions,
    /// Its own constants.
    pub constants: BTreeMap<String, f64>,
    /// A tracker that continues the session's track.
    pub tracker: Tracker,
    /// Parameters that keep the session's values.
    pub carried: Vec<String>,
    /// Parameters that start anew.
    pub reset: Vec<String>,
    /// Time spent on compilation, ms.
    pub compile_ms: f64,
    /// Time of a fit, ms, if there was a frame to measure it on.
    pub fit_ms: Option<f64>,
}

impl PreparedShadow {
    /// The requested document.
    pub fn document(&self) -> ShadowDocument {
        ShadowDocument { model: self.entry.name.to_string(), constants: self.constants.clone() }
    }
}

/// A running shadow.
pub struct Shadow {
    tag: EntityTag,
    entry: Arc<ModelEntry>,
    compiled: Arc<Compiled>,
    options: TrackerOptions,
    constants: BTreeMap<String, f64>,
    carried: Vec<String>,
    reset: Vec<String>,
    source: Arc<Source>,
    shared: Arc<ShadowShared>,
    thread: NamedThread,
}

/// State shared between its thread and the rest of the service.
pub struct ShadowShared {
    slot: ShadowSlot,
    hub: Arc<Hub>,
    preview: Arc<Preview>,
    status: Mutex<ShadowStatus>,
}

/// The shadow's counters and state.
#[derive(Default)]
pub struct ShadowStatus {
    frames: u64,
    over_budget: u64,
    since_frame: Option<u64>,
    cost_ns: Option<u64>,
    failed: Option<String>,
}

impl ShadowStatus {
    fn cost(&mut self, frame_ns: u64) {
        let share = |mean_ns: u64| (mean_ns * (COST_FRAMES - 1) + frame_ns) / COST_FRAMES;
        self.cost_ns = Some(self.cost_ns.map_or(frame_ns, share));
    }
}

impl ShadowShared {
    fn status(&self) -> MutexGuard<'_, ShadowStatus> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The context that a shadow takes from its session.
pub struct ShadowPlace<'a> {
    /// The session's name.
    pub session: &'a str,
    /// The current start of the session.
    pub run: &'a SessionStart,
    /// The source of its frames.
    pub source: &'a Arc<Source>,
    /// Limits whole-frame searches.
    pub quota: &'a Arc<SearchQuota>,
}

impl Shadow {
    /// Starts its thread; the session offers it frames.
    pub fn start(place: &ShadowPlace, prepared: PreparedShadow) -> Result<Shadow, Problem> {
        let PreparedShadow { entry, compiled, options, constants, tracker, carried, reset, .. } = prepared;
        let shared = Arc::new(ShadowShared {
            slot: ShadowSlot::default(),
            hub: Arc::default(),
            // The shadow keeps no frame: viewers wait for the next one.
            preview: Arc::new(Preview::new(|| ())),
            status: Mutex::default(),
        });
        let fitter = ShadowFitter {
            session: place.session.to_string(),
            run: place.run.clone(),
            shared: shared.clone(),
            source: place.source.clone(),
            quota: place.quota.clone(),
            tracker,
            active: Active::new(&entry, constants.clone()),
            beside: PreparationThread::default(),
            jumps: None,
            viewer: None,
        };
        let thread = NamedThread::start(format!("shadow {}", place.session), move || fitter.run())
            .map_err(|error| Problem::no_thread("for the shadow", &error))?;
        let source = place.source.clone();
        let tag = EntityTag::unique();
        Ok(Shadow { tag, entry, compiled, options, constants, carried, reset, source, shared, thread })
    }

    /// A tag unique to this shadow.
    pub fn tag(&self) -> &EntityTag {
        &self.tag
    }

    /// Offers a frame that the session has fitted, after `lost` dropped ones. Never blocks.
    pub fn offer(&self, pair: FittedPair, lost: u64) {
        self.shared.slot.offer(pair, lost, monotonic_ns());
    }

    /// Publishes both estimates of each frame.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.shared.hub
    }

    /// Its own constants.
    pub fn constants(&self) -> &BTreeMap<String, f64> {
        &self.constants
    }

    /// Its preview images.
    pub fn preview(&self) -> &Arc<Preview> {
        &self.shared.preview
    }

    /// The model that it fits.
    pub fn entry(&self) -> &Arc<ModelEntry> {
        &self.entry
    }

    /// Its kernels, options and current tracker.
    ///
    /// # Errors
    /// 409 if it has failed or does not answer.
    pub fn tracked(&self) -> Result<(Arc<Compiled>, TrackerOptions, Tracker), Problem> {
        let (reply, answer) = sync_channel(1);
        self.shared.slot.ask(reply);
        let silent = |_| {
            let reason = self.reason().unwrap_or_else(|| "it does not answer".to_string());
            Problem::conflict("not-applicable", format!("the shadow cannot take over: {reason}"))
        };
        let tracker = answer.recv_timeout(LIMITS.sample_time).map_err(silent)?;
        Ok((self.compiled.clone(), self.options.clone(), tracker))
    }

    /// Processors that it would keep busy if it fitted all frames; `None` if frames wait for their fits.
    pub fn load(&self) -> Option<f64> {
        let rate_hz = self.source.realtime_hz()?;
        let status = self.shared.status();
        let cost_ns = status.cost_ns.filter(|_| status.failed.is_none()).unwrap_or(0);
        Some(busy(cost_ns as f64 * 1e-9, rate_hz))
    }

    fn reason(&self) -> Option<String> {
        self.shared.status().failed.clone()
    }

    /// Its state and last estimate.
    pub fn view(&self) -> ShadowView {
        let (dropped, is_shed) = self.shared.slot.shed(monotonic_ns());
        let last = self.shared.hub.last().and_then(|both| both.shadow.clone());
        let status = self.shared.status();
        let (state, reason) = match &status.failed {
            Some(reason) => (ShadowState::Failed, Some(reason.clone())),
            None if is_shed => {
                let seconds = LIMITS.shed_time.as_secs();
                let reason =
                    format!("the session lost frames; the shadow waits until it has lost none for {seconds} s");
                (ShadowState::Shed, Some(reason))
            }
            None if status.frames == 0 => (ShadowState::Starting, None),
            None => (ShadowState::Running, None),
        };
        ShadowView {
            model: self.entry.name.to_string(),
            digest: self.entry.model.digest().to_string(),
            state,
            reason,
            since_frame: status.since_frame,
            frames: status.frames,
            dropped,
            over_budget: status.over_budget,
            cost_ms: status.cost_ns.map(|cost_ns| cost_ns as f64 / 1e6),
            carried: self.carried.clone(),
            reset: self.reset.clone(),
            last,
        }
    }

    /// Takes no more frames and abandons the current fit.
    pub fn leave(&self, why: &str) {
        self.shared.slot.close();
        self.shared.hub.end(End::SourceEnded(why.to_string()));
    }

    /// After [`Shadow::leave`]: waits for the thread until `until`.
    pub fn wait(&self, until: Instant) {
        self.thread.wait(until);
    }
}
