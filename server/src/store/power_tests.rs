//! Tests with power cuts and disk errors at every call. A disk is a log of writes; those not synchronised before a power cut
//! may be lost, all of them or any part.

#![allow(clippy::unwrap_used)]

use std::io::{Error, ErrorKind, Result};
use std::sync::{Arc, Mutex, MutexGuard};

use redb::StorageBackend;

use super::record::{RecordTable, Store, StoreError, Transaction};
use super::redb::{RedbStore, database};

#[derive(Clone, Debug)]
enum Call {
    SetLength(u64),
    Write(u64, Vec<u8>),
    Synchronise,
}

/// Content of a disk, with the log of its calls.
#[derive(Debug, Default)]
struct Medium {
    bytes: Vec<u8>,
    log: Vec<Call>,
    /// Number of calls that still succeed.
    good: Option<usize>,
    /// Whether all further calls fail, or just one.
    is_lasting: bool,
}

impl Medium {
    fn apply(&mut self, call: &Call) {
        match call {
            Call::SetLength(length) => self.bytes.resize(*length as usize, 0),
            Call::Write(at, bytes) => {
                let (at, end) = (*at as usize, *at as usize + bytes.len());
                if self.bytes.len() < end {
                    self.bytes.resize(end, 0);
                }
                self.bytes[at..end].copy_from_slice(bytes);
            }
            Call::Synchronise => {}
        }
    }
}

/// A disk; clones share it.
#[derive(Clone, Debug, Default)]
struct Disk(Arc<Mutex<Medium>>);

impl Disk {
    fn lock(&self) -> MutexGuard<'_, Medium> {
        self.0.lock().unwrap()
    }

    fn of(bytes: Vec<u8>) -> Disk {
        Disk(Arc::new(Mutex::new(Medium { bytes, ..Medium::default() })))
    }

    fn store(&self) -> std::result::Result<RedbStore, StoreError> {
        let disk = self.clone();
        RedbStore::open(move || database(disk.clone()))
    }

    fn call(&self, call: Call) -> Result<()> {
        let mut medium = self.lock();
        match &mut medium.good {
            Some(0) => {
                if !medium.is_lasting {
                    medium.good = None;
                }
                return Err(Error::from(ErrorKind::StorageFull));
            }
            Some(good) => *good -= 1,
            None => {}
        }
        medium.apply(&call);
        medium.log.push(call);
        Ok(())
    }
}

impl StorageBackend for Disk {
    fn len(&self) -> Result<u64> {
        Ok(self.lock().bytes.len() as u64)
    }
    fn read(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        let medium = self.lock();
        let found = medium.bytes.get(offset as usize..offset as usize + out.len());
        out.copy_from_slice(found.ok_or_else(|| Error::from(ErrorKind::UnexpectedEof))?);
        Ok(())
    }
    fn set_len(&self, len: u64) -> Result<()> {
        self.call(Call::SetLength(len))
    }
    fn sync_data(&self) -> Result<()> {
        self.call(Call::Synchronise)
    }
    fn write(&self, offset: u64, data: &[u8]) -> Result<()> {
        self.call(Call::Write(offset, data.to_vec()))
    }
}

type Contents = Vec<(String, Vec<u8>)>;

fn contents(store: &RedbStore) -> Contents {
    let of = |table: RecordTable| store.list(table).unwrap().into_iter();
    of(RecordTable::Models).chain(of(RecordTable::Contents)).map(|(key, record)| (key, record.bytes)).collect()
}

/// The `i`-th change: names and contents of several sizes are put, replaced and removed, two records at a time.
fn change(i: usize) -> Transaction {
    let (name, text) = (format!("m{}", i % 3), vec![i as u8; [10, 3000, 70_000][i % 3] + i]);
    let transaction = Transaction::default().put(RecordTable::Models, &name, vec![i as u8; 20]);
    match i % 4 {
        3 => transaction.remove(RecordTable::Contents, &format!("c{}", i - 2)),
        _ => transaction.put(RecordTable::Contents, &format!("c{i}"), text),
    }
}

/// A small pseudo-random generator with a fixed seed.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn a_power_cut_keeps_acknowledged_changes_and_at_most_one_more() {
    const CHANGES: usize = 12;
    let disk = Disk::default();
    let store = disk.store().unwrap();
    // Acknowledged contents, by number of calls.
    let mut acknowledged = vec![(disk.lock().log.len(), contents(&store))];
    for i in 0..CHANGES {
        store.commit(&change(i)).unwrap();
        acknowledged.push((disk.lock().log.len(), contents(&store)));
    }
    let log = std::mem::take(&mut disk.lock().log);
    let first = acknowledged[0].0;
    let (mut state, mut cuts, mut newer) = (0x9e37_79b9_7f4a_7c15_u64, 0, 0);
    let mut safe = Medium::default();
    let mut unsafe_calls: Vec<&Call> = Vec::new();
    for (at, call) in log.iter().enumerate() {
        if let Call::Synchronise = call {
            unsafe_calls.drain(..).for_each(|call| safe.apply(call));
        } else {
            unsafe_calls.push(call);
        }
        let done = at + 1;
        if done < first {
            continue; // a new store has no name yet
        }
        let last = acknowledged.iter().rposition(|(calls, _)| *calls <= done).unwrap();
        // Unsynchronised writes are lost, kept, or kept in part.
        let seed = random(&mut state);
        let survives: [&dyn Fn(usize) -> bool; 3] = [&|_| false, &|_| true, &|i| seed >> (i % 60) & 1 == 1];
        for survives in survives {
            let mut medium = Medium { bytes: safe.bytes.clone(), ..Medium::default() };
            let left = unsafe_calls.iter().enumerate().filter(|(i, _)| survives(*i));
            left.for_each(|(_, call)| medium.apply(call));
            let store = Disk::of(medium.bytes).store().unwrap_or_else(|error| panic!("after {done} calls: {error}"));
            let found = contents(&store);
            let is_newer = acknowledged.get(last + 1).is_some_and(|(_, next)| *next == found);
            assert!(found == acknowledged[last].1 || is_newer, "after {done} calls, seed {seed}");
            store.commit(&change(CHANGES)).unwrap();
            cuts += 1;
            newer += usize::from(is_newer);
        }
    }
    eprintln!("{cuts} power cuts in {} calls: {newer} found the change that was under way", log.len());
    assert!(
        cuts > 300 && newer > 0 && newer < cuts / 2,
        "{cuts} cuts, {newer} of them after the last pointer was written"
    );
}

/// Checks the checker: a disk that falsely reports a synchronisation is detected.
#[test]
fn a_false_synchronisation_is_detected() {
    let disk = Disk::default();
    let store = disk.store().unwrap();
    let safe = disk.lock().bytes.clone();
    store.commit(&change(0)).unwrap();
    let found = contents(&Disk::of(safe).store().unwrap());
    assert_ne!(found, contents(&store));
}

#[test]
fn a_failed_commit_changes_nothing_and_later_ones_succeed() {
    for is_lasting in [false, true] {
        let mut failures = 0;
        for good in 0.. {
            let disk = Disk::default();
            let store = disk.store().unwrap();
            for i in 0..4 {
                store.commit(&change(i)).unwrap();
            }
            let before = contents(&store);
            (disk.lock().good, disk.lock().is_lasting) = (Some(good), is_lasting);
            let result = store.commit(&change(4));
            let was_reached = disk.lock().good.is_none_or(|good| good == 0);
            disk.lock().good = None;
            let after = contents(&store);
            match &result {
                Ok(_) => assert_ne!(after, before),
                Err(StoreError::Failed(reason)) => {
                    assert_eq!(after, before, "call {good}, lasting {is_lasting}: {reason}");
                    failures += 1;
                }
                Err(other) => panic!("{other}"),
            }
            store.commit(&change(5)).unwrap();
            let kept = contents(&store);
            drop(store);
            assert_eq!(contents(&disk.store().unwrap()), kept, "call {good}");
            if result.is_ok() && !was_reached {
                break;
            }
        }
        assert!(failures > 5, "{failures}");
    }
}
