//! Queue of a shadow's thread: the newest frame that its session has fitted, a request for its tracker, its end.
//!
//! The session's fit thread never blocks here. While the session drops frames, and for `LIMITS.shed_time` after, the shadow
//! gets none.

use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use isophote_symbolic::Model;
use isophote_tracker::{Estimate, Tracker};
use isophote_wire::EstimateView;

use crate::limits::LIMITS;
use crate::session::inbox::Delivery;

/// A frame that the session has fitted, with its results.
pub struct FittedPair {
    /// The frame.
    pub delivery: Arc<Delivery>,
    /// The session's model at that frame.
    pub model: Arc<Model>,
    /// The session's estimates, one per target.
    pub results: Arc<[Estimate]>,
    /// The same as published.
    pub estimates: Arc<[Arc<EstimateView>]>,
}

/// The next task of a shadow's thread.
pub enum ShadowTask {
    /// Fit this frame.
    Frame(FittedPair),
    /// Send a copy of the tracker.
    Tracker(SyncSender<Tracker>),
    /// End the thread.
    End,
}

/// The queue of one shadow.
#[derive(Default)]
pub struct ShadowSlot {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    frame: Option<FittedPair>,
    tracker: Option<SyncSender<Tracker>>,
    /// Frames of the session that it did not fit.
    dropped: u64,
    /// It gets no frames until then.
    shed_until_ns: u64,
    is_closed: bool,
}

impl ShadowSlot {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a frame from the session, which dropped `lost` before it; replaces a waiting one.
    pub fn offer(&self, pair: FittedPair, lost: u64, now_ns: u64) {
        let left = {
            let mut state = self.lock();
            if lost > 0 {
                state.shed_until_ns = now_ns + LIMITS.shed_time.as_nanos() as u64;
            }
            let is_refused = state.is_closed || now_ns < state.shed_until_ns;
            let left = if is_refused { Some(pair) } else { state.frame.replace(pair) };
            state.dropped += u64::from(left.is_some() && !state.is_closed);
            left
        };
        self.changed.notify_all();
        drop(left); // its buffer may be large
    }

    /// Number of frames not fitted, and whether it is shed now.
    pub fn shed(&self, now_ns: u64) -> (u64, bool) {
        let state = self.lock();
        (state.dropped, now_ns < state.shed_until_ns)
    }

    /// Requests the tracker; the sender is dropped if the shadow ends first.
    pub fn ask(&self, reply: SyncSender<Tracker>) {
        let mut state = self.lock();
        if !state.is_closed {
            state.tracker = Some(reply);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Ends the thread after its current task.
    pub fn close(&self) {
        let left = {
            let mut state = self.lock();
            state.is_closed = true;
            (state.frame.take(), state.tracker.take())
        };
        self.changed.notify_all();
        drop(left);
    }

    /// Whether the thread is to end or a tracker is requested.
    pub fn is_awaited(&self) -> bool {
        let state = self.lock();
        state.is_closed || state.tracker.is_some()
    }

    /// Blocks for the next task; called by the shadow's thread.
    pub fn next(&self) -> ShadowTask {
        let mut state = self.lock();
        loop {
            if state.is_closed {
                return ShadowTask::End;
            }
            if let Some(reply) = state.tracker.take() {
                return ShadowTask::Tracker(reply);
            }
            if let Some(pair) = state.frame.take() {
                return ShadowTask::Frame(pair);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::mpsc::sync_channel;

    use isophote_capture::Captured;
    use isophote_jit::PixelFormat;
    use isophote_tracker::{Frame, Plane};

    use super::*;
    use crate::session::inbox::TimeOrigin;

    const MODEL: &str = include_str!("../../../../models/gaussian.toml");

    fn pair(number: u64) -> FittedPair {
        let frame = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::U8, vec![0], 1)]).unwrap();
        let captured = Captured { frame: frame.with_sequence(number), file: None, truth: None };
        let delivery = Arc::new(Delivery::now(captured, TimeOrigin::OfArrival, 0, None));
        let model = Arc::new(Model::from_toml(MODEL).unwrap());
        FittedPair { delivery, model, results: Arc::default(), estimates: Arc::default() }
    }

    fn number(wanted: ShadowTask) -> Option<u64> {
        match wanted {
            ShadowTask::Frame(pair) => Some(pair.delivery.captured.frame.sequence),
            ShadowTask::Tracker(_) | ShadowTask::End => None,
        }
    }

    #[test]
    fn newest_frame_replaces_a_waiting_one() {
        let slot = ShadowSlot::default();
        (0..5).for_each(|n| slot.offer(pair(n), 0, n));
        assert_eq!((number(slot.next()), slot.shed(5)), (Some(4), (4, false)));
        let (asked, answer) = sync_channel(1);
        slot.offer(pair(5), 0, 5);
        slot.ask(asked);
        assert!(slot.is_awaited());
        assert_eq!(number(slot.next()), None, "who waits goes before a frame");
        assert_eq!(number(slot.next()), Some(5));
        slot.close();
        assert!(matches!(slot.next(), ShadowTask::End));
        slot.offer(pair(6), 0, 6);
        let (late, never) = sync_channel(1);
        slot.ask(late);
        assert!(never.recv().is_err() && answer.recv().is_err(), "nobody answers");
        assert_eq!(slot.shed(6).0, 4, "what comes after the end is not lost");
    }

    #[test]
    fn shadow_gets_no_frames_while_the_session_drops_some() {
        let slot = ShadowSlot::default();
        let while_ns = LIMITS.shed_time.as_nanos() as u64;
        slot.offer(pair(0), 0, 0);
        slot.offer(pair(2), 1, 10);
        assert_eq!(slot.shed(10), (1, true));
        assert_eq!(number(slot.next()), Some(0), "what was there before");
        slot.offer(pair(3), 0, 10 + while_ns - 1);
        assert_eq!(slot.shed(10 + while_ns - 1), (2, true));
        slot.offer(pair(4), 0, 10 + while_ns);
        assert_eq!((slot.shed(10 + while_ns), number(slot.next())), ((2, false), Some(4)));
    }
}
