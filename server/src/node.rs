//! Who serves, and how often it began: the one record that every start writes.
//!
//! What comes in: a store. What goes out: the node's id, the numbers of starts and epochs. Where the store cannot be written to,
//! the process is a node of its own, so that no two estimates ever have the same node, epoch and frame.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};

use crate::limits::LIMITS;
use crate::store::{RecordTable, Store, StoreError, Transaction};

const KEY: &str = "this";
/// Epochs that are taken from the store at a time: what is left of them when the process ends is never used.
const EPOCHS: u64 = 1000;

/// What is kept.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct NodeRecord {
    id: String,
    starts: u64,
    /// Those before it were taken.
    epochs: u64,
    /// Starts that died early, one after the other, the last one among them until it has not.
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
    /// With its revision; nothing where it cannot be written.
    record: Option<(Option<u64>, NodeRecord)>,
    epoch: u64,
}

/// What became of the starts before this one, and so whether what was declared may run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LastStarts {
    /// Not all of the last ones have died early: it may.
    Lived,
    /// They have: it may not.
    Died,
}

impl ServiceNode {
    /// Counts this start. One without sessions to run is no start that could die of them.
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

    /// Its id, 32 hexadecimal digits.
    pub fn id(&self) -> &Arc<str> {
        &self.id
    }

    /// The number of this start of the service, from 1.
    pub fn start(&self) -> u64 {
        self.start
    }

    /// The next epoch. Those of one node are never used again, whatever it dies of.
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

    /// This start has not died early.
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
    fn epochs_are_used_once_whatever_the_node_dies_of() {
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
    fn the_third_early_death_is_the_last() {
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
    fn without_a_disk_every_process_is_a_node() {
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
