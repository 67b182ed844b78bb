//! The thread of a shadow: frames that its session has fitted in, both estimates side by side out. It steps aside for everything,
//! and no fit of it is waited for.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isophote_machine::{monotonic_ns, thread_ns};
use isophote_tracker::{Disagreement, Ending, Estimate, Frame, Stop, Tracker, Viewer, Watch};
use isophote_wire::{EstimateView, ShadowEstimate};

use super::ShadowShared;
use super::slot::{FittedPair, ShadowTask};
use crate::hub::End;
use crate::limits::LIMITS;
use crate::preview::FittedScene;
use crate::session::beside::PreparationThread;
use crate::session::searches::SearchRoom;
use crate::session::start::SessionStart;
use crate::session::swap::Active;
use crate::session::told::Teller;
use crate::source::Source;
use crate::thread::step_aside;

/// So much nicer than fits.
const NICER: i32 = 10;

/// What the thread owns.
pub struct ShadowFitter {
    /// Its session's name.
    pub session: String,
    /// Which start of it this is.
    pub run: SessionStart,
    /// What the rest of the service sees of it.
    pub shared: Arc<ShadowShared>,
    /// Where the frames come from.
    pub source: Arc<Source>,
    /// Places for searches, which are the sessions'.
    pub room: Arc<SearchRoom>,
    /// The solver with its state.
    pub tracker: Tracker,
    /// Its model.
    pub active: Active,
    /// Prepares what frames were fitted without.
    pub beside: PreparationThread,
    /// How often the source had gone on elsewhere.
    pub jumps: Option<u64>,
    /// Shows what `tracker` says, as soon as somebody looks.
    pub viewer: Option<Arc<Viewer>>,
}

impl ShadowFitter {
    /// Until its slot is closed.
    pub fn run(mut self) {
        step_aside(NICER);
        let _guard = EndGuard(self.shared.clone(), self.session.clone());
        loop {
            match self.shared.slot.next() {
                ShadowTask::Frame(pair) => self.fit(&pair),
                ShadowTask::Tracker(reply) => drop(reply.try_send(self.tracker.fork())), // whoever asked may have gone
                ShadowTask::End => break,
            }
        }
    }

    fn fit(&mut self, pair: &FittedPair) {
        let frame = &pair.delivery.captured.frame;
        if self.jumps.replace(pair.delivery.jumps).is_some_and(|jumps| jumps != pair.delivery.jumps) {
            self.tracker.lose();
        }
        let watch = ShadowWatch::begin(&self.shared, &self.room, self.source.frame_budget());
        let (start_ns, worked_ns) = (monotonic_ns(), thread_ns());
        let results = self.tracker.track_all_while(frame, &watch);
        let end_ns = monotonic_ns();
        let [is_over, has_searched] = [&watch.is_over, &watch.has_searched].map(|flag| flag.load(Ordering::Relaxed));
        if results.iter().any(|result| result.ending == Ending::Cancelled) {
            return; // nobody asked for half a fit
        }
        if let Some(preparation) = self.tracker.wanted() {
            self.beside.prepare(&self.session, preparation);
        }
        let teller = Teller { session: &self.session, run: &self.run, active: &self.active };
        for ((own, shadow), told) in pair.results.iter().zip(&results).zip(pair.estimates.iter()) {
            let disagreement = Disagreement::between((&pair.model, own), (&self.active.model, shadow));
            let estimate = teller.estimate(&pair.delivery, shadow, [start_ns, end_ns]);
            let beside = ShadowEstimate { estimate: Box::new(estimate), disagreement };
            let both = EstimateView { shadow: Some(beside), ..EstimateView::clone(told) };
            self.shared.hub.publish(Arc::new(both));
        }
        let worked_ns = thread_ns().saturating_sub(worked_ns);
        self.shared.preview.has_frame(frame.sequence);
        if self.shared.preview.is_wanted() {
            let told = |result| Arc::new(teller.estimate(&pair.delivery, result, [start_ns, end_ns]));
            let views = results.iter().map(told).collect();
            self.show(frame, results, views);
        }
        let mut status = self.shared.status();
        status.frames += 1;
        status.over_budget += u64::from(is_over);
        status.since_frame.get_or_insert(frame.sequence);
        if !has_searched {
            status.cost(worked_ns);
        }
    }

    /// Hands a frame to those who look, with what the shadow says of it.
    fn show(&mut self, frame: &Frame, estimates: Vec<Estimate>, views: Vec<Arc<EstimateView>>) {
        let viewer = self.viewer.get_or_insert_with(|| Arc::new(self.tracker.viewer())).clone();
        let (frame, session, epoch) = (frame.clone(), self.session.clone(), self.run.epoch);
        let (estimates, views) = (estimates.into(), views.into());
        self.shared.preview.show(FittedScene { frame, estimates, views, viewer, session, epoch });
    }
}

/// For how long a frame is worked at. A search of the whole frame takes the time that sessions leave.
struct ShadowWatch<'a> {
    shared: &'a ShadowShared,
    room: &'a SearchRoom,
    /// `None` where frames wait for their fits.
    budget: Option<Duration>,
    begin_ns: u64,
    has_searched: AtomicBool,
    is_over: AtomicBool,
}

impl<'a> ShadowWatch<'a> {
    fn begin(shared: &'a ShadowShared, room: &'a SearchRoom, budget: Option<Duration>) -> ShadowWatch<'a> {
        let (has_searched, is_over) = (AtomicBool::new(false), AtomicBool::new(false));
        ShadowWatch { shared, room, budget, begin_ns: thread_ns(), has_searched, is_over }
    }
}

impl Watch for ShadowWatch<'_> {
    fn stop(&self) -> Option<Stop> {
        if self.shared.slot.is_awaited() {
            return Some(Stop::Cancelled);
        }
        let is_search = self.has_searched.load(Ordering::Relaxed);
        let most = match self.budget {
            Some(fit) if !is_search => fit,
            // A search that takes so long is given up, and begins anew with the next frame.
            Some(_) => LIMITS.settle_time,
            None => LIMITS.frame_time,
        };
        let spent = Duration::from_nanos(thread_ns().saturating_sub(self.begin_ns));
        let gives_way = is_search && self.budget.is_some() && self.room.is_crowded(monotonic_ns());
        if spent > most || gives_way {
            self.is_over.store(true, Ordering::Relaxed);
            return Some(Stop::Budget);
        }
        None
    }

    fn search(&self) -> Option<Stop> {
        if self.budget.is_some() && self.room.is_crowded(monotonic_ns()) {
            return Some(Stop::Postponed);
        }
        self.has_searched.store(true, Ordering::Relaxed);
        None
    }
}

/// Says what happened when the thread panics; the session goes on.
struct EndGuard(Arc<ShadowShared>, String);

impl Drop for EndGuard {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return;
        }
        let reason = "bug: the shadow's thread panicked; the session goes on".to_string();
        tracing::error!(session = self.1, reason, "shadow failed");
        self.0.status().failed = Some(reason.clone());
        self.0.slot.close();
        self.0.hub.end(End::SessionFailed(reason));
    }
}
