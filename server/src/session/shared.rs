//! State shared between a fit thread and the rest of the service.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::inbox::Inbox;
use super::shadow::Shadow;
use super::status::Status;
use crate::counters::SessionCounters;
use crate::hub::Hub;
use crate::preview::Preview;

/// The shared state of one session.
pub struct Shared {
    /// The thread's queue.
    pub inbox: Arc<Inbox>,
    /// Publishes its estimates.
    pub hub: Arc<Hub>,
    /// Its preview images.
    pub preview: Arc<Preview>,
    /// Its counters.
    pub counters: SessionCounters,
    status: Mutex<Status>,
    shadow: Mutex<Option<Arc<Shadow>>>,
}

impl Shared {
    /// The state before the first frame.
    pub fn new(status: Status) -> Shared {
        let inbox = Arc::<Inbox>::default();
        let looked_at = inbox.clone();
        Shared {
            preview: Arc::new(Preview::new(move || looked_at.look())),
            inbox,
            hub: Arc::default(),
            counters: SessionCounters::default(),
            status: Mutex::new(status),
            shadow: Mutex::default(),
        }
    }

    /// The shadow, if there is one.
    pub fn shadow(&self) -> Option<Arc<Shadow>> {
        self.shadow.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Replaces the shadow and returns the previous one.
    pub fn replace_shadow(&self, shadow: Option<Arc<Shadow>>) -> Option<Arc<Shadow>> {
        std::mem::replace(&mut *self.shadow.lock().unwrap_or_else(PoisonError::into_inner), shadow)
    }

    /// The session's status.
    pub fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
