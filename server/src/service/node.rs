//! `ServiceNode`: the node's id and the numbers of its starts and epochs, in a record that every start writes.
//!
//! If the store cannot be written to, the process is a node of its own, so that no two estimates ever have the same node, epoch
//! and frame.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};

use crate::limits::LIMITS;
use crate::store::{RecordTable, Store, StoreError, Transaction};

const KEY: &str = "this";
/// Epochs reserved in the store at a time: those left when the process ends are never used.
const EPOCHS: u64 = 1000;

/// The stored record.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct NodeRecord {
    id: String,
    starts: u64,
    /// The last epoch reserved.
    epochs: u64,
    /// Consecutive starts that died early; includes the present one until it has lived.
    died: u32,
}

/// This node.
pub struct ServiceNode {
    id: Arc<str>,
    start: u64,
    store: Arc<dyn Store>,
    state: Mutex<State>,
}

struct State {
    /// The record with its revision; `None` if it cannot be written.
    record: Option<(Option<u64>, NodeRecord)>,
    epoch: u64,
}

/// The fate of the last starts, which decides whether declared sessions may run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LastStarts {
    /// They did not all die early: sessions may run.
    Lived,
    /// They all died early: sessions may not run.
    Died,
}

impl ServiceNode {
    /// Counts this start. A start without sessions to run is not counted as one that may die early.
    pub fn open(store: Arc<dyn Store>, sessions: usize) -> Result<(ServiceNode, LastStarts), StoreError> {
        let found = store.get(RecordTable::Node, KEY)?;
        let revision = found.as_ref().map(|record| record.revision);
        let mut record: NodeRecord = match found {
            Some(found) => {
                serde_json::from_slice(&found.bytes).map_err(|error| StoreError::Failed(error.to_string()))?
            }
            None => NodeRecord { id: random_id()?, ..NodeRecord::default() },
        };
        let before = if record.died >= LIMITS.starts_died { LastStarts::Died } else { LastStarts::Lived };
        record.starts += 1;
        record.died = if sessions == 0 || before == LastStarts::Died { 0 } else { record.died + 1 };
        let (id, start, epoch) = (record.id.as_str().into(), record.starts, record.epochs);
        record.epochs += EPOCHS;
        let state = State { record: Some((revision, record)), epoch };
        let mut node = ServiceNode { id, start, store, state: Mutex::new(state) };
        let written = node.write(&mut node.lock());
        if let Err(error) = written {
            tracing::warn!("this start is not kept, so the process counts as a node of its own: {error}");
            node.id = random_id()?.into();
            *node.lock() = State { record: None, epoch: 0 };
        }
        Ok((node, before))
    }

    /// The node's id, 32 hexadecimal digits.
    pub fn id(&self) -> &Arc<str> {
        &self.id
    }

    /// The number of this start of the service, from 1.
    pub fn start(&self) -> u64 {
        self.start
    }

    /// The next epoch. A node never uses an epoch twice, even after a crash.
    pub fn next_epoch(&self) -> Result<u64, StoreError> {
        let mut state = self.lock();
        let next = state.epoch + 1;
        if let Some((_, record)) = &mut state.record
            && next > record.epochs
        {
            record.epochs += EPOCHS;
            if let Err(error) = self.write(&mut state) {
                if let Some((_, record)) = &mut state.record {
                    record.epochs -= EPOCHS;
                }
                return Err(error);
            }
        }
        state.epoch = next;
        Ok(next)
    }

    /// Notes that this start has not died early.
    pub fn lived(&self) {
        let mut state = self.lock();
        let Some((_, record)) = &mut state.record else { return };
        if std::mem::take(&mut record.died) > 0
            && let Err(error) = self.write(&mut state)
        {
            tracing::warn!("that this start has not died is not kept: {error}");
        }
    }

    fn write(&self, state: &mut State) -> Result<(), StoreError> {
        let Some((revision, record)) = &mut state.record else { return Ok(()) };
        let bytes = serde_json::to_vec(record).map_err(|error| StoreError::Failed(error.to_string()))?;
        let transaction =
            Transaction::default().expect(RecordTable::Node, KEY, *revision).put(RecordTable::Node, KEY, bytes);
        *revision = Some(self.store.commit(&transaction)?);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn random_id() -> Result<String, StoreError> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| StoreError::Failed(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::store::{MemoryStore, ReadOnlyStore};

    fn opened(store: &Arc<MemoryStore>, sessions: usize) -> (ServiceNode, LastStarts) {
        ServiceNode::open(store.clone(), sessions).unwrap()
    }

    #[test]
    fn epochs_are_never_reused_after_a_restart() {
        let store = Arc::new(MemoryStore::default());
        let (mut last, mut id) = (0, None);
        for start in 1..5 {
            let (node, _) = opened(&store, 0);
            assert_eq!((node.start(), id.get_or_insert(node.id().clone())), (start, &mut node.id().clone()));
            for _ in 0..EPOCHS + 7 {
                let epoch = node.next_epoch().unwrap();
                assert!(epoch > last);
                last = epoch;
            }
        }
    }

    #[test]
    fn three_early_deaths_stop_the_declared_sessions() {
        let store = Arc::new(MemoryStore::default());
        let before = |sessions| opened(&store, sessions).1;
        let well = [LastStarts::Lived; 3];
        assert_eq!([before(1), before(1), before(1)], well);
        assert_eq!([before(1), before(1)], [LastStarts::Died, LastStarts::Lived], "told once");
        let (node, _) = opened(&store, 1);
        node.lived();
        assert_eq!([before(1), before(1), before(1)], well);
        assert_eq!(before(0), LastStarts::Died);
        assert_eq!(
            [before(0), before(0), before(0), before(1)],
            [LastStarts::Lived; 4],
            "nothing that it could die of"
        );
    }

    #[test]
    fn without_a_writable_store_every_process_is_a_new_node() {
        let kept = Arc::new(MemoryStore::default());
        let id = opened(&kept, 0).0.id().clone();
        let records = || {
            MemoryStore::of(vec![(RecordTable::Node, KEY.into(), kept.get(RecordTable::Node, KEY).unwrap().unwrap())])
        };
        let ids: Vec<_> = (0..2)
            .map(|_| {
                let store = ReadOnlyStore { records: records(), reason: "full".into() };
                let (node, before) = ServiceNode::open(Arc::new(store), 1).unwrap();
                assert_eq!((node.next_epoch().unwrap(), before), (1, LastStarts::Lived));
                for _ in 0..2 * EPOCHS {
                    node.next_epoch().unwrap();
                }
                node.id().clone()
            })
            .collect();
        assert!(ids[0] != ids[1] && !ids.contains(&id));
    }
}
