//! A source: one named thread that produces frames and hands them to the subscribed sessions.
//!
//! It waits for the first subscription. In pace `realtime` a frame is sent when it is due and replaces one that a session has
//! not begun; in pace `fit` it is sent when every session has finished the last one. A camera keeps its own pace, and is closed
//! while no session is subscribed. Frame numbers count what the source produced: gaps show losses.

pub mod control;
mod drivers;
mod faults;
#[cfg(test)]
pub mod hanging_tests;
mod lease;
mod live;
mod open;
mod playback;
mod played;
mod playing;
mod reader;
mod scene;
mod schedule;
mod state;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use isophote_capture::{Captured, Exposure, FrameSource, Wake};
use isophote_jit::PixelFormat;
use isophote_tracker::Frame;

use crate::http::preconditions::EntityTag;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::service::capacity::{busy, mean_cost};
use crate::session::inbox::{Delivery, FittedFrame, Inbox, Reply, SampleFrame, SourceEnd, TimeOrigin};
use crate::thread::NamedThread;
pub use drivers::Drivers;
use faults::ReadFaults;
use isophote_machine::{monotonic_ns, thread_ns};
use isophote_wire::{
    Pace, RecordingDocument, SessionState, SourceDocument, SourceState, SourceView, SyntheticDocument,
};
pub use lease::{ControlLease, LeaseId};
pub use open::{Opened, Taker, camera_problem, open, open_camera, open_recording, pixel_format};
use playback::{Playback, Tape};
pub use reader::CameraReader;
use reader::SpareCamera;
use scene::SceneInForce;
use schedule::Ticks;
use state::{SourceNow, SourceShared};

/// Shape of a source's frames, as far as it is known before the first one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameShape {
    /// Number of coordinates.
    pub dimensions: Option<usize>,
    /// Number of planes.
    pub planes: Option<usize>,
    /// Pixel format.
    pub format: Option<PixelFormat>,
    /// Names of the planes, if they are columns of a table.
    pub columns: Option<Vec<String>>,
    /// px, innermost first.
    pub size: Option<Vec<usize>>,
}

impl FrameShape {
    /// The shape of a frame.
    pub fn of(frame: &Frame) -> FrameShape {
        FrameShape {
            dimensions: Some(frame.size().len()),
            planes: Some(frame.planes().len()),
            format: frame.planes().first().map(|plane| plane.format),
            columns: frame.names().map(<[String]>::to_vec),
            size: Some(frame.size().to_vec()),
        }
    }
}

/// Origin of a source's frames.
pub enum Producer {
    /// Rendered or read.
    Frames(Box<dyn FrameSource>),
    /// Sent by clients.
    Pushed,
    /// Sent by a camera.
    Camera {
        /// Closed until its thread opens it.
        camera: Box<dyn CameraReader>,
        /// Counts threads abandoned in its driver.
        drivers: Drivers,
    },
}

/// A running source.
pub struct Source {
    /// Unique to this start of the source.
    id: EntityTag,
    document: SourceDocument,
    shape: FrameShape,
    exposure: Option<Exposure>,
    scene: Option<SceneInForce>,
    lease: Arc<ControlLease>,
    /// Ends a camera's wait.
    wake: Option<Wake>,
    /// Of a camera.
    spare: Option<SpareCamera>,
    shared: Arc<SourceShared>,
    /// The thread in charge: after a driver hang, the one that took over.
    thread: Mutex<NamedThread>,
}

/// Keeps a camera closed for another user until dropped.
pub struct Paused(Arc<Source>);

impl Drop for Paused {
    fn drop(&mut self) {
        self.0.shared.lock().is_paused = false;
        self.0.shared.changed.notify_all();
    }
}

impl Source {
    /// Starts the thread; it waits for the first session.
    pub fn start(label: &str, document: SourceDocument, mut opened: Opened) -> Result<Source, Problem> {
        let (mut scene, mut playback) = (None, None);
        if let Producer::Frames(frames) = &mut opened.producer {
            if let (SourceDocument::Synthetic(synthetic), Some(knob)) = (&document, frames.scene()) {
                scene = Some(SceneInForce::new(knob, synthetic));
            }
            let repeat = matches!(&document, SourceDocument::Recording(recording) if recording.repeat);
            let tape = frames.reel().map(|reel| Tape { count: reel.count(), repeat, shown: None, seek: None });
            playback = Some(Playback::new(tape));
        }
        let state = SourceNow {
            sessions: Vec::new(),
            pushed: VecDeque::new(),
            state: SourceState::Idle,
            reason: None,
            frames: 0,
            unread: 0,
            newest: None,
            cost_ns: None,
            camera: None,
            playback,
            asked: None,
            is_silent_said: false,
            turn: 0,
            given_up: BTreeMap::new(),
            is_over: false,
            is_resting: true,
            is_paused: false,
            is_stopping: false,
        };
        let shared = Arc::new(SourceShared { state: Mutex::new(state), changed: Condvar::new() });
        let (pace, rate_hz) = (opened.pace, opened.rate_hz);
        let (exposure, wake, spare) = match &opened.producer {
            Producer::Frames(frames) => (frames.exposure(), None, None),
            Producer::Pushed => (None, None, None),
            Producer::Camera { camera, drivers } => {
                let spare = SpareCamera::of(label, &**camera, drivers.clone());
                (camera.exposure(), Some(camera.wake()), Some(spare))
            }
        };
        let schedule = Ticks::new(rate_hz);
        let mut worker = Worker {
            shared: shared.clone(),
            turn: 0,
            pace,
            rate_hz,
            schedule,
            frame: 0,
            faults: ReadFaults::default(),
            worked_ns: None,
        };
        let thread = NamedThread::start(format!("source {label}"), move || worker.run(opened.producer))
            .map_err(|error| Problem::no_thread("for the source", &error))?;
        Ok(Source {
            id: EntityTag::unique(),
            document,
            shape: opened.shape,
            exposure,
            scene,
            lease: Arc::default(),
            wake,
            spare,
            shared,
            thread: Mutex::new(thread),
        })
    }

    /// Shape of its frames, as far as it is known.
    pub fn shape(&self) -> &FrameShape {
        &self.shape
    }

    /// Its exposure, if that can be set.
    pub fn exposure(&self) -> Option<&Exposure> {
        self.exposure.as_ref()
    }

    /// The document as put, with defaults filled in.
    pub fn document(&self) -> &SourceDocument {
        &self.document
    }

    /// Frames per second if they do not wait for fits, 0 if a camera does not specify it; `None` if they wait.
    pub fn realtime_hz(&self) -> Option<f64> {
        let is_camera = matches!(self.document, SourceDocument::Camera(_));
        let promised = || self.shared.lock().camera.as_ref().and_then(|camera| camera.rate_hz);
        Some(self.speed() * realtime_hz(&self.document, is_camera.then(promised).flatten())?)
    }

    /// Processors that its thread keeps busy rendering, reading or decoding frames; 0 without sessions, or if frames wait for
    /// fits.
    pub fn load(&self) -> f64 {
        let (Some(rate_hz), true) = (self.realtime_hz(), self.sessions() > 0) else { return 0.0 };
        busy(self.shared.lock().cost_ns.unwrap_or(0) as f64 * 1e-9, rate_hz)
    }

    /// Processor time that a frame's fits may take: the interval between frames, at most `LIMITS.frame_budget`.
    pub fn frame_budget(&self) -> Option<Duration> {
        Some(interval(self.realtime_hz()?).map_or(LIMITS.frame_budget, |one| one.min(LIMITS.frame_budget)))
    }

    /// Interval between its frames, if they do not wait and the rate is known.
    pub fn interval(&self) -> Option<Duration> {
        interval(self.realtime_hz()?)
    }

    /// Its document with its state.
    pub fn view(&self, name: &str) -> SourceView {
        // A thread that holds the lock of the lease locks the state: query the lease before locking the state.
        let (document, playback) = (self.document_now(), self.playback().ok().map(|(_, view)| view));
        let control = Some(self.lease.view(Instant::now()).1).filter(|view| view.owner.is_some());
        let shared = self.shared.lock();
        let (state, reason) = shared.state(Instant::now());
        SourceView {
            name: name.to_string(),
            document,
            state,
            reason,
            declared_at: None,
            frames: shared.frames,
            unread: shared.unread,
            sessions: shared.sessions.len(),
            position: playback
                .as_ref()
                .filter(|playback| playback.length.is_some())
                .and_then(|playback| playback.frame),
            playback,
            control,
            camera: shared.camera.clone(),
        }
    }

    /// State and reason that its sessions report while its camera stalls or is lost.
    pub fn trouble(&self) -> Option<(SessionState, Option<String>)> {
        match self.shared.lock().state(Instant::now()) {
            (SourceState::Stalled, reason) => Some((SessionState::Stalled, reason)),
            (SourceState::Lost, reason) => Some((SessionState::LostSource, reason)),
            _ => None,
        }
    }

    /// The next frame that the session fits, or the last one if the source is paused.
    pub fn sample(&self, session: &Inbox) -> Option<FittedFrame> {
        let which = if self.is_still() { SampleFrame::Last } else { SampleFrame::Next };
        session.sample(which, LIMITS.sample_time)
    }

    /// The inbox of one of its sessions.
    pub fn first_inbox(&self) -> Option<Arc<Inbox>> {
        self.shared.lock().sessions.first().cloned()
    }

    /// Number of subscribed sessions.
    pub fn sessions(&self) -> usize {
        self.shared.lock().sessions.len()
    }

    /// Sends all further frames to `inbox`.
    pub fn subscribe(&self, inbox: &Arc<Inbox>) {
        let mut state = self.shared.lock();
        if let (SourceState::Ended | SourceState::Failed, reason) = (state.state, state.reason.clone()) {
            inbox.end(end_of(state.state, reason.unwrap_or_default()));
        }
        state.sessions.push(inbox.clone());
        state.playback.iter_mut().for_each(|playback| playback.is_seen = false);
        self.shared.changed.notify_all();
    }

    /// Sends no more frames to `inbox`.
    pub fn unsubscribe(&self, inbox: &Arc<Inbox>) {
        self.shared.lock().sessions.retain(|one| !Arc::ptr_eq(one, inbox));
        self.wake.iter().for_each(Wake::ring);
    }

    /// Queues a client's frame; 409 if the source, and with it the addressed session, has ended.
    pub fn push(&self, mut captured: Captured, reply: Reply) -> Result<(), Problem> {
        captured.frame.capture_ns = Some(monotonic_ns());
        let mut state = self.shared.lock();
        if state.is_stopping {
            return Err(Problem::session_ended());
        }
        if state.pushed.len() >= LIMITS.pushed_frames {
            return Err(Problem::over_limit("pushed frames that wait", LIMITS.pushed_frames));
        }
        state.pushed.push_back((captured, reply));
        self.shared.changed.notify_all();
        Ok(())
    }

    /// Ends the thread after its current frame. Close its sessions first.
    pub fn leave(&self) {
        self.shared.lock().is_stopping = true;
        self.shared.changed.notify_all();
        self.wake.iter().for_each(Wake::ring);
    }

    /// After [`Source::leave`]: waits for the thread until `until`. Abandons a thread that hangs in a camera's driver.
    pub fn wait(&self, until: Instant) {
        let now = Instant::now();
        let until = if self.shared.lock().silence(now).is_some() { now } else { until };
        if !self.thread.lock().unwrap_or_else(PoisonError::into_inner).wait(until) {
            self.leave_to_driver();
        }
    }

    /// Ends the thread and waits for at most `LIMITS.end_time`.
    pub fn stop(&self) {
        self.leave();
        self.wait(Instant::now() + LIMITS.end_time);
    }
}

/// Frames per second of a document's source, if they do not wait for fits; `promised`: by the camera's driver.
pub fn realtime_hz(document: &SourceDocument, promised: Option<f64>) -> Option<f64> {
    match document {
        SourceDocument::Synthetic(SyntheticDocument { pace, rate_hz, .. })
        | SourceDocument::Recording(RecordingDocument { pace, rate_hz, .. }) => {
            (*pace == Pace::Realtime).then_some(*rate_hz)
        }
        SourceDocument::Camera(document) => Some(promised.or(document.rate_hz).unwrap_or(0.0)),
        SourceDocument::Pushed(_) => None,
    }
}

/// Interval between frames at a rate, if that is known.
fn interval(rate_hz: f64) -> Option<Duration> {
    Duration::try_from_secs_f64(rate_hz.recip()).ok()
}

fn end_of(state: SourceState, reason: String) -> SourceEnd {
    if state == SourceState::Failed { SourceEnd::Failed(reason) } else { SourceEnd::Finished(reason) }
}

struct Worker {
    shared: Arc<SourceShared>,
    /// Number of this thread among the source's threads.
    turn: u64,
    pace: Pace,
    /// 0: as fast as `pace` allows.
    rate_hz: f64,
    schedule: Ticks,
    /// The number of the next frame.
    frame: u64,
    /// Frames that could not be read.
    faults: ReadFaults,
    /// The thread's processor time when the last frame was sent.
    worked_ns: Option<u64>,
}

impl Worker {
    /// A camera keeps its own pace.
    fn of_camera(shared: &Arc<SourceShared>, turn: u64) -> Worker {
        let (shared, schedule) = (shared.clone(), Ticks::new(0.0));
        Worker {
            shared,
            turn,
            pace: Pace::Realtime,
            rate_hz: 0.0,
            schedule,
            frame: 0,
            faults: ReadFaults::default(),
            worked_ns: None,
        }
    }

    fn run(&mut self, producer: Producer) {
        let _guard = EndGuard { shared: self.shared.clone(), turn: self.turn };
        match producer {
            Producer::Frames(frames) => self.run_frames(frames),
            Producer::Pushed => self.run_pushed(),
            Producer::Camera { camera, .. } => self.run_camera(camera),
        }
    }

    fn run_pushed(&mut self) {
        loop {
            let idle = |state: &mut SourceNow| !state.is_stopping && state.pushed.is_empty();
            let waited = self.shared.changed.wait_while(self.shared.lock(), idle);
            let mut state = waited.unwrap_or_else(PoisonError::into_inner);
            let Some((captured, reply)) = state.pushed.pop_front().filter(|_| !state.is_stopping) else { return };
            drop(state);
            self.wait_for_fits(); // every pushed frame is answered
            self.number(captured, TimeOrigin::OfArrival, Some(reply));
        }
    }

    /// False when the source stops.
    fn wait_for_sessions(&mut self) -> bool {
        let mut state = self.shared.lock();
        if state.sessions.is_empty() {
            state.state = SourceState::Idle;
            self.schedule.restart();
        }
        let idle = |state: &mut SourceNow| !state.is_stopping && !state.is_wanted();
        let mut state = self.shared.changed.wait_while(state, idle).unwrap_or_else(PoisonError::into_inner);
        // A stalled source runs again with its next frame.
        if state.state != SourceState::Stalled {
            state.state = SourceState::Running;
        }
        !state.is_stopping
    }

    fn wait_for_fits(&self) {
        let sessions = self.shared.lock().sessions.clone();
        sessions.iter().for_each(|inbox| inbox.wait_idle());
    }

    /// Numbers and sends a frame of a source that does not count its frames itself.
    fn number(&mut self, mut captured: Captured, stamp: TimeOrigin, reply: Option<Reply>) {
        captured.frame.sequence = self.frame;
        self.frame += 1;
        self.deliver(captured, stamp, reply);
    }

    fn deliver(&mut self, captured: Captured, stamp: TimeOrigin, reply: Option<Reply>) {
        let worked_ns = thread_ns();
        let frame_ns = self.worked_ns.replace(worked_ns).map(|before_ns| worked_ns.saturating_sub(before_ns));
        let (sessions, jumps) = {
            let mut state = self.shared.lock();
            state.frames += 1;
            state.newest = Some(captured.frame.sequence);
            if let Some(frame_ns) = frame_ns {
                state.cost_ns = Some(mean_cost(state.cost_ns, frame_ns));
            }
            (state.sessions.clone(), state.playback.as_ref().map_or(0, |playback| playback.jumps))
        };
        let delivery = Arc::new(Delivery::now(captured, stamp, jumps, reply));
        for inbox in &sessions {
            inbox.deliver(delivery.clone());
        }
    }
}

/// The source's name, from the thread's name.
fn label() -> String {
    std::thread::current().name().unwrap_or_default().trim_start_matches("source ").to_string()
}

fn finish(shared: &SourceShared, end: SourceState, reason: String) {
    match end {
        SourceState::Failed => tracing::warn!(source = label(), reason, "source failed"),
        _ => tracing::info!(source = label(), reason, "source has no more frames"),
    }
    let sessions = {
        let mut state = shared.lock();
        state.state = end;
        state.reason = Some(reason.clone());
        state.sessions.clone()
    };
    for inbox in &sessions {
        inbox.end(end_of(end, reason.clone()));
    }
}

/// Reports a panic to the sessions, and the end of a thread that may have been abandoned.
struct EndGuard {
    shared: Arc<SourceShared>,
    turn: u64,
}

impl Drop for EndGuard {
    fn drop(&mut self) {
        let is_in_charge = {
            let mut state = self.shared.lock();
            state.given_up.remove(&self.turn);
            state.is_over |= state.turn == self.turn;
            state.turn == self.turn
        };
        if std::thread::panicking() && is_in_charge {
            finish(&self.shared, SourceState::Failed, "bug: the source's thread panicked".into());
        }
    }
}
