//! `Snapshot`: all that a tracker remembers, to go on from elsewhere or later.
//!
//! What comes in: memories of targets, the clock, advice that still holds. What goes out: the same through whatever serde writes,
//! bit for bit. It never knows kernels: what follows from model and options is not in it.

use serde::{Deserialize, Serialize};

use super::clock::FrameClock;
use super::memory::Memory;
use super::solver::Solver;
use crate::exposure::Best;

/// Of what a snapshot says, and of what that means. It grows with every change of either.
pub const SNAPSHOT_VERSION: u32 = 3;

/// See the text above.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Snapshot {
    version: u32,
    /// Of the model.
    digest: String,
    targets: Vec<Memory>,
    clock: FrameClock,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    advice: Option<Vec<Option<Best>>>,
}

/// Why a tracker cannot go on from a snapshot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Another build wrote it.
    #[error(
        "the snapshot is of version {found}, this build reads version {SNAPSHOT_VERSION}: take the build that wrote it"
    )]
    Version {
        /// As written.
        found: u32,
    },
    /// Another model's memory says nothing to this one.
    #[error("the snapshot is of the model {found}, not of {wanted}")]
    Model {
        /// As written.
        found: String,
        /// The tracker's.
        wanted: String,
    },
    /// It was written with other options, or changed.
    #[error("the snapshot does not suit the tracker: {0}")]
    Unsuited(&'static str),
}

/// What a snapshot held.
pub(crate) struct Restored {
    pub targets: Vec<Memory>,
    pub clock: FrameClock,
    pub advice: Option<Vec<Option<Best>>>,
}

impl Snapshot {
    pub(crate) fn of(
        digest: &str,
        targets: Vec<Memory>,
        clock: FrameClock,
        advice: Option<Vec<Option<Best>>>,
    ) -> Snapshot {
        Snapshot { version: SNAPSHOT_VERSION, digest: digest.to_string(), targets, clock, advice }
    }

    /// Of its form.
    pub fn version(&self) -> u32 {
        self.version
    }

    pub(crate) fn open(self, solver: &Solver, targets: usize) -> Result<Restored, SnapshotError> {
        let wanted = solver.model().digest();
        if self.version != SNAPSHOT_VERSION {
            return Err(SnapshotError::Version { found: self.version });
        }
        if self.digest != wanted {
            return Err(SnapshotError::Model { found: self.digest, wanted: wanted.to_string() });
        }
        if self.targets.len() != targets {
            return Err(SnapshotError::Unsuited("it has another number of targets"));
        }
        if self.targets.iter().any(|memory| !memory.suits(solver)) {
            return Err(SnapshotError::Unsuited("it has another number of parameters"));
        }
        Ok(Restored { targets: self.targets, clock: self.clock, advice: self.advice })
    }
}
