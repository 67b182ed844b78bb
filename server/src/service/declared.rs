//! Declarations: sources and sessions with their pinned models, which run again after a restart.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_wire::{SessionDocument, SourceDocument};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::registry::Pin;
use crate::session::Session;
use crate::source::Source;
use crate::store::RecordTable;

/// Whether a source or session survives a restart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Keeping {
    /// It does.
    Declared,
    /// It does not: the demo's.
    Passing,
}

/// Time of a declaration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Declared {
    /// Wall clock, ms since 1970.
    pub unix_ms: u64,
    /// Number of the service's start.
    pub start: u64,
}

/// A declared source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// As put.
    pub document: SourceDocument,
    /// The model that a synthetic source renders.
    pub model: Option<Pin>,
    /// When it was put.
    pub declared: Declared,
}

/// A declared session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// As put.
    pub document: SessionDocument,
    /// The model that fits: the document's, or the one it was swapped to.
    pub model: Pin,
    /// Constants besides those of the document: from a promoted shadow.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub constants: BTreeMap<String, f64>,
    /// The model that its own synthetic source renders.
    pub source_model: Option<Pin>,
    /// When it was put.
    pub declared: Declared,
    /// Why it is no longer started.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stopped: Option<String>,
}

/// The record of a named thing, which runs again after a restart.
pub trait Declaration: Clone + Serialize + DeserializeOwned {
    /// What runs.
    type Running: Clone;
    /// The word for it in messages.
    const KIND: &'static str;
    /// The records of this kind.
    const TABLE: RecordTable;

    /// Keys of the pinned contents.
    fn contents(&self) -> Vec<&str>;
}

impl Declaration for SourceRecord {
    type Running = Arc<Source>;
    const KIND: &'static str = "source";
    const TABLE: RecordTable = RecordTable::Sources;

    fn contents(&self) -> Vec<&str> {
        self.model.iter().map(|pin| pin.content.as_str()).collect()
    }
}

impl Declaration for SessionRecord {
    type Running = Arc<Session>;
    const KIND: &'static str = "session";
    const TABLE: RecordTable = RecordTable::Sessions;

    fn contents(&self) -> Vec<&str> {
        let source = self.source_model.iter().map(|pin| pin.content.as_str());
        source.chain([self.model.content.as_str()]).collect()
    }
}
