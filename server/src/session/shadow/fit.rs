//! The thread of a shadow: fits the frames that its session has fitted and publishes both estimates side by side. It runs at
//! low priority, and nobody waits for its fits.

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
use crate::session::publish::Publisher;
use crate::session::searches::SearchQuota;
use crate::session::start::SessionStart;
use crate::session::swap::Active;
use crate::source::Source;
use crate::thread::step_aside;

/// Added to the thread's nice value.
const NICER: i32 = 10;

/// State owned by the thread.
pub struct ShadowFitter {
    /// The session's name.
    pub session: String,
    /// The current start of the session.
    pub run: SessionStart,
    /// State shared with the rest of the service.
    pub shared: Arc<ShadowShared>,
    /// The source of the frames.
    pub source: Arc<Source>,
    /// The sessions' limit of whole-frame searches.
    pub quota: Arc<SearchQuota>,
    /// The solver with its state.
    pub tracker: Tracker,
    /// Its model.
    pub active: Active,
    /// Prepares data that the fits lacked.
    pub beside: PreparationThread,
    /// The source's jump count at the last frame.
    pub jumps: Option<u64>,
    /// Draws the results of `tracker`; created when somebody looks.
    pub viewer: Option<Arc<Viewer>>,
}

impl ShadowFitter {
    /// Runs until its slot is closed.
    pub fn run(mut self) {
        step_aside(NICER);
        let _guard = EndGuard(self.shared.clone(), self.session.clone());
        loop {
            match self.shared.slot.next() {
                ShadowTask::Frame(pair) => self.fit(&pair),
                ShadowTask::Tracker(reply) => drop(reply.try_send(self.tracker.fork())), // the requester may have gone
                ShadowTask::End => break,
            }
        }
    }

    fn fit(&mut self, pair: &FittedPair) {
        let frame = &pair.delivery.captured.frame;
        if self.jumps.replace(pair.delivery.jumps).is_some_and(|jumps| jumps != pair.delivery.jumps) {
            self.tracker.lose();
        }
        let watch = ShadowWatch::begin(&self.shared, &self.quota, self.source.frame_budget());
        let (start_ns, worked_ns) = (monotonic_ns(), thread_ns());
        let results = self.tracker.track_all_while(frame, &watch);
        let end_ns = monotonic_ns();
        let [is_over, has_searched] = [&watch.is_over, &watch.has_searched].map(|flag| flag.load(Ordering::Relaxed));
        if results.iter().any(|result| result.ending == Ending::Cancelled) {
            return; // an incomplete fit is not published
        }
        if let Some(preparation) = self.tracker.wanted() {
            self.beside.prepare(&self.session, preparation);
        }
        let teller = Publisher { session: &self.session, run: &self.run, active: &self.active };
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

    /// Hands a frame with the shadow's results to the preview's viewers.
    fn show(&mut self, frame: &Frame, estimates: Vec<Estimate>, views: Vec<Arc<EstimateView>>) {
        let viewer = self.viewer.get_or_insert_with(|| Arc::new(self.tracker.viewer())).clone();
        let (frame, session, epoch) = (frame.clone(), self.session.clone(), self.run.epoch);
        let (estimates, views) = (estimates.into(), views.into());
        self.shared.preview.show(FittedScene { frame, estimates, views, viewer, session, epoch });
    }
}

/// Time limits of a frame. A search of the whole frame yields to searches of sessions.
struct ShadowWatch<'a> {
    shared: &'a ShadowShared,
    quota: &'a SearchQuota,
    /// `None` if frames wait for their fits.
    budget: Option<Duration>,
    begin_ns: u64,
    has_searched: AtomicBool,
    is_over: AtomicBool,
}

impl<'a> ShadowWatch<'a> {
    fn begin(shared: &'a ShadowShared, quota: &'a SearchQuota, budget: Option<Duration>) -> ShadowWatch<'a> {
        let (has_searched, is_over) = (AtomicBool::new(false), AtomicBool::new(false));
        ShadowWatch { shared, quota, budget, begin_ns: thread_ns(), has_searched, is_over }
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
            // A search over this limit is given up and starts again with the next frame.
            Some(_) => LIMITS.settle_time,
            None => LIMITS.frame_time,
        };
        let spent = Duration::from_nanos(thread_ns().saturating_sub(self.begin_ns));
        let gives_way = is_search && self.budget.is_some() && self.quota.is_crowded(monotonic_ns());
        if spent > most || gives_way {
            self.is_over.store(true, Ordering::Relaxed);
            return Some(Stop::Budget);
        }
        None
    }

    fn search(&self) -> Option<Stop> {
        if self.budget.is_some() && self.quota.is_crowded(monotonic_ns()) {
            return Some(Stop::Postponed);
        }
        self.has_searched.store(true, Ordering::Relaxed);
        None
    }
}

/// Reports a panic of the thread; the session goes on.
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
