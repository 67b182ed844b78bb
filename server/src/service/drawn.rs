//! Random events of the simulation, drawn from a seed.

#![allow(clippy::unwrap_used)]

use std::time::Duration;

use serde_json::{Value, json};

use super::simulation::{Books, WIDTH, source};
use crate::name::Name;
use crate::service::command::Command;
use crate::service::declared::Keeping;

/// Number of names of each kind, and of clients that prepare a model and put it later.
const NAMES: u64 = 3;
const CLIENTS: u64 = 4;

/// An event of the simulation.
#[derive(Clone, Debug)]
pub(super) enum SimulatedEvent {
    Asked(Command),
    /// A client has a document checked, whose only constant is `offset`.
    Prepared {
        client: u64,
        model: String,
        offset: u64,
    },
    /// The client puts the model that it prepared; `is_new`: with `If-None-Match: *`.
    Put {
        client: u64,
        is_new: bool,
    },
    /// A frame is pushed to a session's source.
    Frame {
        session: String,
    },
    FullDisk,
    EmptyDisk,
    /// A client takes or renews the lease of a source.
    Lease {
        client: u64,
        source: String,
        timeout: Duration,
    },
    /// The client releases it.
    Released {
        client: u64,
        source: String,
    },
    /// The clock advances.
    Waited(Duration),
    /// The process is killed.
    Killed,
}

/// Random numbers from a seed.
pub(super) struct Draws(pub u64);

impl Draws {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (bits ^ (bits >> 31)) % limit
    }

    fn called(&mut self, kind: &str) -> String {
        format!("{kind}{}", self.below(NAMES))
    }

    fn name(&mut self, kind: &str) -> Name {
        Name::parse(&self.called(kind)).unwrap()
    }

    pub(super) fn event(&mut self, books: &Books) -> SimulatedEvent {
        let command = match self.below(100) {
            0..13 => {
                let (client, model) = (self.below(CLIENTS), self.called("m"));
                return SimulatedEvent::Prepared { client, model, offset: self.below(50) };
            }
            13..26 => return SimulatedEvent::Put { client: self.below(CLIENTS), is_new: self.below(4) == 0 },
            26..31 => {
                let name = self.name("m");
                // One of the newest versions, which are kept.
                let last = books.models.get(name.as_str()).map_or(1, |(offsets, _)| offsets.len() as u64);
                Command::RollBackModel { name, version: last.saturating_sub(self.below(6)).max(1) }
            }
            31..37 => Command::RemoveModel { name: self.name("m") },
            37..46 => {
                let (name, document) = (self.name("c"), source(WIDTH + self.below(9) as usize).into());
                Command::PutSource { name, document, keeping: Keeping::Declared }
            }
            46..53 => Command::RemoveSource { name: self.name("c") },
            53..65 => {
                let (name, model) = (self.name("s"), self.called("m"));
                let named = (self.below(3) > 0).then(|| self.called("c"));
                let from = named.map_or_else(|| json!(source(WIDTH)), Value::from);
                let document = serde_json::from_value(json!({"source": from, "model": model})).unwrap();
                Command::PutSession { name, document, keeping: Keeping::Declared }
            }
            65..75 => Command::RemoveSession { name: self.name("s") },
            75..80 => Command::SwapModel { session: self.called("s"), model: self.called("m") },
            80..87 => return SimulatedEvent::Frame { session: self.called("s") },
            87..90 => {
                let (client, source) = (self.below(CLIENTS), self.called("c"));
                let timeout = Duration::from_millis(100 + self.below(10_000));
                return match self.below(4) {
                    0 => SimulatedEvent::Released { client, source },
                    _ => SimulatedEvent::Lease { client, source, timeout },
                };
            }
            90..92 => return SimulatedEvent::Waited(Duration::from_millis(self.below(5_000))),
            92..94 => return SimulatedEvent::FullDisk,
            _ if self.below(28) == 0 => return SimulatedEvent::Killed,
            _ => return SimulatedEvent::EmptyDisk,
        };
        SimulatedEvent::Asked(command)
    }
}
