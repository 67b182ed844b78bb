//! `FitRecorder`: sends the fit thread's frames, fits and swaps as notes to the tap of a recording, if there is one. Never
//! blocks.

use std::sync::Arc;

use isophote_tracker::Tracker;
use isophote_wire::{EstimateView, LoggedFit, LoggedSwap};

use super::inbox::{Delivery, Inbox};
use super::swap::Active;
use super::watch::FrameWatch;
use crate::recording::{FitNote, ModelNote, Note, Tap};

/// How a model takes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takeover {
    /// It starts from the parameters that it shares with the previous model.
    Swapped,
    /// It has tracked the target as a shadow.
    Warm,
}

/// The recorder of one fit thread.
#[derive(Default)]
pub struct FitRecorder {
    /// The tap at the current frame.
    tap: Option<Arc<Tap>>,
}

/// How a frame was fitted, as needed beside its pixels to repeat the fit.
pub struct FitCourse(LoggedFit);

impl FitCourse {
    /// Collected after the fit; `jump`: the source's position jumped before it.
    pub fn of(delivery: &Delivery, jump: Option<u64>, tracker: &Tracker, watch: &FrameWatch) -> FitCourse {
        let frame = &delivery.captured.frame;
        FitCourse(LoggedFit {
            frame: frame.sequence,
            fit: 0,
            has_pixels: false,
            has_jumped: jump.is_some(),
            capture_ns: frame.capture_ns,
            time_s: frame.time_s,
            largest: frame.largest,
            ready: tracker.readiness(),
            stopped: watch.stopped(),
            postponed: watch.postponed(),
        })
    }
}

impl FitRecorder {
    /// Before a fit: sends a snapshot of the tracker if the recording wants one.
    pub fn before(&mut self, inbox: &Inbox, delivery: &Delivery, tracker: &Tracker, active: &Active) {
        self.tap = inbox.tap();
        let Some(tap) = &self.tap else { return };
        let frame = &delivery.captured.frame;
        if tap.take_wish() {
            tap.note(begin(tracker, active, frame.sequence, None));
        }
        tap.fitting(frame, delivery.at_ns());
    }

    /// After a swap: another model fits from `frame` on.
    pub fn swapped(&mut self, inbox: &Inbox, tracker: &Tracker, active: &Active, (frame, takeover): (u64, Takeover)) {
        // A recording without a snapshot yet begins with the model at that time.
        if let (Some(tap), Some(known)) = (inbox.tap(), &self.tap)
            && Arc::ptr_eq(&tap, known)
        {
            tap.note(begin(tracker, active, frame, Some(takeover)));
        }
    }

    /// After a fit.
    pub fn after(&self, delivery: &Delivery, course: FitCourse, estimates: &[Arc<EstimateView>]) {
        let Some(tap) = &self.tap else { return };
        let FitCourse(fit) = course;
        tap.note(Note::Fit(Box::new(FitNote { fit, at_ns: delivery.at_ns(), estimates: estimates.to_vec() })));
    }
}

fn begin(tracker: &Tracker, active: &Active, frame: u64, takeover: Option<Takeover>) -> Note {
    let swap = LoggedSwap {
        frame,
        name: active.name.clone(),
        model: active.id.to_string(),
        media: active.media.name().to_string(),
        text: active.text.to_string(),
        vector_width: 8 * active.width.bytes(),
        constants: tracker.options().constants.clone(),
        is_warm: takeover == Some(Takeover::Warm),
    };
    let is_swap = takeover.is_some();
    Note::Begin(Box::new((ModelNote { swap, model: active.model.clone(), is_swap }, tracker.snapshot())))
}
