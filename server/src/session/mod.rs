//! A session: one named fit thread that follows one target in the frames of one source.

mod beside;
mod change;
mod checks;
mod event_log;
mod exposed;
mod fit;
pub mod inbox;
mod once;
mod publish;
mod recorder;
mod recording;
mod searches;
mod shadow;
mod shadowed;
mod shared;
mod start;
mod status;
mod swap;
mod trial;
mod watch;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::counters::SessionCounters;
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::hub::{End, Hub};
use crate::limits::LIMITS;
use crate::preview::Preview;
use crate::problem::Problem;
use crate::recording::{RecordingFolder, SessionRecording};
use crate::registry::ModelEntry;
use crate::service::capacity::busy;
use crate::source::Source;
use crate::thread::NamedThread;
use beside::PreparationThread;
pub use change::{PreparedSession, PreparedSwap, SlowModels, prepare_session};
use checks::{check_document, check_shape, tracker, wrong_options};
use event_log::EventLog;
use exposed::ExposureKnob;
use fit::Fitter;
use inbox::Inbox;
use isophote_machine::{Threads, elapsed_ms, monotonic_ns, program_checksum};
use isophote_wire::{
    LOG_VERSION, LoggedBuild, LoggedSession, RecordDocument, RecordingView, SessionDocument, SessionState, SessionView,
};
pub use once::fit_once;
use recorder::FitRecorder;
pub use recording::BegunRecording;
use recording::LastRecording;
pub use searches::SearchQuota;
pub use shadow::PreparedShadow;
use shared::Shared;
pub use start::SessionStart;
use status::Status;
use swap::Active;
pub use swap::Swapped;
use watch::FrameTimes;

/// The source of a session.
#[derive(Clone)]
pub struct SourceOf {
    /// The running source.
    pub source: Arc<Source>,
    /// Whether it was opened for the session and ends with it.
    pub is_own: bool,
}

/// A running session.
pub struct Session {
    name: String,
    document: SessionDocument,
    source: SourceOf,
    shared: Arc<Shared>,
    thread: NamedThread,
    quota: Arc<SearchQuota>,
    compile_ms: f64,
    run: SessionStart,
    /// Number of swaps committed so far.
    swaps: AtomicU64,
    recorded: LastRecording,
}

impl Session {
    /// Compiles and checks the model and starts the fit thread, which receives frames after [`Session::begin`]. If the session
    /// was swapped before a restart, `entry` is the model that it was swapped to, with `constants` of its own, instead of the
    /// document's.
    pub fn start(
        name: &str,
        document: SessionDocument,
        source: SourceOf,
        (entry, constants): (&ModelEntry, &BTreeMap<String, f64>),
        run: SessionStart,
        quota: &Arc<SearchQuota>,
    ) -> Result<Session, Problem> {
        check_document(&document)?;
        check_shape(&entry.model, source.source.shape())
            .map_err(|message| Problem::wrong_key("wrong-model", "model", message))?;
        let start_ns = monotonic_ns();
        let compiled = entry.kernels(document.options.precision)?;
        if let Some(format) = source.source.shape().format_for(&entry.model) {
            compiled.warm(document.camera.seen_format(format), &Threads)?;
        }
        let compile_ms = elapsed_ms(start_ns);
        let mut options = match document.model == entry.name.as_str() {
            true => swap::options(&document),
            false => swap::options_known(&document, &entry.model),
        };
        options.constants.extend(constants.clone());
        let tracker = tracker(compiled, options, source.source.shape());
        let tracker = tracker.map_err(|error| wrong_options(&document, entry, &error))?;
        let active = Active::new(entry, constants.clone());
        let shared = Arc::new(Shared::new(Status::new(active.clone(), entry.name.to_string())));
        let knob = ExposureKnob::of((name, run.epoch), &document.options, &source.source, &tracker)?;
        let fitter = Fitter {
            name: name.to_string(),
            run: run.clone(),
            shared: shared.clone(),
            source: source.source.clone(),
            quota: quota.clone(),
            times: source.source.frame_budget().map(FrameTimes::of),
            tracker,
            active,
            knob,
            beside: PreparationThread::default(),
            next_frame: None,
            viewer: None,
            last: None,
            jumps: None,
            event_log: EventLog::default(),
            recorder: FitRecorder::default(),
        };
        let thread = NamedThread::start(format!("fit {name}"), move || fitter.run())
            .map_err(|error| Problem::no_thread("for the session", &error))?;
        let (name, quota, recorded) = (name.to_string(), quota.clone(), LastRecording::default());
        let swaps = AtomicU64::new(0);
        Ok(Session { name, document, source, shared, thread, quota, compile_ms, run, swaps, recorded })
    }

    /// Sets the fit time measured in advance, used as the load until frames have a measured cost.
    pub fn expect_cost(&self, fit_ms: Option<f64>) {
        self.shared.status().expected_ns = fit_ms.map(|fit_ms| (fit_ms * 1e6) as u64);
    }

    /// Subscribes to the source.
    pub fn begin(&self) {
        self.source.source.subscribe(&self.shared.inbox);
    }

    /// The session's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The tag of its document if that is not declared: a new one after each start and swap.
    pub fn tag(&self) -> EntityTag {
        EntityTag::new(format!("passing-{:x}-{:x}", self.run.epoch, self.swaps.load(Ordering::SeqCst)))
    }

    /// Publishes its estimates.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.shared.hub
    }

    /// Its preview images.
    pub fn preview(&self) -> &Arc<Preview> {
        &self.shared.preview
    }

    /// Its counters.
    pub fn counters(&self) -> &SessionCounters {
        &self.shared.counters
    }

    /// The number of the last fitted frame.
    pub fn last_frame(&self) -> Option<u64> {
        self.shared.hub.last().map(|estimate| estimate.frame)
    }

    /// Compilation time of its kernels at the start, ms.
    pub fn compile_ms(&self) -> f64 {
        self.compile_ms
    }

    /// The fit thread's queue.
    pub fn inbox(&self) -> &Arc<Inbox> {
        &self.shared.inbox
    }

    /// Its source.
    pub fn source(&self) -> &SourceOf {
        &self.source
    }

    /// Whether the session or its shadow fits that model, or a swap to it is requested.
    pub fn uses_model(&self, name: &str) -> bool {
        let is_shadow = self.shared.shadow().is_some_and(|shadow| shadow.entry().name.as_str() == name);
        let status = self.shared.status();
        is_shadow || status.active.name == name || status.requested_model == name
    }

    /// Processors that it keeps busy at the rate of its source, including a source of its own; `None` if frames wait for their
    /// fits.
    pub fn load(&self) -> Option<f64> {
        let rate_hz = self.source.source.realtime_hz()?;
        let is_over = matches!(self.state().0, SessionState::Stopped | SessionState::LostSource | SessionState::Failed);
        let cost_ns = self.shared.status().load_ns().filter(|_| !is_over).unwrap_or(0);
        let own = if self.source.is_own && !is_over { self.source.source.load() } else { 0.0 };
        Some(busy(cost_ns as f64 * 1e-9, rate_hz) + own)
    }

    /// Its state, and the reason if it does not run.
    pub fn state(&self) -> (SessionState, Option<String>) {
        let (state, reason) = self.shared.status().state(monotonic_ns(), &self.source.source);
        let is_over = matches!(state, SessionState::Stopped | SessionState::LostSource | SessionState::Failed);
        if !is_over && reason.is_none() && self.source.source.is_still() {
            return (state, Some("the source is paused".to_string()));
        }
        let trouble = self.source.source.trouble().filter(|_| !is_over);
        trouble.unwrap_or((state, reason))
    }

    /// Its document with its state.
    pub fn view(&self) -> SessionView {
        let last = self.shared.hub.last();
        let shadow = self.shared.shadow().map(|shadow| shadow.view());
        let mut document = self.document.clone();
        let (state, reason) = self.state();
        let status = self.shared.status().clone();
        document.model = status.active.name.clone();
        document.constants.extend(status.active.constants.clone());
        let warnings = swap::options(&document).unread(&status.active.model);
        // Before the first frame: the values that apply to it.
        let budgets = status.budgets.or_else(|| Some([self.source.source.frame_budget()?, LIMITS.search_time]));
        SessionView {
            name: self.name.clone(),
            document,
            state,
            reason,
            warnings,
            requested_model: status.requested_model.clone(),
            active_model: status.active.name.clone(),
            active_digest: status.active.model.digest().to_string(),
            active_since_frame: status.active_since_frame,
            vector_width: 8 * status.active.width.bytes(),
            frames: status.frames,
            dropped: status.dropped,
            rate_hz: status.rate_hz(monotonic_ns()),
            node: self.run.node.to_string(),
            epoch: Some(self.run.epoch),
            declared_at: self.run.declared_at.clone(),
            started_at: Some(self.run.started_at.clone()),
            restarts: self.run.restarts,
            frame_budget_ms: budgets.map(|[fit, _]| milliseconds(fit)),
            search_budget_ms: budgets.map(|[_, search]| milliseconds(search)),
            over_budget: status.over_budget,
            searches: status.searches[0],
            searches_postponed: status.searches[1],
            cost_ms: status.cost_ns.map(|cost_ns| cost_ns as f64 / 1e6),
            exposure_control: status.control.clone(),
            shadow,
            recording: self.recorded.view().map(|(_, view)| view),
            source_camera: self.source.source.camera(),
            last: last.map(|estimate| (*estimate).clone()),
        }
    }

    /// Starts recording, unless a recording with the same document is running.
    pub fn record(
        &self,
        folder: &RecordingFolder,
        document: RecordDocument,
        preconditions: &Preconditions,
    ) -> Result<BegunRecording, Problem> {
        let session = LoggedSession {
            version: LOG_VERSION,
            session: self.name.clone(),
            node: self.run.node.to_string(),
            epoch: self.run.epoch,
            document: self.document.clone(),
            frames: document.frames,
            build: LoggedBuild {
                version: env!("CARGO_PKG_VERSION").to_string(),
                checksum: program_checksum(),
                processor: std::env::consts::ARCH.to_string(),
            },
        };
        let feed = (&*self.shared.inbox, self.source.source.clone());
        self.recorded.begin(folder, (document, preconditions), session, feed)
    }

    /// The state of its recording, with its tag.
    pub fn recording(&self) -> Result<(EntityTag, RecordingView), Problem> {
        self.recorded.view().ok_or_else(|| Problem::unknown("recording of the session", &self.name))
    }

    /// Ends and forgets its recording; the caller may wait for the file to be closed.
    pub fn stop_recording(&self, preconditions: &Preconditions) -> Result<Arc<SessionRecording>, Problem> {
        let stopped = self.recorded.stop(&self.shared.inbox, preconditions)?;
        stopped.ok_or_else(|| Problem::unknown("recording of the session", &self.name))
    }

    /// Takes no more frames and abandons the current fit.
    pub fn leave(&self) {
        self.source.source.unsubscribe(&self.shared.inbox);
        self.shared.inbox.close();
        self.shared.shadow().iter().for_each(|shadow| shadow.leave("the session was stopped"));
        self.recorded.end(&self.shared.inbox, "the session has ended");
        if self.source.is_own {
            self.source.source.leave();
        }
    }

    /// After [`Session::leave`]: waits for the threads until `until`, then ends the subscriptions. A thread that is still
    /// fitting ends by itself after its last frame.
    pub fn wait(&self, end: End, until: Instant) {
        self.thread.wait(until);
        self.shared.shadow().iter().for_each(|shadow| shadow.wait(until));
        self.recorded.wait(until);
        self.shared.hub.end(end);
        if self.source.is_own {
            self.source.source.wait(until);
        }
    }
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
