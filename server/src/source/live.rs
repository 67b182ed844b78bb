//! A source that is a camera: its thread takes what the driver has, all the time, and hands the newest frame on.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use isophote_capture::{CameraState, LiveCamera};
use isophote_machine::monotonic_ns;
use isophote_wire::SourceState;

use super::{Source, State, Worker, label};

/// For one look at the camera; whoever wants something of the thread wakes it before.
const LOOK: Duration = Duration::from_millis(200);
/// For a camera to be closed.
const REST: Duration = Duration::from_secs(2);

/// A camera that is closed until this is dropped: somebody else is to have it.
pub struct Paused(Arc<Source>);

impl Drop for Paused {
    fn drop(&mut self) {
        self.0.shared.lock().is_paused = false;
        self.0.shared.changed.notify_all();
    }
}

impl Source {
    /// Closes the camera; `None` where it is none.
    pub fn pause(self: &Arc<Source>) -> Option<Paused> {
        let wake = self.wake.as_ref()?;
        let mut state = self.shared.lock();
        state.is_paused = true;
        wake.ring();
        let is_open = |state: &mut State| !state.is_resting;
        // A driver that does not let go keeps the device; whoever opens it is told that it is in use.
        drop(self.shared.changed.wait_timeout_while(state, REST, is_open).unwrap_or_else(PoisonError::into_inner));
        Some(Paused(self.clone()))
    }
}

impl Worker {
    /// Until the source stops.
    pub(super) fn run_camera(&mut self, mut camera: LiveCamera) {
        loop {
            if !self.is_open() {
                camera.rest();
                self.report(&camera);
                if !self.wait_for_sessions() {
                    return;
                }
                continue;
            }
            if let Some(mut captured) = camera.next(LOOK) {
                // Some drivers do not say when.
                captured.frame.capture_ns.get_or_insert_with(monotonic_ns);
                self.deliver(captured, None);
            }
            self.report(&camera);
        }
    }

    /// Whether the camera may be open; whoever pauses it from now on waits until it is closed.
    fn is_open(&self) -> bool {
        let mut state = self.shared.lock();
        let is_wanted = state.is_wanted();
        if is_wanted {
            (state.is_resting, state.asked) = (false, Some(Instant::now()));
        }
        is_wanted
    }

    fn report(&self, camera: &LiveCamera) {
        let (source_state, reason) = match camera.state() {
            CameraState::Resting => (SourceState::Idle, None),
            CameraState::Running => (SourceState::Running, None),
            CameraState::Stalled(reason) => (SourceState::Stalled, Some(reason.clone())),
            CameraState::Lost(reason) => (SourceState::Lost, Some(reason.clone())),
        };
        let mut state = self.shared.lock();
        state.is_resting = *camera.state() == CameraState::Resting;
        let before = std::mem::replace(&mut state.state, source_state);
        (state.reason, state.asked) = (reason.clone(), None);
        let frame = state.frames;
        state.camera = Some(camera.status().clone());
        drop(state);
        say(before, source_state, reason, frame);
        self.shared.changed.notify_all();
    }
}

/// A line of the log where a camera is lost, stalls, or is back.
fn say(before: SourceState, now: SourceState, reason: Option<String>, frame: u64) {
    let is_away = |state| matches!(state, SourceState::Lost | SourceState::Stalled);
    let source = label();
    match now {
        SourceState::Lost if before != now => tracing::warn!(source, frame, reason, "source lost"),
        SourceState::Stalled if before != now => tracing::warn!(source, frame, reason, "source stalled"),
        SourceState::Running if is_away(before) => tracing::info!(source, frame, "source is back"),
        _ => {}
    }
}
