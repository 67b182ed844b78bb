//! `EventId`: which estimates a reader of server-sent events has had, as it tells when it comes back.
//!
//! To the reader it is opaque. It is `1234@6f0e12ab.3`, the frame and the life of the session that numbered it (the beginning of the
//! node's id, and the epoch), once the reader has that frame's estimates of all targets; before that it is
//! `1234:5:1233@6f0e12ab.3`, with the last target that it has of this frame, and the frame that it has of those after it. A frame
//! alone is read as one of the session that runs.

use std::fmt::{Display, Formatter, Result};
use std::str::FromStr;

use isophote_wire::EstimateView;

/// See above.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EventId {
    /// The newest frame that the reader has had.
    pub frame: u64,
    /// Of which it has had no further targets than that one; of the others it has had that frame.
    pub partial: Option<(String, u64)>,
    /// Of the session; as it runs now where that is not said.
    pub life: Option<String>,
}

/// Characters of a node's id: enough that no two nodes behind one address have the same.
const NODE_CHARACTERS: usize = 8;

/// The life of the session that made an estimate.
pub fn life(estimate: &EstimateView) -> String {
    let node: String = estimate.node.iter().flat_map(|node| node.chars()).take(NODE_CHARACTERS).collect();
    format!("{node}.{}", estimate.epoch.unwrap_or(0))
}

impl EventId {
    /// The newest frame of a target that the reader has had.
    pub fn had(&self, target: &str) -> u64 {
        // Targets are numbered, and told in their order.
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
    fn ids_are_read_as_they_are_written() {
        for text in ["1234@6f0e12ab.3", "1234:5:1233@6f0e12ab.3", "7@.0", "2413"] {
            assert_eq!(text.parse::<EventId>().unwrap().to_string(), text);
        }
        for text in ["", "@6f0e12ab.3", "frame", "-1", "1:2", "1:2:x@a", "1:2:3:4"] {
            assert!(text.parse::<EventId>().is_err(), "{text}");
        }
    }

    #[test]
    fn an_id_in_the_middle_of_a_frame_knows_which_targets_were_had() {
        let id: EventId = "12:9:10@n.1".parse().unwrap();
        assert_eq!(["0", "9", "10", "63"].map(|target| id.had(target)), [12, 12, 10, 10]);
    }
}
