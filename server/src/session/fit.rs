//! The fit thread: fits frames, and swaps models between two frames. A fit over its budget ends with the best values so far; a
//! fit is cancelled when the session is stopped or a swap has waited for `LIMITS.swap_time`.

use std::sync::{Arc, PoisonError};

use isophote_machine::{monotonic_ns, thread_ns};
use isophote_tracker::{Ending, Estimate, Frame, Tracker, Viewer};
use isophote_wire::{EstimateView, SessionState};

use super::beside::PreparationThread;
use super::event_log::EventLog;
use super::exposed::ExposureKnob;
use super::inbox::{Delivery, Event, FittedFrame, SampleFrame, SourceEnd, Waiting};
use super::publish::Publisher;
use super::recorder::{FitCourse, FitRecorder, Takeover};
use super::searches::SearchQuota;
use super::shadow::FittedPair;
use super::shared::Shared;
use super::start::SessionStart;
use super::swap::{Active, Swap, Swapped};
use super::watch::{FrameTimes, FrameWatch};
use crate::hub::End;
use crate::preview::FittedScene;
use crate::source::Source;

/// The last fitted frame.
pub struct LastFit {
    delivery: Arc<Delivery>,
    /// The active model's results in it; `None` if another model fitted it.
    found: Option<FoundTargets>,
}

/// Results of a frame: the tracker's estimates, and their published views.
type FoundTargets = (Arc<[Estimate]>, Arc<[Arc<EstimateView>]>);

/// State owned by the fit thread.
pub struct Fitter {
    /// The session's name.
    pub name: String,
    /// The current start of the session.
    pub run: SessionStart,
    /// State shared with the rest of the service.
    pub shared: Arc<Shared>,
    /// The source of its frames.
    pub source: Arc<Source>,
    /// Limits whole-frame searches.
    pub quota: Arc<SearchQuota>,
    /// Time limits of a frame, if frames do not wait for their fits.
    pub times: Option<FrameTimes>,
    /// The solver with its state.
    pub tracker: Tracker,
    /// The model in `tracker`: both change together, only here.
    pub active: Active,
    /// Sets the source's exposure, if the session asks for it.
    pub knob: Option<ExposureKnob>,
    /// Prepares data that the fits lacked.
    pub beside: PreparationThread,
    /// Draws the results of `tracker`; created when somebody looks.
    pub viewer: Option<Arc<Viewer>>,
    /// The last frame, unless its buffer is lent.
    pub last: Option<LastFit>,
    /// The number after the last fitted frame.
    pub next_frame: Option<u64>,
    /// The source's jump count at the last fitted frame.
    pub jumps: Option<u64>,
    /// Decides which frames are logged.
    pub event_log: EventLog,
    /// Sends notes to a recording.
    pub recorder: FitRecorder,
}

impl Fitter {
    /// Runs until the inbox is closed.
    pub fn run(mut self) {
        let _guard = EndGuard(self.shared.clone());
        loop {
            match self.shared.inbox.next() {
                Event::Swap(swap) => self.swap(*swap),
                Event::Frame(delivery) => self.fit(&delivery),
                Event::SourceEnded(end) => self.source_ended(end),
                Event::Look => self.look(),
                Event::Closed => break,
            }
        }
    }

    fn swap(&mut self, swap: Swap) {
        let takeover = if swap.warm.is_some() { Takeover::Warm } else { Takeover::Swapped };
        let carried = match swap.warm {
            Some(tracker) => {
                self.tracker = *tracker;
                swap.carried
            }
            None => self.tracker.swap(swap.compiled, swap.options),
        };
        self.shared.hub.keep(&self.tracker.names());
        self.beside.give_up();
        (self.active, self.viewer) = (swap.active, None);
        if let Some(last) = &mut self.last {
            last.found = None;
        }
        self.shared.counters.swaps.add(1);
        let active_since_frame = self.next_frame.unwrap_or(0);
        let taken = (active_since_frame, takeover);
        self.recorder.swapped(&self.shared.inbox, &self.tracker, &self.active, taken);
        let (session, model) = (self.name.as_str(), self.active.id.as_ref());
        tracing::info!(session, frame = active_since_frame, model, "model swapped");
        {
            let mut status = self.shared.status();
            status.active = self.active.clone();
            status.active_since_frame = active_since_frame;
        }
        let swapped = Swapped { active_since_frame, carried: carried.carried, reset: carried.reset };
        drop(swap.reply.send(swapped)); // the client may have gone
    }

    fn fit(&mut self, delivery: &Arc<Delivery>) {
        let frame = &delivery.captured.frame;
        let worked_ns = thread_ns();
        // A reconnected camera may have another rate.
        if let (Some(times), Some(budget)) = (&mut self.times, self.source.frame_budget()) {
            times.fit = budget;
        }
        let inbox = &self.shared.inbox;
        self.recorder.before(inbox, delivery, &self.tracker, &self.active);
        let jump = self.jumps.replace(delivery.jumps).filter(|jumps| *jumps != delivery.jumps);
        if jump.is_some() {
            self.tracker.lose();
        }
        let watch = FrameWatch::begin(&self.name, inbox, &self.quota, self.times.as_ref());
        let watch = watch.traced_for(&self.shared.hub);
        let results: Arc<[Estimate]> = self.tracker.track_all_while(frame, &watch).into();
        let (start_ns, end_ns, outcome) = (watch.start_ns(), monotonic_ns(), watch.outcome());
        let course = FitCourse::of(delivery, jump, &self.tracker, &watch);
        drop(watch);
        if let Some(times) = &mut self.times {
            times.follow(&outcome);
        }
        if inbox.waiting() == Waiting::End && results.iter().any(|result| result.ending == Ending::Cancelled) {
            return; // an incomplete fit is not published
        }
        if let Some(preparation) = self.tracker.wanted() {
            self.beside.prepare(&self.name, preparation);
        }
        if let (Some(knob), Some(first)) = (&mut self.knob, results.first()) {
            let control = knob.follow(first);
            self.shared.status().control = Some(control);
        }
        let lost = self.next_frame.map_or(0, |next| frame.sequence.saturating_sub(next));
        self.next_frame = Some(frame.sequence + 1);
        self.shared.status().fitted(frame, end_ns, lost);
        let captured_ns = frame.capture_ns.unwrap_or(delivery.sent_ns);
        let (fit_ns, age_ns) = (end_ns.saturating_sub(start_ns), end_ns.saturating_sub(captured_ns));
        self.shared.counters.fitted(&results, fit_ns, age_ns, lost);
        for remark in self.event_log.frame(end_ns, lost, &results) {
            remark.say(&self.name, frame.sequence);
        }
        self.shared.status().spent(&outcome, self.times.as_ref());
        let teller = Publisher { session: &self.name, run: &self.run, active: &self.active };
        let told = results.iter().map(|result| Arc::new(teller.estimate(delivery, result, [start_ns, end_ns])));
        let estimates: Arc<[Arc<EstimateView>]> = told.collect();
        for (estimate, result) in estimates.iter().zip(results.iter()) {
            match self.shared.hub.is_traced() {
                true => self.shared.hub.publish_traced(estimate.clone(), &isophote_wire::trace(result)),
                false => self.shared.hub.publish(estimate.clone()),
            }
        }
        self.recorder.after(delivery, course, &estimates);
        if let Some(first) = estimates.first() {
            self.answer(delivery, first.clone());
        }
        self.shared.preview.has_frame(frame.sequence);
        let found = (results.clone(), estimates.clone());
        if self.shared.preview.is_wanted() {
            self.show(frame, found.clone());
        }
        self.last = (!frame.is_lent()).then(|| LastFit { delivery: delivery.clone(), found: Some(found) });
        self.hand_out(SampleFrame::Next, Some(delivery));
        if let Some(shadow) = self.shared.shadow() {
            let model = self.active.model.clone();
            shadow.offer(FittedPair { delivery: delivery.clone(), model, results, estimates }, lost);
        }
        if !outcome.has_searched {
            self.shared.status().cost(thread_ns().saturating_sub(worked_ns));
        }
    }

    /// Serves previews and samples from the last frame while no new one arrives.
    fn look(&mut self) {
        let last = self.last.as_ref().map(|last| (last.delivery.clone(), last.found.clone()));
        if let Some((delivery, Some(found))) = last.clone().filter(|_| self.shared.preview.is_wanted()) {
            self.show(&delivery.captured.frame, found);
        }
        self.hand_out(SampleFrame::Last, last.as_ref().map(|(delivery, _)| delivery));
    }

    /// Answers pending sample requests with a frame; without one, dropping the senders ends their wait.
    fn hand_out(&self, which: SampleFrame, delivery: Option<&Arc<Delivery>>) {
        for wanted in self.shared.inbox.take_samples(which) {
            if let Some(delivery) = delivery {
                let sample = FittedFrame { delivery: delivery.clone(), tracker: self.tracker.fork() };
                drop(wanted.try_send(sample)); // the requester may have gone
            }
        }
    }

    /// Hands a frame with its results to the preview's viewers, which draw it.
    fn show(&mut self, frame: &Frame, (estimates, views): FoundTargets) {
        let viewer = self.viewer.get_or_insert_with(|| Arc::new(self.tracker.viewer())).clone();
        let (frame, session, epoch) = (frame.clone(), self.name.clone(), self.run.epoch);
        self.shared.preview.show(FittedScene { frame, estimates, views, viewer, session, epoch });
    }

    /// Sends the estimate to the client that pushed the frame to this session.
    fn answer(&self, delivery: &Delivery, estimate: Arc<EstimateView>) {
        let mut reply = delivery.reply.lock().unwrap_or_else(PoisonError::into_inner);
        let is_ours = reply.as_ref().is_some_and(|reply| Arc::ptr_eq(&reply.session, &self.shared.inbox));
        if let (true, Some(reply)) = (is_ours, reply.take_if(|_| is_ours)) {
            drop(reply.sender.send(estimate)); // the client may have gone
        }
    }

    fn source_ended(&mut self, end: SourceEnd) {
        let (state, reason) = match end {
            SourceEnd::Finished(reason) => (SessionState::Stopped, reason),
            SourceEnd::Failed(reason) => (SessionState::LostSource, reason),
        };
        let (session, frame) = (self.name.as_str(), self.next_frame.unwrap_or(0));
        match state {
            SessionState::LostSource => tracing::warn!(session, frame, reason, "session has lost its source"),
            _ => tracing::info!(session, frame, reason, "session has no more frames"),
        }
        self.shared.status().end(state, reason.clone());
        self.shared.hub.end(End::SourceEnded(reason));
    }
}

/// Reports a panic of the thread.
struct EndGuard(Arc<Shared>);

impl Drop for EndGuard {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return;
        }
        let reason = "bug: the fit thread panicked".to_string();
        tracing::error!(
            session = std::thread::current().name().map(|name| name.trim_start_matches("fit ")),
            reason,
            "session failed"
        );
        self.0.status().end(SessionState::Failed, reason.clone());
        self.0.inbox.close();
        self.0.hub.end(End::SessionFailed(reason));
    }
}
