//! A source that is a camera: its thread takes what the driver has, all the time, and hands the newest frame on.

use std::sync::PoisonError;
use std::time::Duration;

use isophote_capture::{Camera, CameraState};

use super::{Source, State, Worker};
use crate::wire::SourceState;

/// For one look at the camera; whoever wants something of the thread wakes it before.
const LOOK: Duration = Duration::from_millis(200);
/// For a camera to be closed.
const REST: Duration = Duration::from_secs(2);

impl Source {
    /// Closes the camera, if it is one, until [`Source::resume`]: somebody else is to have it.
    pub fn pause(&self) {
        let Some(wake) = &self.wake else { return };
        let mut state = self.shared.lock();
        state.is_paused = true;
        wake.ring();
        let is_open = |state: &mut State| !state.is_resting;
        // A driver that does not let go keeps the device; whoever opens it is told that it is in use.
        drop(self.shared.changed.wait_timeout_while(state, REST, is_open).unwrap_or_else(PoisonError::into_inner));
    }

    /// Goes on.
    pub fn resume(&self) {
        self.shared.lock().is_paused = false;
        self.shared.changed.notify_all();
    }
}

impl Worker {
    /// Until the source stops.
    pub(super) fn run_camera(&mut self, mut camera: Camera) {
        loop {
            if !self.shared.lock().is_wanted() {
                camera.rest();
                self.report(&camera);
                if !self.wait_for_sessions() {
                    return;
                }
            }
            if let Some(captured) = camera.next(LOOK) {
                self.deliver(captured, None);
            }
            self.report(&camera);
        }
    }

    fn report(&self, camera: &Camera) {
        let (source_state, reason) = match camera.state() {
            CameraState::Resting => (SourceState::Idle, None),
            CameraState::Running => (SourceState::Running, None),
            CameraState::Stalled(reason) => (SourceState::Stalled, Some(reason.clone())),
            CameraState::Lost(reason) => (SourceState::Lost, Some(reason.clone())),
        };
        let mut state = self.shared.lock();
        state.is_resting = source_state == SourceState::Idle;
        (state.state, state.reason) = (source_state, reason);
        state.camera = Some(camera.status().clone());
        drop(state);
        self.shared.changed.notify_all();
    }
}
