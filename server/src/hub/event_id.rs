//! `EventId`: the position of a reader of server-sent events, which it sends as `Last-Event-ID` when it reconnects.
//!
//! It is opaque to the reader. `1234@6f0e12ab.3` is the frame and the session's life that numbered it (the beginning of the
//! node's id, and the epoch), once the reader has the estimates of all targets of that frame. Before that it is
//! `1234:5:1233@6f0e12ab.3`: 5 is the last target it has of frame 1234, and of later targets it has frame 1233. A frame alone
//! is of the session that runs.

use std::fmt::{Display, Formatter, Result};
use std::str::FromStr;

use isophote_wire::EstimateView;

/// Position of a reader in a session's estimates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EventId {
    /// The newest frame that the reader has.
    pub frame: u64,
    /// If that frame is incomplete: the last target it has of it, and the frame it has of later targets.
    pub partial: Option<(String, u64)>,
    /// The session's life; the present one if absent.
    pub life: Option<String>,
}

/// Characters of a node's id: enough to distinguish nodes behind one address.
const NODE_CHARACTERS: usize = 8;

/// The life of the session that made an estimate.
pub fn life(estimate: &EstimateView) -> String {
    let node: String = estimate.node.iter().flat_map(|node| node.chars()).take(NODE_CHARACTERS).collect();
    format!("{node}.{}", estimate.epoch.unwrap_or(0))
}

impl EventId {
    /// The newest frame that the reader has of a target.
    pub fn had(&self, target: &str) -> u64 {
        // Target ids are numbers, sent in ascending order.
        match &self.partial {
            Some((last, before)) if (target.len(), target) > (last.len(), last.as_str()) => *before,
            _ => self.frame,
        }
    }
}

impl Display for EventId {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write!(f, "{}", self.frame)?;
        if let Some((target, before)) = &self.partial {
            write!(f, ":{target}:{before}")?;
        }
        self.life.iter().try_for_each(|life| write!(f, "@{life}"))
    }
}

impl FromStr for EventId {
    type Err = ();

    fn from_str(text: &str) -> std::result::Result<EventId, ()> {
        let (place, life) = text.split_once('@').map_or((text, None), |(place, life)| (place, Some(life.to_string())));
        let number = |text: &str| text.parse().map_err(|_| ());
        let parts: Vec<&str> = place.split(':').collect();
        match parts[..] {
            [frame] => Ok(EventId { frame: number(frame)?, partial: None, life }),
            [frame, target, before] => {
                let partial = Some((target.to_string(), number(before)?));
                Ok(EventId { frame: number(frame)?, partial, life })
            }
            _ => Err(()),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn ids_round_trip() {
        for text in ["1234@6f0e12ab.3", "1234:5:1233@6f0e12ab.3", "7@.0", "2413"] {
            assert_eq!(text.parse::<EventId>().unwrap().to_string(), text);
        }
        for text in ["", "@6f0e12ab.3", "frame", "-1", "1:2", "1:2:x@a", "1:2:3:4"] {
            assert!(text.parse::<EventId>().is_err(), "{text}");
        }
    }

    #[test]
    fn an_id_within_a_frame_distinguishes_its_targets() {
        let id: EventId = "12:9:10@n.1".parse().unwrap();
        assert_eq!(["0", "9", "10", "63"].map(|target| id.had(target)), [12, 12, 10, 10]);
    }
}
