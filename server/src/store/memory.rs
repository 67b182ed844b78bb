//! A store in memory, and a read-only store.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::record::{Record, RecordTable, Store, StoreError, Transaction};

/// Records in memory.
#[derive(Default)]
pub struct MemoryStore {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    records: BTreeMap<(RecordTable, String), Record>,
    revision: u64,
}

impl MemoryStore {
    /// A store of these records.
    pub fn of(records: Vec<(RecordTable, String, Record)>) -> MemoryStore {
        let revision = records.iter().map(|(_, _, record)| record.revision).max().unwrap_or(0);
        let records = records.into_iter().map(|(table, key, record)| ((table, key), record)).collect();
        MemoryStore { state: Mutex::new(State { records, revision }) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Store for MemoryStore {
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError> {
        Ok(self.lock().records.get(&(table, key.to_string())).cloned())
    }

    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError> {
        let state = self.lock();
        let of_table = state.records.iter().filter(|((one, _), _)| *one == table);
        Ok(of_table.map(|((_, key), record)| (key.clone(), record.clone())).collect())
    }

    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError> {
        transaction.check()?;
        let mut state = self.lock();
        for (table, key, expected) in &transaction.expected {
            let found = state.records.get(&(*table, key.clone())).map(|record| record.revision);
            if found != *expected {
                return Err(StoreError::Stale(key.clone()));
            }
        }
        state.revision += 1;
        let revision = state.revision;
        for change in &transaction.changes {
            let key = (change.table, change.key.clone());
            match &change.bytes {
                Some(bytes) => drop(state.records.insert(key, Record { revision, bytes: bytes.clone() })),
                None => drop(state.records.remove(&key)),
            }
        }
        Ok(revision)
    }
}

/// A store that refuses every change: its folder cannot be written to.
pub struct ReadOnlyStore {
    /// Its records.
    pub records: MemoryStore,
    /// Why it cannot be changed.
    pub reason: String,
}

impl Store for ReadOnlyStore {
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError> {
        self.records.get(table, key)
    }

    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError> {
        self.records.list(table)
    }

    fn commit(&self, _: &Transaction) -> Result<u64, StoreError> {
        Err(StoreError::Failed(self.reason.clone()))
    }
}
