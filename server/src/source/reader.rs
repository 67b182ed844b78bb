//! `CameraReader`: a camera as used by its thread, and `SpareCamera`, which takes over when a driver hangs.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use isophote_capture::camera::CameraStatus;
use isophote_capture::{CameraState, Captured, Exposure, LiveCamera, Wake};

use super::drivers::Drivers;

/// A camera as used by its thread: [`LiveCamera`], or a test's. `next` and `rest` call its driver.
pub trait CameraReader: Send {
    /// The newest frame; waits for at most `limit`.
    fn next(&mut self, limit: Duration) -> Option<Captured>;
    /// Closes it.
    fn rest(&mut self);
    /// Its state.
    fn state(&self) -> &CameraState;
    /// Its identity, settings and losses.
    fn status(&self) -> &CameraStatus;
    /// Ends a wait in `next`.
    fn wake(&self) -> Wake;
    /// Its exposure, if that can be set.
    fn exposure(&self) -> Option<Exposure>;
    /// A closed reader of the same camera.
    fn spare(&self) -> Box<dyn CameraReader>;
    /// Continues another reader's numbers and status.
    fn go_on(&mut self, next_number: u64, status: CameraStatus);
}

impl CameraReader for LiveCamera {
    fn next(&mut self, limit: Duration) -> Option<Captured> {
        LiveCamera::next(self, limit)
    }
    fn rest(&mut self) {
        LiveCamera::rest(self);
    }
    fn state(&self) -> &CameraState {
        LiveCamera::state(self)
    }
    fn status(&self) -> &CameraStatus {
        LiveCamera::status(self)
    }
    fn wake(&self) -> Wake {
        LiveCamera::wake(self)
    }
    fn exposure(&self) -> Option<Exposure> {
        LiveCamera::exposure(self)
    }
    fn spare(&self) -> Box<dyn CameraReader> {
        Box::new(LiveCamera::spare(self))
    }
    fn go_on(&mut self, next_number: u64, status: CameraStatus) {
        LiveCamera::go_on(self, next_number, status);
    }
}

/// Takes over when a driver hangs.
pub struct SpareCamera {
    pub(super) label: String,
    camera: Mutex<Box<dyn CameraReader>>,
    pub(super) drivers: Drivers,
}

impl SpareCamera {
    /// The spare of the source `label`.
    pub fn of(label: &str, camera: &dyn CameraReader, drivers: Drivers) -> SpareCamera {
        SpareCamera { label: label.to_string(), camera: Mutex::new(camera.spare()), drivers }
    }

    /// Counts abandoned threads.
    pub fn drivers(&self) -> &Drivers {
        &self.drivers
    }

    /// Takes the spare and puts another one in its place.
    pub(super) fn take(&self) -> Box<dyn CameraReader> {
        let mut camera = self.camera.lock().unwrap_or_else(PoisonError::into_inner);
        let next = camera.spare();
        std::mem::replace(&mut *camera, next)
    }
}
