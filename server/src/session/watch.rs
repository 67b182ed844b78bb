//! `FrameWatch`: for how long a frame is worked at.
//!
//! What comes in: the bounds of the session's source, and what waits in its inbox. What goes out: go on, or why not. What a fit
//! may cost is counted in the time of its own thread: where the machine is too busy, frames are left out and those that are
//! fitted are fitted to the end.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use isophote_machine::{monotonic_ns, thread_ns};
use isophote_tracker::{Stop, Watch};
use isophote_wire::{LoggedStop, StopReason};

use super::inbox::{Inbox, Waiting};
use super::searches::{SearchPlace, SearchRoom};
use crate::hub::Hub;
use crate::limits::LIMITS;

/// For how long a session works at a frame of a source whose frames do not wait.
pub struct FrameTimes {
    /// Around a prediction.
    pub fit: Duration,
    /// Where the whole frame is searched.
    pub search: Duration,
}

impl FrameTimes {
    /// Before anything was searched for.
    pub fn of(fit: Duration) -> FrameTimes {
        FrameTimes { fit, search: LIMITS.search_time }
    }

    /// After a frame: a search that was cut short begins anew with more time; one that was not, as all did.
    pub fn follow(&mut self, outcome: &FrameUse) {
        match (outcome.has_searched, outcome.is_over) {
            (true, true) => self.search = (2 * self.search).min(LIMITS.frame_time),
            (true, false) => self.search = LIMITS.search_time,
            (false, _) => {}
        }
    }
}

/// What became of a frame's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameUse {
    /// The whole frame was searched.
    pub has_searched: bool,
    /// A search was put off.
    pub is_postponed: bool,
    /// The time was used up.
    pub is_over: bool,
}

/// One frame's.
pub struct FrameWatch<'a> {
    session: &'a str,
    inbox: &'a Inbox,
    room: &'a Arc<SearchRoom>,
    /// Absent where frames wait for their fits.
    times: Option<&'a FrameTimes>,
    start_ns: u64,
    worked_ns: u64,
    /// Since the whole frame is searched, with what had been worked then.
    search: OnceLock<(SearchPlace, u64)>,
    is_over: AtomicBool,
    /// So many searches were.
    postponed: AtomicU32,
    /// How often was asked.
    asked: AtomicU64,
    /// What was answered, when it was no.
    stopped: OnceLock<LoggedStop>,
    is_traced: bool,
}

impl<'a> FrameWatch<'a> {
    /// From now on; on the thread that fits.
    pub fn begin(
        session: &'a str,
        inbox: &'a Inbox,
        room: &'a Arc<SearchRoom>,
        times: Option<&'a FrameTimes>,
    ) -> FrameWatch<'a> {
        FrameWatch {
            session,
            inbox,
            room,
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

    /// The steps of its fits are kept where somebody wants them.
    pub fn traced_for(self, hub: &Hub) -> FrameWatch<'a> {
        FrameWatch { is_traced: hub.is_traced(), ..self }
    }

    /// When it began.
    pub fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// When all is done.
    pub fn outcome(&self) -> FrameUse {
        FrameUse {
            has_searched: self.search.get().is_some(),
            is_postponed: self.postponed() > 0,
            is_over: self.is_over.load(Ordering::Relaxed),
        }
    }

    /// How often a search was put off.
    pub fn postponed(&self) -> u32 {
        self.postponed.load(Ordering::Relaxed)
    }

    /// Where the frame was left before all was done.
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
        let Some(place) = self.room.enter(self.session, monotonic_ns()) else {
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
