//! What was declared, and runs again when the service is started again: sources and sessions with the models that they had.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use isophote_wire::{SessionDocument, SourceDocument};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::compiler::Owner;
use crate::name::Name;
use crate::preconditions::digest;
use crate::registry::{ModelText, Pin};
use crate::store::{RecordTable, Store, StoreError, Transaction};

/// Whether what is put is there after a restart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Keeping {
    /// It is.
    Declared,
    /// It is not: the demo's.
    Passing,
}

/// When something was put.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Declared {
    /// By the wall clock, ms since 1970.
    pub unix_ms: u64,
    /// The start of the service in which it was.
    pub start: u64,
}

/// A source that was put.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// As put.
    pub document: SourceDocument,
    /// The model that a synthetic one renders.
    pub model: Option<Pin>,
    /// When.
    pub declared: Declared,
}

/// A session that was put.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// As put.
    pub document: SessionDocument,
    /// The model that fits: the document's, or that to which it was swapped.
    pub model: Pin,
    /// Its constants beside those of the document: a shadow's that took over.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub constants: BTreeMap<String, f64>,
    /// The model that a synthetic source of its own renders.
    pub source_model: Option<Pin>,
    /// When.
    pub declared: Declared,
    /// Why it is not started any more.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stopped: Option<String>,
}

/// What pins models.
pub trait Pins {
    /// The keys of their contents.
    fn contents(&self) -> Vec<&str>;
}

impl Pins for SourceRecord {
    fn contents(&self) -> Vec<&str> {
        self.model.iter().map(|pin| pin.content.as_str()).collect()
    }
}

impl Pins for SessionRecord {
    fn contents(&self) -> Vec<&str> {
        let source = self.source_model.iter().map(|pin| pin.content.as_str());
        source.chain([self.model.content.as_str()]).collect()
    }
}

/// A record of the store.
struct StoredRecord<R> {
    revision: u64,
    /// Of its bytes.
    digest: String,
    /// Nothing of one that this build cannot read.
    record: Option<R>,
}

/// All of one kind. Changed only after the store has it.
pub struct Declarations<R> {
    store: Arc<dyn Store>,
    table: RecordTable,
    records: Mutex<BTreeMap<Name, StoredRecord<R>>>,
}

impl<R: Clone + Serialize + DeserializeOwned + Pins> Declarations<R> {
    /// Those of the store. One that this build cannot read is said and left alone.
    pub fn open(store: Arc<dyn Store>, table: RecordTable) -> Result<Declarations<R>, StoreError> {
        let mut records = BTreeMap::new();
        for (key, record) in store.list(table)? {
            let read = serde_json::from_slice(&record.bytes);
            if let Err(error) = &read {
                tracing::warn!("the record `{key}` of {} cannot be read, left alone: {error}", table.name());
            }
            let (revision, digest) = (record.revision, digest(&record.bytes));
            let stored = StoredRecord { revision, digest, record: read.ok() };
            records.extend(Name::parse(&key).map(|name| (name, stored)));
        }
        Ok(Declarations { store, table, records: Mutex::new(records) })
    }

    /// Whether one of them could not be read.
    pub fn has_unread(&self) -> bool {
        self.lock().values().any(|stored| stored.record.is_none())
    }

    /// What was declared under a name.
    pub fn get(&self, name: &Name) -> Option<R> {
        self.lock().get(name).and_then(|stored| stored.record.clone())
    }

    /// Of what is declared under a name: another one after each change of it. The digest tells apart what stores have that
    /// forget, and number their changes anew.
    pub fn tag(&self, name: &Name) -> Option<String> {
        self.lock().get(name).map(|StoredRecord { revision, digest, .. }| format!("{revision:x}-{digest}"))
    }

    /// All, by name.
    pub fn all(&self) -> Vec<(Name, R)> {
        self.lock().iter().filter_map(|(name, stored)| Some((name.clone(), stored.record.clone()?))).collect()
    }

    /// Keys of the contents that are needed.
    pub fn contents(&self) -> Vec<String> {
        let records = self.lock();
        records.values().filter_map(|stored| stored.record.as_ref()).flat_map(R::contents).map(str::to_string).collect()
    }

    /// Declares, with contents that it needs and that are not kept yet. When this returns, it survives a crash.
    pub fn put(&self, _owner: &mut Owner, name: &Name, record: R, contents: &[ModelText]) -> Result<(), StoreError> {
        let unwritten = |error: serde_json::Error| StoreError::Failed(error.to_string());
        let revision = self.lock().get(name).map(|stored| stored.revision);
        let bytes = serde_json::to_vec(&record).map_err(unwritten)?;
        let digest = digest(&bytes);
        let mut transaction =
            Transaction::default().expect(self.table, name.as_str(), revision).put(self.table, name.as_str(), bytes);
        for content in contents {
            transaction = transaction.put(RecordTable::Contents, &content.key(), content.bytes().map_err(unwritten)?);
        }
        let revision = self.store.commit(&transaction)?;
        self.lock().insert(name.clone(), StoredRecord { revision, digest, record: Some(record) });
        Ok(())
    }

    /// Declares it no more.
    pub fn remove(&self, _owner: &mut Owner, name: &Name) -> Result<(), StoreError> {
        let Some(revision) = self.lock().get(name).map(|stored| stored.revision) else { return Ok(()) };
        let transaction = Transaction::default().expect(self.table, name.as_str(), Some(revision));
        self.store.commit(&transaction.remove(self.table, name.as_str()))?;
        self.lock().remove(name);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Name, StoredRecord<R>>> {
        self.records.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
