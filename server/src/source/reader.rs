//! `CameraReader`: a camera as its thread uses it, and `SpareCamera`, what goes on where a driver does not come back.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use isophote_capture::camera::CameraStatus;
use isophote_capture::{CameraState, Captured, Exposure, LiveCamera, Wake};

use super::drivers::Drivers;

/// A camera as its thread uses it: [`LiveCamera`], or one that tests are in control of. `next` and `rest` ask its driver.
pub trait CameraReader: Send {
    /// The newest frame, waiting for it `limit` at most.
    fn next(&mut self, limit: Duration) -> Option<Captured>;
    /// Closes it.
    fn rest(&mut self);
    /// What it does.
    fn state(&self) -> &CameraState;
    /// Who it is and what was lost.
    fn status(&self) -> &CameraStatus;
    /// Ends a wait in `next`.
    fn wake(&self) -> Wake;
    /// Its knob.
    fn exposure(&self) -> Option<Exposure>;
    /// The same, closed.
    fn spare(&self) -> Box<dyn CameraReader>;
    /// A spare goes on after another.
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

/// What goes on where a driver does not come back.
pub struct SpareCamera {
    pub(super) label: String,
    camera: Mutex<Box<dyn CameraReader>>,
    pub(super) drivers: Drivers,
}

impl SpareCamera {
    /// Of the source that is called so.
    pub fn of(label: &str, camera: &dyn CameraReader, drivers: Drivers) -> SpareCamera {
        SpareCamera { label: label.to_string(), camera: Mutex::new(camera.spare()), drivers }
    }

    /// Where threads are counted that do not come back.
    pub fn drivers(&self) -> &Drivers {
        &self.drivers
    }

    /// It, and another in its place.
    pub(super) fn take(&self) -> Box<dyn CameraReader> {
        let mut camera = self.camera.lock().unwrap_or_else(PoisonError::into_inner);
        let next = camera.spare();
        std::mem::replace(&mut *camera, next)
    }
}
