//! State shared between a source's threads and its users.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use isophote_capture::Captured;
use isophote_capture::camera::CameraStatus;
use isophote_wire::SourceState;

use super::drivers::GivenUp;
use super::playback::Playback;
use crate::limits::LIMITS;
use crate::session::inbox::{Inbox, Reply};

pub(super) struct SourceShared {
    pub(super) state: Mutex<SourceNow>,
    pub(super) changed: Condvar,
}

pub(super) struct SourceNow {
    pub(super) sessions: Vec<Arc<Inbox>>,
    pub(super) pushed: VecDeque<(Captured, Reply)>,
    pub(super) state: SourceState,
    pub(super) reason: Option<String>,
    pub(super) frames: u64,
    /// Frames of a recording that could not be read.
    pub(super) unread: u64,
    /// The number of the newest frame.
    pub(super) newest: Option<u64>,
    /// Mean processor time of a frame on the source's thread.
    pub(super) cost_ns: Option<u64>,
    pub(super) camera: Option<CameraStatus>,
    /// Of frames that are rendered or read.
    pub(super) playback: Option<Playback>,
    /// When the pending call of the camera's driver began.
    pub(super) asked: Option<Instant>,
    /// Whether the log reports that the call takes long.
    pub(super) is_silent_said: bool,
    /// Number of the thread in charge of the camera; earlier ones were abandoned in a driver call.
    pub(super) turn: u64,
    /// Abandoned threads that have not returned, with the begin of their driver calls.
    pub(super) given_up: BTreeMap<u64, (Instant, GivenUp)>,
    /// The thread in charge has ended.
    pub(super) is_over: bool,
    /// The camera is closed, and stays closed while `is_paused`.
    pub(super) is_resting: bool,
    pub(super) is_paused: bool,
    pub(super) is_stopping: bool,
}

impl SourceNow {
    pub(super) fn is_wanted(&self) -> bool {
        !self.is_stopping && !self.is_paused && !self.sessions.is_empty()
    }

    /// How long a camera's driver has not returned, if longer than `LIMITS.driver_time`.
    pub(super) fn silence(&self, now: Instant) -> Option<Duration> {
        let silence = now.saturating_duration_since(self.asked?);
        (silence > LIMITS.driver_time).then_some(silence)
    }

    /// State and reason at `now`, including a driver that hangs: its thread cannot report that itself.
    pub(super) fn state(&self, now: Instant) -> (SourceState, Option<String>) {
        let given_up = self.given_up.values().map(|(since, _)| now.saturating_duration_since(*since)).max();
        if let Some(silence) = self.silence(now) {
            let seconds = given_up.unwrap_or(silence).max(silence).as_secs();
            let reason = format!(
                "the camera's driver has not answered for {seconds} s; unplug the camera and plug it in again, or use another"
            );
            return (SourceState::Stalled, Some(reason));
        }
        let is_away = matches!(self.state, SourceState::Lost | SourceState::Stalled);
        let owed = given_up.filter(|_| is_away).map(|time| {
            format!("; before, its driver did not come back, which it has owed for {} s now", time.as_secs())
        });
        (self.state, self.reason.clone().map(|reason| reason + owed.as_deref().unwrap_or_default()))
    }
}

impl SourceShared {
    pub(super) fn lock(&self) -> MutexGuard<'_, SourceNow> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
