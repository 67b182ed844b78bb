//! Queue of a fit thread: the newest frame, swaps in order, the end of the source.

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
    /// The frame with its metadata.
    pub captured: Captured,
    /// When the source sent it, CLOCK_MONOTONIC.
    pub sent_ns: u64,
    /// When the frame was captured, ns since 1970, if its producer stamps it.
    pub capture_unix_ns: Option<u64>,
    /// The source's jump count: if it has grown, earlier frames do not lead up to this one.
    pub jumps: u64,
    /// The client that pushed it and waits for its estimate.
    pub reply: Mutex<Option<Reply>>,
}

impl Delivery {
    /// A frame that is sent now.
    pub fn now(captured: Captured, stamp: TimeOrigin, jumps: u64, reply: Option<Reply>) -> Delivery {
        let (sent_ns, reply) = (monotonic_ns(), Mutex::new(reply));
        let capture_ns = captured.frame.capture_ns.unwrap_or(sent_ns);
        let capture_unix_ns = if stamp == TimeOrigin::OfFrame { unix_ns_at(capture_ns) } else { None };
        Delivery { captured, sent_ns, capture_unix_ns, jumps, reply }
    }

    /// Capture time, else send time, CLOCK_MONOTONIC.
    pub fn at_ns(&self) -> u64 {
        self.captured.frame.capture_ns.unwrap_or(self.sent_ns)
    }
}

/// Origin of a frame's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeOrigin {
    /// Stamped by the camera's driver or the producer: the capture time.
    OfFrame,
    /// The time of arrival in the service, somewhat after the capture.
    OfArrival,
}

/// Destination of a pushed frame's estimate.
pub struct Reply {
    /// The session that was asked.
    pub session: Arc<Inbox>,
    /// Dropped if the frame is not fitted.
    pub sender: oneshot::Sender<Arc<EstimateView>>,
}

/// Why no more frames arrive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceEnd {
    /// The source has no more frames.
    Finished(String),
    /// The source failed.
    Failed(String),
}

/// A fitted frame with the tracker's state.
pub struct FittedFrame {
    /// The frame.
    pub delivery: Arc<Delivery>,
    /// The tracker after that frame.
    pub tracker: Tracker,
}

/// Which frame a sample is taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFrame {
    /// The next frame, once fitted.
    Next,
    /// The last fitted frame: the source stands still.
    Last,
}

/// The next task of a fit thread.
pub enum Event {
    /// Take the new model; comes before a waiting frame.
    Swap(Box<Swap>),
    /// Fit this frame.
    Frame(Arc<Delivery>),
    /// Report the end and keep waiting: a swap may follow.
    SourceEnded(SourceEnd),
    /// Show or sample the last frame again: no new one arrives.
    Look,
    /// End the thread.
    Closed,
}

/// The event that waits for the current fit to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waiting {
    /// At most the next frame.
    Nothing,
    /// A swap.
    Swap,
    /// The end of the session.
    End,
}

/// The queue between source and fit thread; holds only the newest frame.
#[derive(Default)]
pub struct Inbox {
    state: Mutex<State>,
    changed: Condvar,
    /// Receives the frames for a recording.
    tap: RwLock<Option<Arc<Tap>>>,
}

#[derive(Default)]
struct State {
    frame: Option<Arc<Delivery>>,
    is_fitting: bool,
    swaps: VecDeque<Box<Swap>>,
    end: Option<SourceEnd>,
    /// Pending sample requests.
    samples: Vec<(SampleFrame, SyncSender<FittedFrame>)>,
    is_looked_for: bool,
    is_closed: bool,
}

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends all further frames to that recording as well; `None` ends this.
    pub fn record(&self, tap: Option<Arc<Tap>>) {
        *self.tap.write().unwrap_or_else(PoisonError::into_inner) = tap;
    }

    /// The current recording's tap.
    pub fn tap(&self) -> Option<Arc<Tap>> {
        self.tap.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes a frame from the source; replaces a waiting one.
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

    /// Announces the end of the source.
    pub fn end(&self, end: SourceEnd) {
        self.lock().end = Some(end);
        self.changed.notify_all();
    }

    /// Queues a compiled model; returns it if the fit thread is gone.
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

    /// Waits for a fitted frame; `None` on timeout.
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

    /// Asks for the last frame to be shown again.
    pub fn look(&self) {
        self.lock().is_looked_for = true;
        self.changed.notify_all();
    }

    /// For the fit thread: takes the sample requests that this frame satisfies; `Next` satisfies all.
    pub fn take_samples(&self, which: SampleFrame) -> Vec<SyncSender<FittedFrame>> {
        let is_due = |sample: &mut (SampleFrame, _)| which == SampleFrame::Next || sample.0 == which;
        self.lock().samples.extract_if(.., is_due).map(|(_, sender)| sender).collect()
    }

    /// Ends the fit thread after its current task. Drops waiting swaps and frames, and with them their replies.
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

    /// For the fit thread during a fit: what waits for it.
    pub fn waiting(&self) -> Waiting {
        let state = self.lock();
        match (state.is_closed, state.swaps.is_empty()) {
            (true, _) => Waiting::End,
            (false, false) => Waiting::Swap,
            (false, true) => Waiting::Nothing,
        }
    }

    /// For the fit thread: blocks for the next event. Calling it marks the last event as done.
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
