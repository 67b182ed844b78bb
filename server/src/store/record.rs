//! What a store keeps, and what any store must do: the one thing that everybody else knows of it.

use axum::http::StatusCode;

use crate::problem::Problem;

/// A kind of record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordTable {
    /// The node itself: one record.
    Node,
    /// Names of models, with their versions.
    Models,
    /// Documents of models, by what they say.
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

    /// As the database calls it.
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

/// What stands under a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Of the transaction that wrote it; grows over the whole store, and is never used twice.
    pub revision: u64,
    /// Its text.
    pub bytes: Vec<u8>,
}

/// One change of a [`Transaction`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Of what kind.
    pub table: RecordTable,
    /// Under which key.
    pub key: String,
    /// Nothing removes it.
    pub bytes: Option<Vec<u8>>,
}

/// Changes that are made together, if what is expected stands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transaction {
    pub(super) expected: Vec<(RecordTable, String, Option<u64>)>,
    pub(super) changes: Vec<Change>,
}

/// Changes of one transaction: a model's record, and all contents that nobody needs any more.
const CHANGES_MAX: usize = 16 * 1024;
/// Bytes of a key.
const KEY_BYTES_MAX: usize = 256;
/// Bytes of a record: a document, every character of it escaped, and what stands around it.
const RECORD_BYTES_MAX: usize = 8 * crate::limits::LIMITS.document_bytes;

impl Transaction {
    /// Only if the record is still of that revision, or, with nothing, absent.
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

    /// Refuses what is longer than a transaction may be.
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
    /// The disk, in the system's words.
    #[error("{0}")]
    Failed(String),
    /// Somebody else changed it.
    #[error("the record `{0}` was changed by somebody else")]
    Stale(String),
    /// More than a transaction may hold.
    #[error("more than one change may hold")]
    TooLarge,
}

impl StoreError {
    /// 507, or 409 where somebody else was faster: nothing was changed.
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

    /// Makes the changes of a transaction, all or none. When this returns its revision, they survive a crash.
    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError>;
}
