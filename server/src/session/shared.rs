//! `Shared`: what a fit thread shares with the rest of the service.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::inbox::Inbox;
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
}

impl Shared {
    /// Before the first frame.
    pub fn new(status: Status) -> Shared {
        Shared {
            inbox: Arc::default(),
            hub: Arc::default(),
            preview: Arc::default(),
            counters: SessionCounters::default(),
            status: Mutex::new(status),
        }
    }

    /// What it tells about itself.
    pub fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
