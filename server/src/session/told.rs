//! What a fit of a session says, as it is published: the tracker's result with what only the session knows.

use isophote_wire::{EstimateView, Named, Timing};

use super::inbox::Delivery;
use super::start::SessionStart;
use super::swap::Active;

/// Who says it.
#[derive(Clone, Copy)]
pub struct Teller<'a> {
    /// The session's name.
    pub session: &'a str,
    /// Which start of it.
    pub run: &'a SessionStart,
    /// The model that was fitted.
    pub active: &'a Active,
}

impl Teller<'_> {
    /// Of one target; the fit lasted from the one time to the other, CLOCK_MONOTONIC.
    pub fn estimate(
        &self,
        delivery: &Delivery,
        result: &isophote_tracker::Estimate,
        [start_ns, end_ns]: [u64; 2],
    ) -> EstimateView {
        let captured = &delivery.captured;
        let frame = &captured.frame;
        let mut estimate = EstimateView::new(&self.active.model, &self.active.id, frame.sequence, result);
        estimate.session = Some(self.session.to_string());
        (estimate.node, estimate.epoch) = (Some(self.run.node.to_string()), Some(self.run.epoch));
        estimate.file = captured.file.clone();
        let capture_ns = delivery.at_ns();
        estimate.capture_ns = Some(capture_ns);
        estimate.capture_unix_ns = delivery.capture_unix_ns;
        estimate.time_s = frame.time_s;
        estimate.publish_ns = Some(end_ns);
        estimate.truth =
            captured.truth.as_ref().map(|truth| truth.iter().map(|(n, v)| (n.as_str(), *v)).collect::<Named>());
        // Below 0 where a driver's stamp lies ahead of the clock.
        let wait = Some((start_ns as i64 - capture_ns as i64) / 1000);
        let fit = end_ns.saturating_sub(start_ns) / 1000;
        estimate.timing_us = Some(Timing { wait, fit });
        estimate
    }
}
