//! Previews of one session: from its fit thread to whoever looks, by way of a thread that draws.
//!
//! What comes in: what viewers ask for, and a frame with its estimates when somebody does. What goes out: messages, each made once
//! for all who asked for the same. While nobody looks there is no thread, and the fit thread reads one number a frame.
//!
//! Where no frame comes, since the source is paused or slow, the fit thread shows the last one to who has not seen it yet.
//!
//! A viewer asks for one message at a time, the next frame's: nothing is queued, and what is newest wins. An ask is due at some time,
//! by the rate that its viewer wants, and may be answered a little before, with those of others.

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
use crate::problem::Problem;
use crate::room::{RoomTaken, SharedRoom};
use crate::thread::step_aside;
pub use draw::PreviewMessage;

/// What a viewer wants to see, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PreviewForm {
    /// How pixels are sent.
    pub format: PreviewFormat,
    /// What of the frame.
    pub part: PreviewPart,
    /// So many pixels along x and y become one.
    pub step: usize,
    /// Of JPEG, 1 to 100.
    pub quality: u8,
}

/// A frame that was fitted, and all that belongs to it.
pub struct FittedScene {
    /// As it came; its buffer may be on loan.
    pub frame: Frame,
    /// What was estimated from it, …
    pub estimates: Arc<[Estimate]>,
    /// … and as it is published.
    pub views: Arc<[Arc<EstimateView>]>,
    /// Of the model that fitted it.
    pub viewer: Arc<Viewer>,
    /// The session's name.
    pub session: String,
    /// The session's start.
    pub epoch: u64,
}

/// For the next frame, before the last one is shown to who has not seen it.
const NEXT_TIME: Duration = Duration::from_millis(250);

/// Of one session.
pub struct Preview {
    /// Has the fit thread show the last frame once more.
    look: Box<dyn Fn() + Send + Sync>,
    /// The number after that of the newest frame that was fitted.
    after_newest: AtomicU64,
    state: Mutex<State>,
    changed: Condvar,
    /// Read by the fit thread: the next frame is to be shown.
    is_wanted: AtomicBool,
    /// Frames that were handed over.
    pub frames: Tally,
    /// Messages that were made.
    pub messages: Tally,
}

#[derive(Default)]
struct State {
    viewers: usize,
    /// There is a thread that draws.
    draws: bool,
    asks: Vec<Ask>,
    scene: Option<Box<FittedScene>>,
}

struct Ask {
    form: PreviewForm,
    /// Not before.
    from: Instant,
    /// From then on the next frame is asked for.
    due: Instant,
    /// The number after that of the frame that the viewer has.
    after_seen: u64,
    /// What messages of all viewers take their bytes of.
    room: SharedRoom,
    reply: oneshot::Sender<ShownFrame>,
}

/// What a viewer gets.
#[derive(Debug)]
pub struct ShownFrame {
    /// The frame's number.
    pub number: u64,
    /// Of what was asked for.
    pub message: PreviewMessage,
    /// That of the message's bytes, to be kept until they are sent.
    pub room: RoomTaken,
}

/// One viewer; it leaves when this is dropped.
pub struct PreviewSeat {
    preview: Arc<Preview>,
    room: SharedRoom,
}

impl Preview {
    /// Of the session whose fit thread shows its last frame once more when `look` is called; nobody looks yet.
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

    /// For the fit thread after a fit.
    pub fn has_frame(&self, number: u64) {
        self.after_newest.store(number + 1, Ordering::Release);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many look.
    pub fn viewers(&self) -> usize {
        self.lock().viewers
    }

    /// For the fit thread after a fit: whether that frame is to be shown.
    pub fn is_wanted(&self) -> bool {
        self.is_wanted.load(Ordering::Acquire)
    }

    /// For the fit thread, when it is.
    pub fn show(&self, scene: FittedScene) {
        let replaced = {
            let mut state = self.lock();
            self.is_wanted.store(false, Ordering::Release);
            // Who wanted it may have gone, and nobody would take it.
            if state.draws { state.scene.replace(Box::new(scene)) } else { Some(Box::new(scene)) }
        };
        self.changed.notify_all();
        drop(replaced);
    }

    /// A new viewer of a session of that name, whose messages take their bytes of that room.
    pub fn look(self: &Arc<Preview>, session: &str, room: SharedRoom) -> Result<PreviewSeat, Problem> {
        let starts = {
            let mut state = self.lock();
            state.viewers += 1;
            !std::mem::replace(&mut state.draws, true)
        };
        let seat = PreviewSeat { preview: self.clone(), room };
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

    /// Until nobody looks any more.
    fn draw(&self) {
        while let Some((scene, asks)) = self.next() {
            self.frames.add(1);
            // Those for whose messages there is no room have the same from a later frame.
            let left = draw::answer(*scene, asks, &self.messages);
            let later = Instant::now() + LIMITS.picture_time;
            self.lock().asks.extend(left.into_iter().map(|ask| Ask { from: later, due: later, ..ask }));
        }
    }

    /// The next frame that is asked for, and who asks; `None` when nobody looks any more.
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
                // Whoever wanted it has gone: its buffer may be on loan.
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

/// Fits go first.
const NICER: i32 = 5;

/// Whatever ends the thread, the next viewer starts another one, and who waits hears of it.
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
    /// The first frame that is fitted from `due` on, or some frame from `from` on; where none comes, the last one, unless it was
    /// the one before `after_seen`. An error where the thread that draws has failed.
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
            state.asks.push(Ask { form, from, due, after_seen, room: self.room.clone(), reply });
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
