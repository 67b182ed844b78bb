//! `Snapshot`: a tracker's complete state, to resume elsewhere or later. Any serde format restores it bit for bit.
//! Kernels and other data that follow from model and options are not in it.

use serde::{Deserialize, Serialize};

use super::clock::FrameClock;
use super::memory::Memory;
use super::solver::Solver;
use crate::exposure::Best;

/// The version of a snapshot's format and meaning; incremented with every change of either.
pub const SNAPSHOT_VERSION: u32 = 4;

/// A tracker's complete state: the memory of its targets, its clock, and exposure advice that still holds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Snapshot {
    version: u32,
    /// The model's digest.
    digest: String,
    targets: Vec<Memory>,
    clock: FrameClock,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    advice: Option<Vec<Option<Best>>>,
}

/// Why a tracker cannot resume from a snapshot.
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
    /// It is of another model.
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

/// The contents of a snapshot.
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

    /// The version of its format.
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
