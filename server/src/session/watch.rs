//! `FrameWatch`: time limits of one frame's fit, by the budget of the session's source and the events waiting in its inbox.
//!
//! The budget counts the fit thread's processor time: on an overloaded machine frames are dropped, and those that are fitted
//! are fitted to the end.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use isophote_machine::{monotonic_ns, thread_ns};
use isophote_tracker::{Stop, Watch};
use isophote_wire::{LoggedStop, StopReason};

use super::inbox::{Inbox, Waiting};
use super::searches::{SearchPlace, SearchQuota};
use crate::hub::Hub;
use crate::limits::LIMITS;

/// Time limits of a frame, for a source whose frames do not wait for their fits.
pub struct FrameTimes {
    /// Of a fit around a prediction.
    pub fit: Duration,
    /// Of a search of the whole frame.
    pub search: Duration,
}

impl FrameTimes {
    /// The limits before the first search.
    pub fn of(fit: Duration) -> FrameTimes {
        FrameTimes { fit, search: LIMITS.search_time }
    }

    /// After a frame: doubles the search limit if the search was cut short, else resets it.
    pub fn follow(&mut self, outcome: &FrameUse) {
        match (outcome.has_searched, outcome.is_over) {
            (true, true) => self.search = (2 * self.search).min(LIMITS.frame_time),
            (true, false) => self.search = LIMITS.search_time,
            (false, _) => {}
        }
    }
}

/// How a frame's time was used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameUse {
    /// The whole frame was searched.
    pub has_searched: bool,
    /// A search was postponed.
    pub is_postponed: bool,
    /// A time limit was exceeded.
    pub is_over: bool,
}

/// The time limits of one frame.
pub struct FrameWatch<'a> {
    session: &'a str,
    inbox: &'a Inbox,
    quota: &'a Arc<SearchQuota>,
    /// `None` if frames wait for their fits.
    times: Option<&'a FrameTimes>,
    start_ns: u64,
    worked_ns: u64,
    /// The search's slot, and the thread's processor time at its begin.
    search: OnceLock<(SearchPlace, u64)>,
    is_over: AtomicBool,
    /// Number of postponed searches.
    postponed: AtomicU32,
    /// Number of calls of `stop`.
    asked: AtomicU64,
    /// The first answer that stopped the fit.
    stopped: OnceLock<LoggedStop>,
    is_traced: bool,
}

impl<'a> FrameWatch<'a> {
    /// Starts the clock; called on the fit thread.
    pub fn begin(
        session: &'a str,
        inbox: &'a Inbox,
        quota: &'a Arc<SearchQuota>,
        times: Option<&'a FrameTimes>,
    ) -> FrameWatch<'a> {
        FrameWatch {
            session,
            inbox,
            quota,
            times,
            start_ns: monotonic_ns(),
            worked_ns: thread_ns(),
            search: OnceLock::new(),
            is_over: AtomicBool::new(false),
            postponed: AtomicU32::new(0),
            asked: AtomicU64::new(0),
            stopped: OnceLock::new(),
            is_traced: false,
        }
    }

    /// Traces the fits' steps if a subscriber wants them.
    pub fn traced_for(self, hub: &Hub) -> FrameWatch<'a> {
        FrameWatch { is_traced: hub.is_traced(), ..self }
    }

    /// Begin of the fit, CLOCK_MONOTONIC.
    pub fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// How the time was used, after the fit.
    pub fn outcome(&self) -> FrameUse {
        FrameUse {
            has_searched: self.search.get().is_some(),
            is_postponed: self.postponed() > 0,
            is_over: self.is_over.load(Ordering::Relaxed),
        }
    }

    /// How often a search was postponed.
    pub fn postponed(&self) -> u32 {
        self.postponed.load(Ordering::Relaxed)
    }

    /// Where the fit was stopped, if it was.
    pub fn stopped(&self) -> Option<LoggedStop> {
        self.stopped.get().copied()
    }

    fn is_used_up(&self, spent: Duration) -> bool {
        let Some(times) = self.times else { return spent > LIMITS.frame_time };
        let (from_ns, most) = match self.search.get() {
            Some((_, from_ns)) => (*from_ns, times.search),
            None => (self.worked_ns, times.fit),
        };
        Duration::from_nanos(thread_ns().saturating_sub(from_ns)) > most
    }
}

impl Watch for FrameWatch<'_> {
    fn is_traced(&self) -> bool {
        self.is_traced
    }

    fn stop(&self) -> Option<Stop> {
        let pass = self.asked.fetch_add(1, Ordering::Relaxed);
        let stop = self.verdict()?;
        let why = if stop == Stop::Budget { StopReason::Budget } else { StopReason::Cancelled };
        self.stopped.get_or_init(|| LoggedStop { pass, why });
        Some(stop)
    }

    fn search(&self) -> Option<Stop> {
        if self.times.is_none() || self.search.get().is_some() {
            return None;
        }
        let Some(place) = self.quota.enter(self.session, monotonic_ns()) else {
            self.postponed.fetch_add(1, Ordering::Relaxed);
            return Some(Stop::Postponed);
        };
        self.search.get_or_init(|| (place, thread_ns()));
        None
    }
}

impl FrameWatch<'_> {
    fn verdict(&self) -> Option<Stop> {
        let spent = Duration::from_nanos(monotonic_ns().saturating_sub(self.start_ns));
        match self.inbox.waiting() {
            Waiting::End => Some(Stop::Cancelled),
            Waiting::Swap if spent > LIMITS.swap_time => Some(Stop::Cancelled),
            Waiting::Swap | Waiting::Nothing if self.is_used_up(spent) => {
                self.is_over.store(true, Ordering::Relaxed);
                Some(Stop::Budget)
            }
            Waiting::Swap | Waiting::Nothing => None,
        }
    }
}
