//! Records, transactions, and the [`Store`] trait: the interface of every store.

use axum::http::StatusCode;

use crate::problem::Problem;

/// A kind of record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordTable {
    /// The node itself: one record.
    Node,
    /// Names of models, with their versions.
    Models,
    /// Documents of models, by content.
    Contents,
    /// Sources, as declared.
    Sources,
    /// Sessions, as declared.
    Sessions,
}

impl RecordTable {
    /// All of them.
    pub const ALL: [RecordTable; 5] =
        [RecordTable::Node, RecordTable::Models, RecordTable::Contents, RecordTable::Sources, RecordTable::Sessions];

    /// Name of the table in the database.
    pub fn name(self) -> &'static str {
        match self {
            RecordTable::Node => "node",
            RecordTable::Models => "models",
            RecordTable::Contents => "contents",
            RecordTable::Sources => "sources",
            RecordTable::Sessions => "sessions",
        }
    }
}

/// A stored record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Revision of the transaction that wrote it; grows over the whole store and is never reused.
    pub revision: u64,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// One change of a [`Transaction`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The table.
    pub table: RecordTable,
    /// The key.
    pub key: String,
    /// The new content; `None` removes the record.
    pub bytes: Option<Vec<u8>>,
}

/// Changes that are made atomically if all expected revisions match.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transaction {
    pub(super) expected: Vec<(RecordTable, String, Option<u64>)>,
    pub(super) changes: Vec<Change>,
}

/// Changes of one transaction: a model's record, and all contents that nothing references any more.
const CHANGES_MAX: usize = 16 * 1024;
/// Bytes of a key.
const KEY_BYTES_MAX: usize = 256;
/// Bytes of a record: a document with every character escaped, and the keys around it.
const RECORD_BYTES_MAX: usize = 8 * crate::limits::LIMITS.document_bytes;

impl Transaction {
    /// Requires that the record has that revision, or with `None` that it is absent.
    pub fn expect(mut self, table: RecordTable, key: &str, revision: Option<u64>) -> Transaction {
        self.expected.push((table, key.to_string(), revision));
        self
    }

    /// Writes a record.
    pub fn put(mut self, table: RecordTable, key: &str, bytes: Vec<u8>) -> Transaction {
        self.changes.push(Change { table, key: key.to_string(), bytes: Some(bytes) });
        self
    }

    /// Removes a record, if it is there.
    pub fn remove(mut self, table: RecordTable, key: &str) -> Transaction {
        self.changes.push(Change { table, key: key.to_string(), bytes: None });
        self
    }

    /// Refuses a transaction over these limits.
    pub(super) fn check(&self) -> Result<(), StoreError> {
        let is_long = |change: &Change| {
            change.key.len() > KEY_BYTES_MAX
                || change.bytes.as_ref().is_some_and(|bytes| bytes.len() > RECORD_BYTES_MAX)
        };
        if self.changes.len() > CHANGES_MAX || self.changes.iter().any(is_long) {
            return Err(StoreError::TooLarge);
        }
        Ok(())
    }
}

/// Why nothing was changed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A disk error, as the system reports it.
    #[error("{0}")]
    Failed(String),
    /// A record has another revision than expected.
    #[error("the record `{0}` was changed by somebody else")]
    Stale(String),
    /// The transaction is over its limits.
    #[error("more than one change may hold")]
    TooLarge,
}

impl StoreError {
    /// 507, or 409 for a stale revision: nothing was changed.
    pub fn problem(self) -> Problem {
        let detail = format!("not stored, nothing was changed: {self}");
        match self {
            StoreError::Stale(_) => Problem::conflict("conflict", detail),
            StoreError::Failed(_) | StoreError::TooLarge => {
                Problem::new(StatusCode::INSUFFICIENT_STORAGE, "storage", detail)
            }
        }
    }
}

/// Records by key.
pub trait Store: Send + Sync {
    /// The record under a key.
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError>;

    /// All records of a kind, by key.
    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError>;

    /// Commits a transaction atomically. When this returns its revision, it survives a crash.
    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError>;
}
