//! Builds a session's published estimates from the tracker's results.

use isophote_wire::{EstimateView, Named, Timing};

use super::inbox::Delivery;
use super::start::SessionStart;
use super::swap::Active;

/// The session and model that an estimate names.
#[derive(Clone, Copy)]
pub struct Publisher<'a> {
    /// The session's name.
    pub session: &'a str,
    /// The current start of the session.
    pub run: &'a SessionStart,
    /// The fitted model.
    pub active: &'a Active,
}

impl Publisher<'_> {
    /// The estimate of one target, with the begin and end of the fit, CLOCK_MONOTONIC.
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
        // Negative if a driver's timestamp is ahead of the clock.
        let wait = Some((start_ns as i64 - capture_ns as i64) / 1000);
        let fit = end_ns.saturating_sub(start_ns) / 1000;
        estimate.timing_us = Some(Timing { wait, fit });
        estimate
    }
}
