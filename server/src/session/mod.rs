//! A session: one named fit thread that follows one target in the frames of one source.

mod beside;
mod checks;
mod chronicle;
mod fit;
pub mod inbox;
mod once;
mod status;
mod swap;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio::sync::oneshot;

use crate::counters::SessionCounters;
use crate::hub::{End, Hub};
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::source::Source;
use crate::thread::NamedThread;
use beside::PreparationThread;
use checks::{check_document, check_shape, tracker, wrong_options};
use chronicle::Chronicle;
use fit::{ExposureKnob, Fitter};
use inbox::Inbox;
use isophote_machine::Threads;
use isophote_machine::{elapsed_ms, monotonic_ns};
use isophote_wire::{SessionDocument, SessionState, SessionView};
pub use once::fit_once;
use status::Status;
pub use swap::Swapped;
use swap::{Active, Swap};

/// What the fit thread shares with the rest of the service.
pub struct Shared {
    /// What waits for the thread.
    pub inbox: Arc<Inbox>,
    /// What it has found.
    pub hub: Arc<Hub>,
    /// What is counted of it.
    pub counters: SessionCounters,
    status: Mutex<Status>,
}

impl Shared {
    fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The source of a session.
#[derive(Clone)]
pub struct SourceOf {
    /// The running source.
    pub source: Arc<Source>,
    /// It lives and ends with the session.
    pub is_own: bool,
}

/// One start of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionStart {
    /// Where it runs.
    pub node: Arc<str>,
    /// No other start on that node has it.
    pub epoch: u64,
    /// When it began, by the wall clock.
    pub started_at: String,
    /// When it was put, by the wall clock; nothing of the demo's.
    pub declared_at: Option<String>,
    /// How often the service was started since then.
    pub restarts: u64,
}

/// A running session.
pub struct Session {
    name: String,
    document: SessionDocument,
    source: SourceOf,
    shared: Arc<Shared>,
    thread: NamedThread,
    compile_ms: f64,
    run: SessionStart,
}

impl Session {
    /// Compiles, checks, and starts the thread, which has no frames before [`Session::begin`]. The model may be another than
    /// the document's, to which the session was swapped before. Only from the compile thread.
    pub fn start(
        name: &str,
        document: SessionDocument,
        source: SourceOf,
        entry: &ModelEntry,
        run: SessionStart,
    ) -> Result<Session, Problem> {
        check_document(&document)?;
        check_shape(&entry.model, source.source.shape())
            .map_err(|message| Problem::wrong_key("wrong-model", "model", message))?;
        let start_ns = monotonic_ns();
        let compiled = entry.kernels(document.options.precision)?;
        if let Some(format) = source.source.shape().format {
            compiled.warm(format, &Threads)?;
        }
        let compile_ms = elapsed_ms(start_ns);
        let options = match document.model == entry.name.as_str() {
            true => swap::options(&document),
            false => swap::options_known(&document, &entry.model),
        };
        let tracker = tracker(compiled, options, source.source.shape());
        let tracker = tracker.map_err(|error| wrong_options(&document, entry, &error))?;
        let active = Active::new(entry);
        let status = Status::new(active.clone(), entry.name.to_string());
        let (counters, status) = (SessionCounters::default(), Mutex::new(status));
        let shared = Arc::new(Shared { inbox: Arc::default(), hub: Arc::default(), counters, status });
        let knob = ExposureKnob::of(&document.options, &source.source, &tracker)?;
        let fitter = Fitter {
            name: name.to_string(),
            run: run.clone(),
            shared: shared.clone(),
            tracker,
            active,
            knob,
            beside: PreparationThread::default(),
            next_frame: None,
            chronicle: Chronicle::default(),
        };
        let thread = NamedThread::start(format!("fit {name}"), move || fitter.run())
            .map_err(|error| Problem::bug(format!("no thread for the session: {error}")))?;
        Ok(Session { name: name.to_string(), document, source, shared, thread, compile_ms, run })
    }

    /// From now on it has frames.
    pub fn begin(&self) {
        self.source.source.subscribe(&self.shared.inbox);
    }

    /// Its estimates.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.shared.hub
    }

    /// What was counted of it.
    pub fn counters(&self) -> &SessionCounters {
        &self.shared.counters
    }

    /// The number of the last frame that it fitted.
    pub fn last_frame(&self) -> Option<u64> {
        self.shared.hub.last().map(|estimate| estimate.frame)
    }

    /// What its kernels took when it started, ms.
    pub fn compile_ms(&self) -> f64 {
        self.compile_ms
    }

    /// What waits for its fit thread.
    pub fn inbox(&self) -> &Arc<Inbox> {
        &self.shared.inbox
    }

    /// Its source.
    pub fn source(&self) -> &SourceOf {
        &self.source
    }

    /// Whether it fits that model, or is about to.
    pub fn uses_model(&self, name: &str) -> bool {
        let status = self.shared.status();
        status.active.name == name || status.requested_model == name
    }

    /// What it does, and why it does not run.
    pub fn state(&self) -> (SessionState, Option<String>) {
        let status = self.shared.status();
        let (state, reason) = (status.state(monotonic_ns(), &self.source.source), status.reason.clone());
        drop(status);
        let is_over = matches!(state, SessionState::Stopped | SessionState::LostSource | SessionState::Failed);
        let trouble = self.source.source.trouble().filter(|_| !is_over);
        trouble.unwrap_or((state, reason))
    }

    /// Its document with its state.
    pub fn view(&self) -> SessionView {
        let last = self.shared.hub.last();
        let mut document = self.document.clone();
        let (state, reason) = self.state();
        let status = self.shared.status();
        document.model = status.active.name.clone();
        SessionView {
            name: self.name.clone(),
            document,
            state,
            reason,
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
            source_camera: self.source.source.camera(),
            last: last.map(|estimate| (*estimate).clone()),
        }
    }

    /// Compiles a model and hands it to the fit thread, which takes it between two frames. Only from the compile thread,
    /// so that swaps are ordered. `keep` writes it down, when nothing else can refuse it. Answers the compile time and where the
    /// fit thread's answer will come.
    pub fn begin_swap(
        &self,
        entry: &ModelEntry,
        keep: impl FnOnce() -> Result<(), Problem>,
    ) -> Result<(f64, oneshot::Receiver<Swapped>), Problem> {
        let before = std::mem::replace(&mut self.shared.status().requested_model, entry.name.to_string());
        let result = self.try_swap(entry, keep);
        if result.is_err() {
            self.shared.status().requested_model = before;
        }
        result
    }

    fn try_swap(
        &self,
        entry: &ModelEntry,
        keep: impl FnOnce() -> Result<(), Problem>,
    ) -> Result<(f64, oneshot::Receiver<Swapped>), Problem> {
        let shape = self.shared.status().shape.clone().unwrap_or_else(|| self.source.source.shape().clone());
        check_shape(&entry.model, &shape).map_err(|message| Problem::conflict("not-applicable", message))?;
        let start_ns = monotonic_ns();
        let compiled = entry.kernels(self.document.options.precision)?;
        if let Some(format) = shape.format {
            compiled.warm(format, &Threads)?;
        }
        let compile_ms = elapsed_ms(start_ns);
        let options = swap::options_known(&self.document, &entry.model);
        // A tracker of its own proves that the session's options suit the model: the swap itself cannot fail.
        let proof = tracker(compiled.clone(), options.clone(), &shape)
            .map_err(|error| Problem::conflict("not-applicable", error.to_string()))?;
        if self.document.options.exposure.control && !proof.advises_exposure() {
            return Err(Problem::conflict("not-applicable", fit::UNADVISED));
        }
        let (reply, answer) = oneshot::channel();
        let swap = Box::new(Swap { active: Active::new(entry), compiled, options, reply });
        keep()?;
        let gone = |_| Problem::conflict("not-applicable", "the session has ended");
        self.shared.inbox.swap(swap).map_err(gone)?;
        Ok((compile_ms, answer))
    }

    /// Takes no more frames, and gives up the fit that it is at.
    pub fn leave(&self) {
        self.source.source.unsubscribe(&self.shared.inbox);
        self.shared.inbox.close();
        if self.source.is_own {
            self.source.source.leave();
        }
    }

    /// After [`Session::leave`]: waits for the threads and tells subscribers. One that is still at its last frame ends after it:
    /// nobody waits for a fit whose result nobody wants.
    pub fn wait(&self, end: End, until: Instant) {
        self.thread.wait(until);
        self.shared.hub.end(end);
        if self.source.is_own {
            self.source.source.wait(until);
        }
    }
}
