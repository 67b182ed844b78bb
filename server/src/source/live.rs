//! A camera source: its thread reads the driver continuously and hands the newest frame on.
//!
//! A driver call may never return. Then the source reports that; after a while its thread is abandoned, and another continues
//! with a spare reader of the camera, found by its identity: as soon as it is plugged in again, or the call returns, which ends
//! the abandoned thread and closes its device.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use isophote_capture::CameraState;
use isophote_machine::monotonic_ns;
use isophote_wire::SourceState;

use super::drivers::Drivers;
use super::reader::CameraReader;
use super::{Paused, Producer, Source, SourceNow, Worker, label};
use crate::limits::LIMITS;
use crate::session::inbox::TimeOrigin;
use crate::thread::NamedThread;

/// Maximum wait for a frame; requests to the thread wake it earlier.
const LOOK: Duration = Duration::from_millis(200);
/// Maximum wait for a camera to close.
const REST: Duration = Duration::from_secs(2);

impl Source {
    /// Closes the camera; `None` if the source is none.
    pub fn pause(self: &Arc<Source>) -> Option<Paused> {
        let wake = self.wake.as_ref()?;
        let mut state = self.shared.lock();
        state.is_paused = true;
        wake.ring();
        // A hanging driver keeps the device; opening it then fails as in use.
        let is_awaited = |state: &mut SourceNow| !state.is_resting && state.silence(Instant::now()).is_none();
        drop(self.shared.changed.wait_timeout_while(state, REST, is_awaited).unwrap_or_else(PoisonError::into_inner));
        Some(Paused(self.clone()))
    }

    /// Checks at `now` whether the camera's driver has returned; if it has hung for long, starts another thread. Called
    /// periodically, as a hanging thread cannot check itself.
    pub fn look_after(&self, now: Instant) {
        let Some(spare) = &self.spare else { return };
        let mut state = self.shared.lock();
        let Some(silence) = state.silence(now) else { return };
        if !std::mem::replace(&mut state.is_silent_said, true) {
            let reason = state.state(now).1;
            tracing::warn!(source = spare.label, frame = state.frames, reason, "source stalled");
        }
        let given_up = state.given_up.len();
        let patience = LIMITS.driver_patience * (1 << given_up.min(LIMITS.given_up_each));
        let may_go_on = given_up < LIMITS.given_up_each && spare.drivers.has_room();
        if silence < patience || !may_go_on || state.is_stopping {
            return;
        }
        let mut camera = spare.take();
        let status = state.camera.clone().unwrap_or_else(|| camera.status().clone());
        camera.go_on(state.newest.map_or(0, |newest| newest + 1), status);
        let mut worker = Worker::of_camera(&self.shared, state.turn + 1);
        let thread = NamedThread::start(format!("source {}", spare.label), move || {
            worker.run(Producer::Camera { camera, drivers: Drivers::default() });
        });
        let thread = match thread {
            Ok(thread) => thread,
            Err(error) => return tracing::warn!(source = spare.label, %error, "no thread to go on with the camera"),
        };
        let turn = state.turn;
        state.given_up.insert(turn, (now.checked_sub(silence).unwrap_or(now), spare.drivers.give_up()));
        (state.turn, state.asked, state.is_resting, state.is_silent_said) = (turn + 1, None, true, false);
        tracing::warn!(
            source = spare.label,
            given_up = state.given_up.len(),
            "a thread is left to the camera's driver"
        );
        drop(state);
        *self.thread.lock().unwrap_or_else(PoisonError::into_inner) = thread;
    }

    /// Abandons the thread: if it hangs in a driver, it is counted until it returns.
    pub(super) fn leave_to_driver(&self) {
        let Some(spare) = &self.spare else { return };
        let mut state = self.shared.lock();
        let turn = state.turn;
        if !state.is_over && !state.given_up.contains_key(&turn) {
            let since = state.asked.unwrap_or_else(Instant::now);
            state.given_up.insert(turn, (since, spare.drivers.give_up()));
            tracing::warn!(source = spare.label, "a thread is left to the camera's driver");
        }
    }
}

impl Worker {
    /// Runs until the source stops, or another thread has taken over.
    pub(super) fn run_camera(&mut self, mut camera: Box<dyn CameraReader>) {
        loop {
            if !self.may_open() {
                camera.rest();
                if !self.report(&*camera) || !self.wait_for_sessions() {
                    return;
                }
                continue;
            }
            let captured = camera.next(LOOK);
            if !self.is_in_charge() {
                return;
            }
            if let Some(mut captured) = captured {
                // Some drivers do not stamp frames.
                let stamp =
                    if captured.frame.capture_ns.is_some() { TimeOrigin::OfFrame } else { TimeOrigin::OfArrival };
                captured.frame.capture_ns.get_or_insert_with(monotonic_ns);
                self.deliver(captured, stamp, None);
            }
            if !self.report(&*camera) {
                return;
            }
        }
    }

    fn is_in_charge(&self) -> bool {
        self.shared.lock().turn == self.turn
    }

    /// Whether the camera may be open; from then on a pausing thread waits until it is closed. In either case marks the begin
    /// of a driver call.
    fn may_open(&self) -> bool {
        let mut state = self.shared.lock();
        if state.turn != self.turn {
            return false;
        }
        let is_wanted = state.is_wanted();
        if is_wanted {
            state.is_resting = false;
        }
        state.asked = Some(Instant::now());
        is_wanted
    }

    /// Publishes the camera's state; false if another thread has taken over.
    fn report(&self, camera: &dyn CameraReader) -> bool {
        let (source_state, reason) = match camera.state() {
            CameraState::Resting => (SourceState::Idle, None),
            CameraState::Running => (SourceState::Running, None),
            CameraState::Stalled(reason) => (SourceState::Stalled, Some(reason.clone())),
            CameraState::Lost(reason) => (SourceState::Lost, Some(reason.clone())),
        };
        let mut state = self.shared.lock();
        if state.turn != self.turn {
            return false;
        }
        state.is_resting = *camera.state() == CameraState::Resting;
        let before = std::mem::replace(&mut state.state, source_state);
        let was_silent = std::mem::take(&mut state.is_silent_said);
        (state.reason, state.asked) = (reason.clone(), None);
        let frame = state.frames;
        state.camera = Some(camera.status().clone());
        drop(state);
        say(if was_silent { SourceState::Stalled } else { before }, source_state, reason, frame);
        self.shared.changed.notify_all();
        true
    }
}

/// Logs that a camera is lost, stalls, or is back.
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
