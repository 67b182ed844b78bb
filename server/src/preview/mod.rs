//! `Preview`: draws the frames of one session for its viewers, on a thread of its own.
//!
//! A message is made once for all viewers that asked for the same form. Without viewers there is no thread, and the fit thread
//! reads one flag per frame. If no frame comes, since the source is paused or slow, the fit thread shows the last one to
//! viewers that have not seen it.
//!
//! A viewer asks for one message at a time, of the next frame: nothing is queued, and the newest wins. A request is due at a
//! time given by its viewer's rate, and may be answered a little earlier together with others.

mod draw;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::Builder;
use std::time::{Duration, Instant};

use isophote_tracker::{Estimate, Frame, Viewer};
use isophote_wire::{EstimateView, PreviewFormat, PreviewPart};
use tokio::sync::oneshot;

use crate::counters::Tally;
use crate::limits::LIMITS;
use crate::net::quota::{QuotaPermit, SharedQuota};
use crate::problem::Problem;
use crate::thread::step_aside;
pub use draw::PreviewMessage;

/// The form of a preview that a viewer wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PreviewForm {
    /// Pixel format.
    pub format: PreviewFormat,
    /// Part of the frame.
    pub part: PreviewPart,
    /// Reduction along x and y.
    pub step: usize,
    /// Quality of JPEG, 1 to 100.
    pub quality: u8,
}

/// A fitted frame with its estimates.
pub struct FittedScene {
    /// The frame; its buffer may be on loan.
    pub frame: Frame,
    /// Its estimates.
    pub estimates: Arc<[Estimate]>,
    /// Its estimates as published.
    pub views: Arc<[Arc<EstimateView>]>,
    /// Draws the model that fitted it.
    pub viewer: Arc<Viewer>,
    /// The session's name.
    pub session: String,
    /// The session's start.
    pub epoch: u64,
}

/// Wait for the next frame, before the last one is shown to viewers that have not seen it.
const NEXT_TIME: Duration = Duration::from_millis(250);

/// The preview of one session.
pub struct Preview {
    /// Makes the fit thread show the last frame again.
    look: Box<dyn Fn() + Send + Sync>,
    /// Number of the newest fitted frame, plus one.
    after_newest: AtomicU64,
    state: Mutex<State>,
    changed: Condvar,
    /// Read by the fit thread: whether to show the next frame.
    is_wanted: AtomicBool,
    /// Frames that were handed over.
    pub frames: Tally,
    /// Messages made.
    pub messages: Tally,
}

#[derive(Default)]
struct State {
    viewers: usize,
    /// Whether the drawing thread runs.
    draws: bool,
    asks: Vec<Ask>,
    scene: Option<Box<FittedScene>>,
}

struct Ask {
    form: PreviewForm,
    /// Earliest time of an answer.
    from: Instant,
    /// Time from which the next frame is requested.
    due: Instant,
    /// Number of the frame that the viewer has, plus one.
    after_seen: u64,
    /// Quota of the bytes of all viewers' messages.
    quota: SharedQuota,
    reply: oneshot::Sender<ShownFrame>,
}

/// A message for a viewer.
#[derive(Debug)]
pub struct ShownFrame {
    /// The frame's number.
    pub number: u64,
    /// The message.
    pub message: PreviewMessage,
    /// Permit of the message's bytes, held until they are sent.
    pub quota: QuotaPermit,
}

/// One viewer, until this is dropped.
pub struct PreviewSeat {
    preview: Arc<Preview>,
    quota: SharedQuota,
}

impl Preview {
    /// A preview without viewers; `look` makes the session's fit thread show its last frame again.
    pub fn new(look: impl Fn() + Send + Sync + 'static) -> Preview {
        Preview {
            look: Box::new(look),
            after_newest: AtomicU64::new(0),
            state: Mutex::default(),
            changed: Condvar::new(),
            is_wanted: AtomicBool::new(false),
            frames: Tally::default(),
            messages: Tally::default(),
        }
    }

    /// Called by the fit thread after a fit.
    pub fn has_frame(&self, number: u64) {
        self.after_newest.store(number + 1, Ordering::Release);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of viewers.
    pub fn viewers(&self) -> usize {
        self.lock().viewers
    }

    /// Called by the fit thread after a fit: whether to show that frame.
    pub fn is_wanted(&self) -> bool {
        self.is_wanted.load(Ordering::Acquire)
    }

    /// Called by the fit thread with a wanted frame.
    pub fn show(&self, scene: FittedScene) {
        let replaced = {
            let mut state = self.lock();
            self.is_wanted.store(false, Ordering::Release);
            // The viewer may be gone, and nobody would take it.
            if state.draws { state.scene.replace(Box::new(scene)) } else { Some(Box::new(scene)) }
        };
        self.changed.notify_all();
        drop(replaced);
    }

    /// Adds a viewer of that session, whose messages take their bytes from `quota`.
    pub fn look(self: &Arc<Preview>, session: &str, quota: SharedQuota) -> Result<PreviewSeat, Problem> {
        let starts = {
            let mut state = self.lock();
            state.viewers += 1;
            !std::mem::replace(&mut state.draws, true)
        };
        let seat = PreviewSeat { preview: self.clone(), quota };
        if starts {
            let preview = self.clone();
            let work = move || {
                let _guard = DrawGuard(preview.clone());
                step_aside(NICER);
                preview.draw();
            };
            if let Err(error) = Builder::new().name(format!("preview {session}")).spawn(work) {
                self.lock().draws = false;
                return Err(Problem::no_thread("for the preview", &error));
            }
        }
        Ok(seat)
    }

    /// Draws until there are no viewers.
    fn draw(&self) {
        while let Some((scene, asks)) = self.next() {
            self.frames.add(1);
            // Requests without quota are answered with a later frame.
            let left = draw::answer(*scene, asks, &self.messages);
            let later = Instant::now() + LIMITS.picture_time;
            self.lock().asks.extend(left.into_iter().map(|ask| Ask { from: later, due: later, ..ask }));
        }
    }

    /// The next requested frame with its requests; `None` without viewers.
    fn next(&self) -> Option<(Box<FittedScene>, Vec<Ask>)> {
        let mut state = self.lock();
        loop {
            if state.viewers == 0 {
                state.draws = false;
                state.asks.clear();
                self.is_wanted.store(false, Ordering::Release);
                drop(state.scene.take());
                return None;
            }
            state.asks.retain(|ask| !ask.reply.is_closed());
            let now = Instant::now();
            let due = state.asks.iter().map(|ask| ask.due).min();
            if due.is_none_or(|due| due > now) {
                // Its viewers are gone; return its buffer, which may be on loan.
                self.is_wanted.store(false, Ordering::Release);
                drop(state.scene.take());
                state = match due {
                    None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                    Some(due) => {
                        let waited = self.changed.wait_timeout(state, due - now);
                        waited.unwrap_or_else(PoisonError::into_inner).0
                    }
                };
                continue;
            }
            if let Some(scene) = state.scene.take() {
                let asks = std::mem::take(&mut state.asks);
                let (answered, later) = asks.into_iter().partition(|ask| ask.from <= now);
                state.asks = later;
                return Some((scene, answered));
            }
            self.is_wanted.store(true, Ordering::Release);
            let newest = self.after_newest.load(Ordering::Acquire);
            if state.asks.iter().all(|ask| ask.from > now || ask.after_seen == newest) {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            }
            let waited = self.changed.wait_timeout(state, NEXT_TIME).unwrap_or_else(PoisonError::into_inner);
            if waited.1.timed_out() {
                (self.look)();
            }
            state = waited.0;
        }
    }
}

/// Nice value of the drawing thread, below fits.
const NICER: i32 = 5;

/// After a panic of the thread, fails the waiting requests and lets the next viewer start another thread.
struct DrawGuard(Arc<Preview>);

impl Drop for DrawGuard {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let mut state = self.0.lock();
            state.draws = false;
            state.asks.clear();
            state.scene = None;
            self.0.is_wanted.store(false, Ordering::Release);
        }
    }
}

impl PreviewSeat {
    /// Requests the first frame fitted after `due`, or one from `from` on; without a new frame the last one, unless that is the
    /// one before `after_seen`. An error means that the drawing thread has failed.
    pub fn ask(
        &self,
        form: PreviewForm,
        from: Instant,
        due: Instant,
        after_seen: u64,
    ) -> oneshot::Receiver<ShownFrame> {
        let (reply, message) = oneshot::channel();
        let mut state = self.preview.lock();
        if state.draws {
            state.asks.push(Ask { form, from, due, after_seen, quota: self.quota.clone(), reply });
        }
        drop(state);
        self.preview.changed.notify_all();
        message
    }
}

impl Drop for PreviewSeat {
    fn drop(&mut self) {
        self.preview.lock().viewers -= 1;
        self.preview.changed.notify_all();
    }
}
