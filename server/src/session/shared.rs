//! `Shared`: what a fit thread shares with the rest of the service.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::inbox::Inbox;
use super::shadow::Shadow;
use super::status::Status;
use crate::counters::SessionCounters;
use crate::hub::Hub;
use crate::preview::Preview;

/// Of one session.
pub struct Shared {
    /// What waits for the thread.
    pub inbox: Arc<Inbox>,
    /// What it has found.
    pub hub: Arc<Hub>,
    /// What it looks like.
    pub preview: Arc<Preview>,
    /// What is counted of it.
    pub counters: SessionCounters,
    status: Mutex<Status>,
    shadow: Mutex<Option<Arc<Shadow>>>,
}

impl Shared {
    /// Before the first frame.
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

    /// Another model on the same frames, if there is one.
    pub fn shadow(&self) -> Option<Arc<Shadow>> {
        self.shadow.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The one in the place of the other, which is handed back.
    pub fn replace_shadow(&self, shadow: Option<Arc<Shadow>>) -> Option<Arc<Shadow>> {
        std::mem::replace(&mut *self.shadow.lock().unwrap_or_else(PoisonError::into_inner), shadow)
    }

    /// What it tells about itself.
    pub fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
