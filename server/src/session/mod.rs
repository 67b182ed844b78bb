//! A session: one named fit thread that follows one target in the frames of one source.

mod beside;
mod fit;
pub mod inbox;
mod status;
mod swap;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_tracker::{Compiled, PoseMismatch, TrackError, Tracker, TrackerOptions};
use tokio::sync::oneshot;

use crate::hub::{End, Hub};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::source::{FrameShape, Source};
use crate::thread::NamedThread;
use beside::PreparationThread;
use fit::{ExposureKnob, Fitter};
use inbox::Inbox;
use isophote_machine::Threads;
use isophote_machine::{elapsed_ms, monotonic_ns};
use isophote_wire::{SessionDocument, SessionState, SessionView};
use status::Status;
pub use swap::Swapped;
use swap::{Active, Swap};

/// What the fit thread shares with the rest of the service.
pub struct Shared {
    /// What waits for the thread.
    pub inbox: Arc<Inbox>,
    /// What it has found.
    pub hub: Arc<Hub>,
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

/// A running session.
pub struct Session {
    name: String,
    document: SessionDocument,
    source: SourceOf,
    shared: Arc<Shared>,
    thread: NamedThread,
}

impl Session {
    /// Compiles, checks, and starts the thread. Only from the compile thread.
    pub fn start(
        name: &str,
        document: SessionDocument,
        source: SourceOf,
        entry: &ModelEntry,
    ) -> Result<Session, Problem> {
        check_document(&document)?;
        check_shape(&entry.model, source.source.shape())
            .map_err(|message| Problem::wrong_key("wrong-model", "model", message))?;
        let compiled = entry.kernels(document.options.precision)?;
        if let Some(format) = source.source.shape().format {
            compiled.warm(format, &Threads)?;
        }
        let options = swap::options(&document);
        let tracker = tracker(compiled, options, source.source.shape());
        let tracker = tracker.map_err(|error| wrong_options(&document, entry, &error))?;
        let active = Active::new(entry);
        let status = Status::new(active.clone(), document.model.clone());
        let shared = Arc::new(Shared { inbox: Arc::default(), hub: Arc::default(), status: Mutex::new(status) });
        let knob = ExposureKnob::of(&document.options, &source.source, &tracker)?;
        let fitter = Fitter {
            name: name.to_string(),
            shared: shared.clone(),
            tracker,
            active,
            knob,
            beside: PreparationThread::default(),
            next_frame: None,
        };
        let thread = NamedThread::start(format!("fit {name}"), move || fitter.run())
            .map_err(|error| Problem::bug(format!("no thread for the session: {error}")))?;
        source.source.subscribe(&shared.inbox);
        Ok(Session { name: name.to_string(), document, source, shared, thread })
    }

    /// Its estimates.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.shared.hub
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

    /// Its document with its state.
    pub fn view(&self) -> SessionView {
        let last = self.shared.hub.last();
        let mut document = self.document.clone();
        let status = self.shared.status();
        document.model = status.active.name.clone();
        let state = status.state(monotonic_ns(), &self.source.source);
        let is_over = matches!(state, SessionState::Stopped | SessionState::LostSource | SessionState::Failed);
        let trouble = self.source.source.trouble().filter(|_| !is_over);
        let (state, reason) = trouble.unwrap_or_else(|| (state, status.reason.clone()));
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
            source_camera: self.source.source.camera(),
            last: last.map(|estimate| (*estimate).clone()),
        }
    }

    /// Compiles a model and hands it to the fit thread, which takes it between two frames. Only from the compile thread,
    /// so that swaps are ordered. Answers the compile time and where the fit thread's answer will come.
    pub fn begin_swap(&self, entry: &ModelEntry) -> Result<(f64, oneshot::Receiver<Swapped>), Problem> {
        let before = std::mem::replace(&mut self.shared.status().requested_model, entry.name.to_string());
        let result = self.try_swap(entry);
        if result.is_err() {
            self.shared.status().requested_model = before;
        }
        result
    }

    fn try_swap(&self, entry: &ModelEntry) -> Result<(f64, oneshot::Receiver<Swapped>), Problem> {
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

/// What this build cannot honour is said, never ignored.
fn check_document(document: &SessionDocument) -> Result<(), Problem> {
    if let Some(window) = document.window {
        let slices = window.depth.unwrap_or(1).saturating_mul(window.length.unwrap_or(1));
        let pixels = window.width.saturating_mul(window.height).saturating_mul(slices);
        if pixels == 0 || pixels > LIMITS.window_pixels {
            let message = format!("a window has 1 to {} pixels", LIMITS.window_pixels);
            return Err(Problem::wrong_key("out-of-range", "window", message));
        }
    }
    let finite = |key: &str, numbers: &std::collections::BTreeMap<String, f64>| {
        let wrong = numbers.iter().find(|(_, value)| !value.is_finite());
        wrong.map_or(Ok(()), |(name, _)| {
            Err(Problem::wrong_key("out-of-range", &format!("{key}.{name}"), "not a finite number"))
        })
    };
    finite("constants", &document.constants)?;
    finite("start", &document.start)
}

/// Whether a model can look at such frames.
fn check_shape(model: &isophote_symbolic::Model, shape: &FrameShape) -> Result<(), String> {
    let (coordinates, channels) = (model.coordinates().len(), model.channels().len());
    if let Some(dimensions) = shape.dimensions.filter(|dimensions| *dimensions != coordinates) {
        return Err(format!(
            "the model `{}` has {coordinates} coordinates, the source's frames have {dimensions}",
            model.name()
        ));
    }
    // Columns are found by name; any may be over.
    if let Some(columns) = &shape.columns {
        let missing = model.channels().iter().find(|channel| !columns.contains(channel));
        return missing.map_or(Ok(()), |channel| {
            let (count, model) = (columns.len(), model.name());
            Err(format!("none of the {count} columns is named `{channel}`, which the model `{model}` reads"))
        });
    }
    if let Some(planes) = shape.planes.filter(|planes| *planes != channels && !(*planes == 3 && channels == 1)) {
        return Err(format!(
            "the model `{}` has {channels} channels, the source's frames have {planes} planes",
            model.name()
        ));
    }
    Ok(())
}

/// A tracker of such frames.
fn tracker(compiled: Arc<Compiled>, options: TrackerOptions, shape: &FrameShape) -> Result<Tracker, TrackError> {
    if let Some(size) = &shape.size {
        options.check_size(compiled.model(), size)?;
    }
    Tracker::new(compiled, options)
}

/// The key of the option that a tracker refuses.
fn wrong_options(document: &SessionDocument, entry: &ModelEntry, error: &TrackError) -> Problem {
    let parameter = document.start.keys().find(|name| entry.model.parameter(name).is_none());
    let constant = document.constants.keys().find(|name| entry.model.constant(name).is_none());
    let key = match (parameter, constant, error) {
        (_, _, TrackError::Range { name, .. }) => match name.split_once('.') {
            Some(("camera" | "constants", _)) => name.to_string(),
            _ => format!("options.{name}"),
        },
        (Some(name), _, _) => format!("start.{name}"),
        (None, Some(name), _) => format!("constants.{name}"),
        (None, None, TrackError::Window { .. }) => "window".to_string(),
        (None, None, TrackError::Target(_)) => "target".to_string(),
        (None, None, TrackError::Pose(PoseMismatch::Size { .. })) => "camera.intrinsics".to_string(),
        (None, None, TrackError::Pose(_)) => "target".to_string(),
        (None, None, TrackError::DefectMap(_)) => "camera.defect_map".to_string(),
        (None, None, TrackError::Intrinsics(_)) => "camera.intrinsics".to_string(),
        (None, None, _) => "model".to_string(),
    };
    Problem::wrong_key("wrong-value", &key, error.to_string())
}
