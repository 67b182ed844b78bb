//! What waits for a fit thread: the newest frame, swaps in order, the end of the source.

use std::collections::VecDeque;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::Duration;

use isophote_capture::Captured;
use isophote_machine::{monotonic_ns, unix_ns_at};
use isophote_tracker::Tracker;
use isophote_wire::EstimateView;
use tokio::sync::oneshot;

use super::swap::Swap;
use crate::recording::Tap;

/// One frame on its way to the sessions that share its source.
pub struct Delivery {
    /// The frame and what is known about it.
    pub captured: Captured,
    /// When the source handed it on, CLOCK_MONOTONIC.
    pub sent_ns: u64,
    /// When the frame was taken, ns since 1970, where whoever made it says so.
    pub capture_unix_ns: Option<u64>,
    /// How often the source has gone on elsewhere: where that has grown, what was seen before does not go on.
    pub jumps: u64,
    /// Who pushed it and waits for its estimate.
    pub reply: Mutex<Option<Reply>>,
}

impl Delivery {
    /// A frame that is handed on now.
    pub fn now(captured: Captured, stamp: TimeOrigin, jumps: u64, reply: Option<Reply>) -> Delivery {
        let (sent_ns, reply) = (monotonic_ns(), Mutex::new(reply));
        let capture_ns = captured.frame.capture_ns.unwrap_or(sent_ns);
        let capture_unix_ns = if stamp == TimeOrigin::OfFrame { unix_ns_at(capture_ns) } else { None };
        Delivery { captured, sent_ns, capture_unix_ns, jumps, reply }
    }

    /// When it was captured, else when it was handed on, CLOCK_MONOTONIC.
    pub fn at_ns(&self) -> u64 {
        self.captured.frame.capture_ns.unwrap_or(self.sent_ns)
    }
}

/// Whose time a frame's is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeOrigin {
    /// The frame's: the camera's driver, or who made it, says when it was taken.
    OfFrame,
    /// That at which the service had it; it was taken some time before.
    OfArrival,
}

/// Where the estimate of a pushed frame goes.
pub struct Reply {
    /// The session that was asked.
    pub session: Arc<Inbox>,
    /// Dropped when the frame is not fitted.
    pub sender: oneshot::Sender<Arc<EstimateView>>,
}

/// Why no more frames come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceEnd {
    /// There are no more.
    Finished(String),
    /// The source failed.
    Failed(String),
}

/// A frame that was fitted, and what the session knew of its target then.
pub struct FittedFrame {
    /// The frame.
    pub delivery: Arc<Delivery>,
    /// After it.
    pub tracker: Tracker,
}

/// What something is tried on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFrame {
    /// The next frame, when it is fitted.
    Next,
    /// The last one: no other comes.
    Last,
}

/// What a fit thread does next.
pub enum Event {
    /// Take the new model; comes before a frame that waits.
    Swap(Box<Swap>),
    /// Fit.
    Frame(Arc<Delivery>),
    /// Say so and go on waiting: a swap may still come.
    SourceEnded(SourceEnd),
    /// Show the frame before once more, and have it tried on: no other one comes.
    Look,
    /// Leave.
    Closed,
}

/// What a fit that takes long holds up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waiting {
    /// Nothing but the next frame.
    Nothing,
    /// A new model.
    Swap,
    /// Whoever stops the session.
    End,
}

/// The slot between source and fit thread: the newest frame wins.
#[derive(Default)]
pub struct Inbox {
    state: Mutex<State>,
    changed: Condvar,
    /// Where a recording of the session takes its frames.
    tap: RwLock<Option<Arc<Tap>>>,
}

#[derive(Default)]
struct State {
    frame: Option<Arc<Delivery>>,
    is_fitting: bool,
    swaps: VecDeque<Box<Swap>>,
    end: Option<SourceEnd>,
    /// Who wants to try something on a frame.
    samples: Vec<(SampleFrame, SyncSender<FittedFrame>)>,
    is_looked_for: bool,
    is_closed: bool,
}

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on all frames go to that recording as well, or to none.
    pub fn record(&self, tap: Option<Arc<Tap>>) {
        *self.tap.write().unwrap_or_else(PoisonError::into_inner) = tap;
    }

    /// The recording that takes its frames.
    pub fn tap(&self) -> Option<Arc<Tap>> {
        self.tap.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// A frame from the source; one that still waits is dropped.
    pub fn deliver(&self, frame: Arc<Delivery>) {
        if let Some(tap) = self.tap() {
            tap.frame(&frame.captured.frame, frame.at_ns());
        }
        let replaced = {
            let mut state = self.lock();
            if state.is_closed { Some(frame) } else { state.frame.replace(frame) }
        };
        self.changed.notify_all();
        drop(replaced); // its buffer may be large
    }

    /// Blocks until everything delivered is fitted, or the inbox is closed.
    pub fn wait_idle(&self) {
        let is_busy = |state: &mut State| !state.is_closed && (state.is_fitting || state.frame.is_some());
        drop(self.changed.wait_while(self.lock(), is_busy).unwrap_or_else(PoisonError::into_inner));
    }

    /// No more frames come.
    pub fn end(&self, end: SourceEnd) {
        self.lock().end = Some(end);
        self.changed.notify_all();
    }

    /// Hands a compiled model over; gives it back when the fit thread is gone.
    pub fn swap(&self, swap: Box<Swap>) -> Result<(), Box<Swap>> {
        {
            let mut state = self.lock();
            if state.is_closed {
                return Err(swap);
            }
            state.swaps.push_back(swap);
        }
        self.changed.notify_all();
        Ok(())
    }

    /// A frame that was fitted; `None` when there is none within that time.
    pub fn sample(&self, which: SampleFrame, within: Duration) -> Option<FittedFrame> {
        let (sender, sample) = sync_channel(1);
        {
            let mut state = self.lock();
            if state.is_closed {
                return None;
            }
            state.samples.push((which, sender));
            state.is_looked_for |= which == SampleFrame::Last;
        }
        self.changed.notify_all();
        sample.recv_timeout(within).ok()
    }

    /// Somebody looks at a session that has no new frames.
    pub fn look(&self) {
        self.lock().is_looked_for = true;
        self.changed.notify_all();
    }

    /// For the fit thread: who wants to try something on the frame that it has just fitted, or on the last one.
    pub fn take_samples(&self, which: SampleFrame) -> Vec<SyncSender<FittedFrame>> {
        let is_due = |sample: &mut (SampleFrame, _)| which == SampleFrame::Next || sample.0 == which;
        self.lock().samples.extract_if(.., is_due).map(|(_, sender)| sender).collect()
    }

    /// Ends the fit thread after what it does now. Swaps and frames that wait are dropped, and with them their replies.
    pub fn close(&self) {
        let (frame, swaps) = {
            let mut state = self.lock();
            state.is_closed = true;
            state.is_fitting = false;
            state.samples.clear();
            (state.frame.take(), std::mem::take(&mut state.swaps))
        };
        self.changed.notify_all();
        drop((frame, swaps));
    }

    /// For the fit thread during a fit: what waits for it to end.
    pub fn waiting(&self) -> Waiting {
        let state = self.lock();
        match (state.is_closed, state.swaps.is_empty()) {
            (true, _) => Waiting::End,
            (false, false) => Waiting::Swap,
            (false, true) => Waiting::Nothing,
        }
    }

    /// For the fit thread: what comes next. Calling it says that the last event is done with.
    pub fn next(&self) -> Event {
        let mut state = self.lock();
        if state.is_fitting {
            state.is_fitting = false;
            self.changed.notify_all();
        }
        loop {
            if state.is_closed {
                return Event::Closed;
            }
            if let Some(swap) = state.swaps.pop_front() {
                return Event::Swap(swap);
            }
            if let Some(frame) = state.frame.take() {
                state.is_fitting = true;
                return Event::Frame(frame);
            }
            if let Some(end) = state.end.take() {
                return Event::SourceEnded(end);
            }
            if std::mem::take(&mut state.is_looked_for) {
                return Event::Look;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}
