//! `EventLog`: selects the events of a session's frames that are logged: the begin and end of dropping, and targets found and
//! lost.
//!
//! Target events are limited to one line per second, with the number of suppressed ones.

use isophote_tracker::{Estimate, TrackState};

/// Dropping has ended after this time without a dropped frame.
const CALM_NS: u64 = 2_000_000_000;
/// Minimum time between lines about targets.
const QUIET_NS: u64 = 1_000_000_000;

/// One log line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// Frames begin to be dropped.
    DropsBegin,
    /// Dropping has ended, with the number of dropped frames.
    DropsEnd(u64),
    /// A target is tracked.
    Found { target: String, unsaid: u64 },
    /// A target is no longer tracked.
    Lost { target: String, unsaid: u64 },
}

/// State of the log filter of one session.
#[derive(Debug, Default)]
pub struct EventLog {
    /// Frames dropped since dropping began, and the time of the last.
    dropping: Option<(u64, u64)>,
    /// Whether each target is tracked.
    is_followed: Vec<bool>,
    /// Time of the last line about a target.
    said_ns: Option<u64>,
    unsaid: u64,
}

impl EventLog {
    /// Events of a frame that was fitted at `now_ns`, after `lost` dropped ones.
    pub fn frame(&mut self, now_ns: u64, lost: u64, estimates: &[Estimate]) -> Vec<Remark> {
        let mut remarks = Vec::new();
        remarks.extend(self.drops(now_ns, lost));
        self.is_followed.resize(estimates.len(), false);
        for (number, estimate) in estimates.iter().enumerate() {
            // An unfinished fit decides nothing.
            if !estimate.ending.is_unfinished() {
                remarks.extend(self.target(now_ns, number, &estimate.target, estimate.state));
            }
        }
        remarks
    }

    fn drops(&mut self, now_ns: u64, lost: u64) -> Option<Remark> {
        match (&mut self.dropping, lost) {
            (None, 0) => None,
            (None, _) => {
                self.dropping = Some((lost, now_ns));
                Some(Remark::DropsBegin)
            }
            (Some((total, last_ns)), 0) => {
                let ended = (now_ns.saturating_sub(*last_ns) > CALM_NS).then_some(Remark::DropsEnd(*total));
                self.dropping.take_if(|_| ended.is_some());
                ended
            }
            (Some((total, last_ns)), _) => {
                (*total, *last_ns) = (*total + lost, now_ns);
                None
            }
        }
    }

    fn target(&mut self, now_ns: u64, number: usize, name: &str, state: TrackState) -> Option<Remark> {
        let is_followed = matches!(state, TrackState::Tracking | TrackState::Coasting);
        if self.is_followed[number] == is_followed {
            return None;
        }
        if self.said_ns.is_some_and(|said_ns| now_ns.saturating_sub(said_ns) < QUIET_NS) {
            self.unsaid += 1; // retried with the next frame
            return None;
        }
        self.is_followed[number] = is_followed;
        self.said_ns = Some(now_ns);
        let (target, unsaid) = (name.to_string(), std::mem::take(&mut self.unsaid));
        Some(if is_followed { Remark::Found { target, unsaid } } else { Remark::Lost { target, unsaid } })
    }
}

impl Remark {
    /// Writes the line.
    pub fn say(&self, session: &str, frame: u64) {
        match self {
            Remark::DropsBegin => tracing::warn!(session, frame, "frames are dropped: fits take longer than a frame"),
            Remark::DropsEnd(dropped) => tracing::info!(session, frame, dropped, "no more frames are dropped"),
            Remark::Found { target, unsaid } => tracing::info!(session, frame, target, unsaid, "target found"),
            Remark::Lost { target, unsaid } => tracing::info!(session, frame, target, unsaid, "target lost"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_NS: u64 = 10_000_000;

    fn drops(lost: impl Iterator<Item = u64>) -> Vec<(usize, Remark)> {
        let mut event_log = EventLog::default();
        let frames = lost.enumerate();
        frames.flat_map(|(n, lost)| event_log.drops(n as u64 * FRAME_NS, lost).map(|remark| (n, remark))).collect()
    }

    #[test]
    fn dropping_is_logged_once_at_begin_and_end() {
        assert_eq!(drops([0; 500].into_iter()), []);
        let lost = (0..700).map(|n| if (100..200).contains(&n) { 3 } else { 0 });
        assert_eq!(drops(lost), [(100, Remark::DropsBegin), (400, Remark::DropsEnd(300))]);
    }

    #[test]
    fn flickering_target_is_logged_once_a_second() {
        let mut event_log = EventLog { is_followed: vec![false], ..EventLog::default() };
        let mut said = Vec::new();
        for n in 0..300u64 {
            let state = if n % 2 == 0 { TrackState::Tracking } else { TrackState::Lost };
            said.extend(event_log.target(n * FRAME_NS, 0, "0", state));
        }
        let target = || "0".to_string();
        assert_eq!(said[0], Remark::Found { target: target(), unsaid: 0 });
        assert_eq!(said.len(), 3);
        assert!(matches!(said[1], Remark::Lost { unsaid, .. } if unsaid > 10), "{said:?}");
    }
}
