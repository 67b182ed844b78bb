//! `Chronicle`: what of a session's frames is worth a line of the log. A frame as such never is.
//!
//! What comes in: each frame's number, time, targets, and how many were lost before it. What goes out: the beginning and the end of
//! dropping, and targets that are found and lost. It says of a kind of thing one line a second at most, and how many it kept to itself.

use isophote_tracker::{Estimate, TrackState};

/// Without a lost frame for so long dropping has ended.
const CALM_NS: u64 = 2_000_000_000;
/// Between lines about targets.
const QUIET_NS: u64 = 1_000_000_000;

/// One line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// From now on frames are lost.
    DropsBegin,
    /// No more are; so many were.
    DropsEnd(u64),
    /// A target is followed.
    Found { target: String, unsaid: u64 },
    /// A target is not followed any more.
    Lost { target: String, unsaid: u64 },
}

/// What was said already.
#[derive(Debug, Default)]
pub struct Chronicle {
    /// Frames lost since dropping began, and when the last was.
    dropping: Option<(u64, u64)>,
    /// Whether each target is followed.
    is_followed: Vec<bool>,
    /// When a line about a target was written.
    said_ns: Option<u64>,
    unsaid: u64,
}

impl Chronicle {
    /// A frame that was fitted at `now_ns`, after `lost` that were not.
    pub fn frame(&mut self, now_ns: u64, lost: u64, estimates: &[Estimate]) -> Vec<Remark> {
        let mut remarks = Vec::new();
        remarks.extend(self.drops(now_ns, lost));
        self.is_followed.resize(estimates.len(), false);
        for (number, estimate) in estimates.iter().enumerate() {
            // A frame that was not looked at to the end says nothing.
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
            self.unsaid += 1; // and again with the next frame, if it stays so
            return None;
        }
        self.is_followed[number] = is_followed;
        self.said_ns = Some(now_ns);
        let (target, unsaid) = (name.to_string(), std::mem::take(&mut self.unsaid));
        Some(if is_followed { Remark::Found { target, unsaid } } else { Remark::Lost { target, unsaid } })
    }
}

impl Remark {
    /// Writes it.
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
        let mut chronicle = Chronicle::default();
        let frames = lost.enumerate();
        frames.flat_map(|(n, lost)| chronicle.drops(n as u64 * FRAME_NS, lost).map(|remark| (n, remark))).collect()
    }

    #[test]
    fn dropping_begins_once_and_ends_once() {
        assert_eq!(drops([0; 500].into_iter()), []);
        let lost = (0..700).map(|n| if (100..200).contains(&n) { 3 } else { 0 });
        assert_eq!(drops(lost), [(100, Remark::DropsBegin), (400, Remark::DropsEnd(300))]);
    }

    #[test]
    fn a_target_that_flickers_is_said_once_a_second() {
        let mut chronicle = Chronicle { is_followed: vec![false], ..Chronicle::default() };
        let mut said = Vec::new();
        for n in 0..300u64 {
            let state = if n % 2 == 0 { TrackState::Tracking } else { TrackState::Lost };
            said.extend(chronicle.target(n * FRAME_NS, 0, "0", state));
        }
        let target = || "0".to_string();
        assert_eq!(said[0], Remark::Found { target: target(), unsaid: 0 });
        assert_eq!(said.len(), 3);
        assert!(matches!(said[1], Remark::Lost { unsaid, .. } if unsaid > 10), "{said:?}");
    }
}
