//! `prompt`: streams that the thread which has the news writes to itself, so that no other thread has to be woken in between.
//!
//! What comes in: a stream, as a future that a runtime runs. What goes out: the same, some turns of which are taken by a thread
//! that wakes it from within [`tell`]. Such a thread writes what the socket takes at once and does nothing else: it never waits,
//! never reads, and after a few turns the runtime goes on.

use std::cell::Cell;
use std::future::poll_fn;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Wake, Waker};

use futures_util::task::AtomicWaker;
use tokio::runtime::Handle;

/// Turns of one telling: one for each stream that it wakes, first message included, and one for each further message; each takes
/// some ten µs.
const TURNS: u32 = 8;

thread_local! {
    /// What this thread has left, while it tells.
    static LEFT: Cell<Option<u32>> = const { Cell::new(None) };
}

fn is_telling() -> bool {
    LEFT.get().is_some()
}

/// Takes a turn of this thread, if it tells and has one left.
fn take_turn() -> bool {
    let left = LEFT.get().filter(|left| *left > 0);
    if let Some(left) = left {
        LEFT.set(Some(left - 1));
    }
    left.is_some()
}

/// Runs `wake`; the first streams that it wakes write before it returns.
pub fn tell(wake: impl FnOnce()) {
    LEFT.set(Some(TURNS));
    wake();
    LEFT.set(None);
}

/// To be awaited before each message: beyond its turns the thread that tells leaves the rest to the runtime.
pub async fn turn() {
    poll_fn(|context| {
        if !is_telling() || take_turn() {
            return Poll::Ready(());
        }
        context.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// What the thread that tells never does: reading, which a client could make last. The future must have been polled by the
/// runtime since it was ready last, as a socket's next message has been by a stream that waits for it and for news at once.
pub async fn elsewhere<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    poll_fn(|context| if is_telling() { Poll::Pending } else { future.as_mut().poll(context) }).await
}

/// A stream that is written to as soon as there is news. The runtime runs it like any other future, in whose place it is awaited.
pub async fn prompt(stream: impl Future<Output = ()> + Send + 'static) {
    let stream: Running = Box::pin(stream);
    let stream = Arc::new(PromptStream {
        running: Mutex::new(Some(stream)),
        runtime: Handle::current(),
        task: AtomicWaker::new(),
    });
    let _ends_with_this = Ended(stream.clone());
    poll_fn(|context| {
        stream.task.register(context.waker());
        let mut running = stream.running.lock().unwrap_or_else(PoisonError::into_inner);
        stream.poll(&mut running)
    })
    .await;
}

type Running = Pin<Box<dyn Future<Output = ()> + Send>>;

struct PromptStream {
    /// None when it is over.
    running: Mutex<Option<Running>>,
    runtime: Handle,
    /// Where the runtime awaits it.
    task: AtomicWaker,
}

impl PromptStream {
    fn poll(self: &Arc<Self>, running: &mut Option<Running>) -> Poll<()> {
        let Some(stream) = running else { return Poll::Ready(()) };
        let waker = Waker::from(self.clone());
        let poll = stream.as_mut().poll(&mut Context::from_waker(&waker));
        if poll.is_ready() {
            *running = None;
        }
        poll
    }

    /// On the thread that tells. False where the runtime has to go on: it is at it already, the stream is over, or it panicked, and
    /// will again where nobody but itself is hurt.
    fn write(self: &Arc<Self>) -> bool {
        let Ok(mut running) = self.running.try_lock() else { return false };
        let _timers = self.runtime.enter();
        let polled = catch_unwind(AssertUnwindSafe(|| self.poll(&mut running)));
        matches!(polled, Ok(Poll::Pending))
    }
}

impl Wake for PromptStream {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if !(take_turn() && self.write()) {
            self.task.wake();
        }
    }
}

/// Nobody awaits the stream any more: what it holds is given back, whoever still has its waker.
struct Ended(Arc<PromptStream>);

impl Drop for Ended {
    fn drop(&mut self) {
        *self.0.running.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::thread::ThreadId;

    use tokio::sync::Notify;

    use super::*;

    /// News of which each is written down, with the thread that wrote it.
    #[derive(Default)]
    struct News {
        told: AtomicUsize,
        changed: Notify,
        written: Mutex<Vec<ThreadId>>,
    }

    impl News {
        fn tell(&self, count: usize) {
            self.told.fetch_add(count, Ordering::SeqCst);
            tell(|| self.changed.notify_waiters());
        }

        fn written(&self) -> Vec<ThreadId> {
            self.written.lock().unwrap().clone()
        }

        async fn write_all(self: Arc<News>) {
            loop {
                turn().await;
                loop {
                    let changed = self.changed.notified();
                    if self.written().len() < self.told.load(Ordering::SeqCst) {
                        break;
                    }
                    changed.await;
                }
                self.written.lock().unwrap().push(std::thread::current().id());
            }
        }
    }

    /// As the runtime would, once.
    fn poll_once(future: Pin<&mut impl Future>) -> bool {
        future.poll(&mut Context::from_waker(Waker::noop())).is_ready()
    }

    #[tokio::test]
    async fn who_tells_writes_and_leaves_what_is_too_much_to_the_runtime() {
        let news = Arc::new(News::default());
        let mut stream = pin!(prompt(news.clone().write_all()));
        assert!(!poll_once(stream.as_mut()));
        let teller = std::thread::Builder::new().name("tell".into());
        let telling = news.clone();
        let teller = teller.spawn(move || {
            telling.tell(1);
            let one = telling.written().len();
            telling.tell(100);
            (one, std::thread::current().id())
        });
        let (one, teller) = teller.unwrap().join().unwrap();
        let by_teller = news.written();
        assert_eq!((one, by_teller.len()), (1, 1 + TURNS as usize));
        assert!(by_teller.iter().all(|thread| *thread == teller));
        assert!(!poll_once(stream));
        let rest = news.written().split_off(by_teller.len());
        assert!(rest.len() == 100 - TURNS as usize && rest.iter().all(|thread| *thread == std::thread::current().id()));
    }

    #[tokio::test]
    async fn a_stream_is_woken_as_ever_by_those_who_do_not_tell() {
        let news = Arc::new(News::default());
        let stream = tokio::spawn(prompt(news.clone().write_all()));
        while news.written().len() < 100 {
            news.told.fetch_add(1, Ordering::SeqCst);
            news.changed.notify_waiters();
            tokio::task::yield_now().await;
        }
        stream.abort();
        assert!(stream.await.unwrap_err().is_cancelled());
        assert_eq!(Arc::strong_count(&news), 1);
    }

    #[tokio::test]
    async fn nothing_is_read_by_who_tells() {
        let reads = Arc::new(AtomicUsize::new(0));
        let read = reads.clone();
        let mut reading = Box::pin(elsewhere(async move { read.fetch_add(1, Ordering::SeqCst) }));
        tell(|| assert!(!poll_once(reading.as_mut())));
        assert_eq!(reads.load(Ordering::SeqCst), 0);
        assert!(poll_once(reading.as_mut()));
        assert_eq!(reads.load(Ordering::SeqCst), 1);
    }

    /// A fault of a stream is its own: the thread that tells goes on.
    #[tokio::test]
    async fn a_panic_stays_with_the_stream() {
        let changed = Arc::new(Notify::new());
        let news = changed.clone();
        let stream = tokio::spawn(prompt(async move {
            news.notified().await;
            panic!("a fault");
        }));
        tokio::task::yield_now().await;
        tell(|| changed.notify_waiters());
        assert!(stream.await.unwrap_err().is_panic());
    }
}
