//! A shadow: a second tracker, with another model, on the frames that a session has fitted.
//!
//! What comes in: the session's frames with what it found. What goes out: both estimates side by side. It never harms its session:
//! it has a thread of its own that steps aside, takes the newest frame, and gets none while the session loses some. It ends with
//! the session, and is not declared.

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
use super::searches::SearchRoom;
use super::start::SessionStart;
use super::swap::Active;
use crate::capacity::busy;
use crate::hub::{End, Hub};
use crate::limits::LIMITS;
use crate::preconditions::EntityTag;
use crate::preview::Preview;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::source::Source;
use crate::thread::NamedThread;
use fit::ShadowFitter;
pub use slot::FittedPair;
use slot::ShadowSlot;

/// Frames over which costs are averaged.
const COST_FRAMES: u64 = 16;

/// A shadow that is ready to begin.
pub struct PreparedShadow {
    /// Its model, as it was when it was asked for.
    pub entry: Arc<ModelEntry>,
    /// Its kernels.
    pub compiled: Arc<Compiled>,
    /// The session's options, as far as they apply to it, with constants of its own.
    pub options: TrackerOptions,
    /// These.
    pub constants: BTreeMap<String, f64>,
    /// With what the session knows of its target.
    pub tracker: Tracker,
    /// Parameters that have the session's values.
    pub carried: Vec<String>,
    /// Parameters that start anew.
    pub reset: Vec<String>,
    /// Spent on compilation, ms.
    pub compile_ms: f64,
    /// A fit of it, ms, where there was a frame to try it on.
    pub fit_ms: Option<f64>,
}

impl PreparedShadow {
    /// What was asked for.
    pub fn document(&self) -> ShadowDocument {
        ShadowDocument { model: self.entry.name.to_string(), constants: self.constants.clone() }
    }
}

/// A shadow that runs.
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

/// What its thread shares with the rest of the service.
pub struct ShadowShared {
    slot: ShadowSlot,
    hub: Arc<Hub>,
    preview: Arc<Preview>,
    status: Mutex<ShadowStatus>,
}

/// What it tells about itself.
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

/// Where a shadow belongs.
pub struct ShadowPlace<'a> {
    /// The session's name.
    pub session: &'a str,
    /// Which start of it.
    pub run: &'a SessionStart,
    /// Where its frames come from.
    pub source: &'a Arc<Source>,
    /// Places for searches.
    pub room: &'a Arc<SearchRoom>,
}

impl Shadow {
    /// Starts its thread; it has frames as soon as its session leaves it some.
    pub fn start(place: &ShadowPlace, prepared: PreparedShadow) -> Result<Shadow, Problem> {
        let PreparedShadow { entry, compiled, options, constants, tracker, carried, reset, .. } = prepared;
        let shared = Arc::new(ShadowShared {
            slot: ShadowSlot::default(),
            hub: Arc::default(),
            // It keeps no frame: who looks waits for the next one.
            preview: Arc::new(Preview::new(|| ())),
            status: Mutex::default(),
        });
        let fitter = ShadowFitter {
            session: place.session.to_string(),
            run: place.run.clone(),
            shared: shared.clone(),
            source: place.source.clone(),
            room: place.room.clone(),
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

    /// No two shadows have the same.
    pub fn tag(&self) -> &EntityTag {
        &self.tag
    }

    /// A frame that its session has fitted, after so many that it has not. Never waits.
    pub fn offer(&self, pair: FittedPair, lost: u64) {
        self.shared.slot.offer(pair, lost, monotonic_ns());
    }

    /// Both estimates, frame by frame.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.shared.hub
    }

    /// Constants of its own.
    pub fn constants(&self) -> &BTreeMap<String, f64> {
        &self.constants
    }

    /// Who wants to see what it sees.
    pub fn preview(&self) -> &Arc<Preview> {
        &self.shared.preview
    }

    /// The model that it fits.
    pub fn entry(&self) -> &Arc<ModelEntry> {
        &self.entry
    }

    /// Its kernels and options, with what it knows of the target now.
    ///
    /// # Errors
    /// 409 where it has failed, or does not say.
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

    /// Processors that it keeps busy where it gets all frames; `None` where these wait for their fits.
    pub fn load(&self) -> Option<f64> {
        let rate_hz = self.source.realtime_hz()?;
        let status = self.shared.status();
        let cost_ns = status.cost_ns.filter(|_| status.failed.is_none()).unwrap_or(0);
        Some(busy(cost_ns as f64 * 1e-9, rate_hz))
    }

    fn reason(&self) -> Option<String> {
        self.shared.status().failed.clone()
    }

    /// What it does, and what it has found.
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

    /// Takes no more frames, and gives up the fit that it is at.
    pub fn leave(&self, why: &str) {
        self.shared.slot.close();
        self.shared.hub.end(End::SourceEnded(why.to_string()));
    }

    /// After [`Shadow::leave`]: waits for the thread, until then.
    pub fn wait(&self, until: Instant) {
        self.thread.wait(until);
    }
}
