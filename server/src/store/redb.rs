//! A store in one file, by redb: a transaction writes its pages beside the old ones, synchronises them, and only then points to
//! them; so a power cut leaves the old records or the new ones.
//! throughout, and because its disk is a trait, so that `power_tests.rs` can fail every call.

use std::sync::{Mutex, MutexGuard, PoisonError};

use redb::{
    Builder, Database, DatabaseError, ReadableDatabase, ReadableTable, StorageBackend, TableDefinition, TableError,
    WriteTransaction,
};

use super::record::{Record, RecordTable, Store, StoreError, Transaction};

/// Version of the record layout; others are refused.
const FORMAT: u64 = 1;
/// Bytes of the page cache.
const CACHE_BYTES: usize = 4 * 1024 * 1024;

const COUNTERS: TableDefinition<&str, u64> = TableDefinition::new("counters");

/// A record's revision, then its content.
type Rows = TableDefinition<'static, &'static str, &'static [u8]>;

fn rows(table: RecordTable) -> Rows {
    TableDefinition::new(table.name())
}

/// Opens the database.
type Opening = Box<dyn Fn() -> Result<Database, DatabaseError> + Send + Sync>;

/// The store.
pub struct RedbStore {
    opening: Opening,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// `None` after a failure until it is reopened: redb trusts nothing it read before.
    database: Option<Database>,
    undo: Option<Undo>,
}

/// The inverse of a failed commit, which may have reached the disk all the same.
struct Undo {
    revision: u64,
    before: Vec<(RecordTable, String, Option<Vec<u8>>)>,
}

/// Why a commit failed.
enum Attempt {
    Stale(String),
    Failed { reason: String, undo: Option<Undo> },
}

impl Attempt {
    /// A failure before the commit: nothing reached the disk.
    fn failed(error: redb::Error) -> Attempt {
        Attempt::Failed { reason: error.to_string(), undo: None }
    }
}

/// Opens or creates the database on a backend.
pub fn database(backend: impl StorageBackend) -> Result<Database, DatabaseError> {
    Builder::new().set_cache_size(CACHE_BYTES).create_with_backend(backend)
}

impl RedbStore {
    /// Opens the database; reopens it after every failure. Creates the tables of a new one.
    pub fn open(
        opening: impl Fn() -> Result<Database, DatabaseError> + Send + Sync + 'static,
    ) -> Result<RedbStore, StoreError> {
        let store = RedbStore { opening: Box::new(opening), state: Mutex::default() };
        let found = {
            let mut state = store.lock();
            store.recover(&mut state)?;
            let Some(database) = &state.database else { return Err(closed()) };
            counter(database, "format").map_err(failed)?
        };
        match found {
            Some(FORMAT) => Ok(store),
            Some(other) => {
                let reason = format!("it has the format {other}, this program knows {FORMAT}; use a newer isophote");
                Err(StoreError::Failed(reason))
            }
            None => store.lay_out().map(|()| store),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lay_out(&self) -> Result<(), StoreError> {
        let state = self.lock();
        let Some(database) = &state.database else { return Err(closed()) };
        let write = || -> Result<(), redb::Error> {
            let transaction = begin(database)?;
            for table in RecordTable::ALL {
                transaction.open_table(rows(table))?;
            }
            transaction.open_table(COUNTERS)?.insert("format", FORMAT)?;
            Ok(transaction.commit()?)
        };
        write().map_err(failed)
    }

    /// Reopens the database if necessary and undoes a failed commit: a caller was told that nothing changed.
    fn recover(&self, state: &mut State) -> Result<(), StoreError> {
        if state.database.is_none() {
            state.database = Some((self.opening)().map_err(failed)?);
        }
        let (Some(database), Some(undo)) = (&state.database, &state.undo) else { return Ok(()) };
        match undo.run(database) {
            Ok(()) => {
                state.undo = None;
                Ok(())
            }
            Err(error) => {
                state.database = None;
                Err(failed(error))
            }
        }
    }

    fn read<T>(&self, read: impl FnOnce(&Database) -> Result<T, redb::Error>) -> Result<T, StoreError> {
        let mut state = self.lock();
        self.recover(&mut state)?;
        let Some(database) = &state.database else { return Err(closed()) };
        read(database).map_err(|error| {
            state.database = None;
            failed(error)
        })
    }
}

impl Store for RedbStore {
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError> {
        self.read(|database| {
            let table = database.begin_read()?.open_table(rows(table))?;
            Ok(table.get(key)?.and_then(|row| record(row.value())))
        })
    }

    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError> {
        self.read(|database| {
            let table = database.begin_read()?.open_table(rows(table))?;
            let mut records = Vec::new();
            for row in table.iter()? {
                let (key, row) = row?;
                records.extend(record(row.value()).map(|record| (key.value().to_string(), record)));
            }
            Ok(records)
        })
    }

    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError> {
        transaction.check()?;
        let mut state = self.lock();
        self.recover(&mut state)?;
        let Some(database) = &state.database else { return Err(closed()) };
        match attempt(database, transaction) {
            Ok(revision) => Ok(revision),
            Err(Attempt::Stale(key)) => Err(StoreError::Stale(key)),
            Err(Attempt::Failed { reason, undo }) => {
                state.database = None;
                state.undo = undo;
                // If the disk still fails, the next call retries.
                self.recover(&mut state).ok();
                Err(StoreError::Failed(reason))
            }
        }
    }
}

/// Two-phase commit: documents are untrusted, and one crafted to fool the checksums of pages must not pass for a commit.
fn begin(database: &Database) -> Result<WriteTransaction, redb::Error> {
    let mut transaction = database.begin_write()?;
    transaction.set_two_phase_commit(true);
    Ok(transaction)
}

fn attempt(database: &Database, wanted: &Transaction) -> Result<u64, Attempt> {
    let transaction = begin(database).map_err(Attempt::failed)?;
    if let Some(key) = stale(&transaction, wanted).map_err(Attempt::failed)? {
        return Err(Attempt::Stale(key)); // dropping the transaction aborts it
    }
    let undo = stage(&transaction, wanted).map_err(Attempt::failed)?;
    let revision = undo.revision;
    transaction.commit().map_err(|error| Attempt::Failed { reason: error.to_string(), undo: Some(undo) })?;
    Ok(revision)
}

/// The key of the first record with an unexpected revision.
fn stale(transaction: &WriteTransaction, wanted: &Transaction) -> Result<Option<String>, redb::Error> {
    for (table, key, expected) in &wanted.expected {
        let table = transaction.open_table(rows(*table))?;
        let found = table.get(key.as_str())?.and_then(|row| record(row.value())).map(|record| record.revision);
        if found != *expected {
            return Ok(Some(key.clone()));
        }
    }
    Ok(None)
}

/// Makes the changes, invisible before the commit, and returns their inverse.
fn stage(transaction: &WriteTransaction, wanted: &Transaction) -> Result<Undo, redb::Error> {
    let mut counters = transaction.open_table(COUNTERS)?;
    let revision = counters.get("revision")?.map_or(0, |counter| counter.value()) + 1;
    counters.insert("revision", revision)?;
    let mut before = Vec::new();
    for change in &wanted.changes {
        let mut table = transaction.open_table(rows(change.table))?;
        let old = match &change.bytes {
            Some(bytes) => {
                let row = [&revision.to_le_bytes(), bytes.as_slice()].concat();
                table.insert(change.key.as_str(), row.as_slice())?.map(|row| row.value().to_vec())
            }
            None => table.remove(change.key.as_str())?.map(|row| row.value().to_vec()),
        };
        before.push((change.table, change.key.clone(), old));
    }
    Ok(Undo { revision, before })
}

impl Undo {
    fn run(&self, database: &Database) -> Result<(), redb::Error> {
        if counter(database, "revision")? != Some(self.revision) {
            return Ok(()); // the commit did not reach the disk
        }
        let transaction = begin(database)?;
        for (table, key, row) in self.before.iter().rev() {
            let mut table = transaction.open_table(rows(*table))?;
            match row {
                Some(row) => drop(table.insert(key.as_str(), row.as_slice())?),
                None => drop(table.remove(key.as_str())?),
            }
        }
        transaction.open_table(COUNTERS)?.insert("revision", self.revision + 1)?;
        Ok(transaction.commit()?)
    }
}

/// `None` if the database is new.
fn counter(database: &Database, key: &str) -> Result<Option<u64>, redb::Error> {
    match database.begin_read()?.open_table(COUNTERS) {
        Ok(counters) => Ok(counters.get(key)?.map(|counter| counter.value())),
        Err(TableError::TableDoesNotExist(_)) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn record(row: &[u8]) -> Option<Record> {
    let (revision, bytes) = row.split_first_chunk()?;
    Some(Record { revision: u64::from_le_bytes(*revision), bytes: bytes.to_vec() })
}

fn failed(error: impl Into<redb::Error>) -> StoreError {
    StoreError::Failed(error.into().to_string())
}

fn closed() -> StoreError {
    StoreError::Failed("the database is closed".into())
}
