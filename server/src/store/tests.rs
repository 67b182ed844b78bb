//! Tests of all stores against the trait, and of the folder.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::PathBuf;

use redb::backends::InMemoryBackend;

use super::folder::open;
use super::memory::MemoryStore;
use super::record::{RecordTable, Store, StoreError, Transaction};
use super::redb::{RedbStore, database};

fn put(table: RecordTable, key: &str, text: &str) -> Transaction {
    Transaction::default().put(table, key, text.into())
}

fn stores() -> Vec<Box<dyn Store>> {
    let redb = RedbStore::open(|| database(InMemoryBackend::new())).unwrap();
    vec![Box::new(MemoryStore::default()), Box::new(redb)]
}

fn texts(store: &dyn Store, table: RecordTable) -> Vec<(String, String)> {
    let records = store.list(table).unwrap().into_iter();
    records.map(|(key, record)| (key, String::from_utf8(record.bytes).unwrap())).collect()
}

#[test]
fn transactions_are_atomic() {
    for store in stores() {
        assert_eq!(store.get(RecordTable::Models, "a").unwrap(), None);
        let both = put(RecordTable::Models, "a", "one").put(RecordTable::Contents, "x", "words".into());
        let first = store.commit(&both.expect(RecordTable::Models, "a", None)).unwrap();
        assert_eq!(store.get(RecordTable::Models, "a").unwrap().unwrap().revision, first);
        let second =
            store.commit(&put(RecordTable::Models, "a", "two").expect(RecordTable::Models, "a", Some(first))).unwrap();
        assert!(second > first);
        for expected in [None, Some(first), Some(second + 1)] {
            let stale = put(RecordTable::Contents, "x", "other").remove(RecordTable::Models, "a").expect(
                RecordTable::Models,
                "a",
                expected,
            );
            assert!(matches!(store.commit(&stale), Err(StoreError::Stale(key)) if key == "a"));
        }
        assert!(store.commit(&put(RecordTable::Models, "b", "").expect(RecordTable::Models, "b", Some(1))).is_err());
        let pairs = |one: &[(&str, &str)]| -> Vec<(String, String)> {
            one.iter().map(|(key, text)| (key.to_string(), text.to_string())).collect()
        };
        assert_eq!(texts(&*store, RecordTable::Models), pairs(&[("a", "two")]));
        assert_eq!(texts(&*store, RecordTable::Contents), pairs(&[("x", "words")]), "of another kind, and as it was");
        let third = Transaction::default().remove(RecordTable::Models, "a").remove(RecordTable::Models, "nobody");
        let third = store.commit(&third).unwrap();
        assert_eq!(texts(&*store, RecordTable::Models), []);
        // A key that is created again gets a new revision.
        assert!(
            store.commit(&put(RecordTable::Models, "a", "one").expect(RecordTable::Models, "a", None)).unwrap() > third
        );
    }
}

#[test]
fn transactions_over_the_limits_are_refused() {
    const RECORD: usize = 8 * crate::limits::LIMITS.document_bytes;
    for store in stores() {
        for (key, bytes, is_kept) in
            [(256, 1, true), (257, 1, false), (1, RECORD - 1, true), (1, RECORD, true), (1, RECORD + 1, false)]
        {
            let transaction =
                put(RecordTable::Models, "beside", "x").put(RecordTable::Contents, &"k".repeat(key), vec![0; bytes]);
            assert_eq!(store.commit(&transaction).is_ok(), is_kept, "{key} {bytes}");
        }
        for (changes, is_kept) in [(16 * 1024, true), (16 * 1024 + 1, false)] {
            let many = (0..changes).fold(Transaction::default(), |all, _| all.remove(RecordTable::Contents, "k"));
            assert_eq!(store.commit(&many).is_ok(), is_kept, "{changes}");
        }
    }
}

struct Data(PathBuf);

impl Data {
    fn new(name: &str) -> Data {
        Data(std::env::temp_dir().join(format!("isophote-{name}-{}", std::process::id())))
    }
}

impl Drop for Data {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn a_folder_is_locked_and_imports_old_models_once() {
    let data = Data::new("store");
    fs::create_dir_all(data.0.join("models")).unwrap();
    let import = |_: &std::path::Path| Ok((1, put(RecordTable::Models, "old", "model")));
    fs::write(data.0.join("isophote.redb.new"), "of a start that was cut off").unwrap();
    let store = open(&data.0, import).unwrap();
    let second = open(&data.0, import).err().unwrap().to_string();
    assert!(second.contains("another service"), "{second}");
    store.commit(&put(RecordTable::Models, "old", "changed").put(RecordTable::Sessions, "s", "1".into())).unwrap();
    drop(store);
    let store = open(&data.0, |_| panic!("it was read before")).unwrap();
    assert_eq!(texts(&store, RecordTable::Models), [("old".into(), "changed".into())]);
    assert_eq!(texts(&store, RecordTable::Sessions), [("s".into(), "1".into())]);
}

#[test]
fn a_file_that_is_no_database_is_reported_and_kept() {
    let data = Data::new("no-database");
    fs::create_dir_all(&data.0).unwrap();
    let path = data.0.join("isophote.redb");
    fs::write(&path, "a text").unwrap();
    let said = open(&data.0, |_| panic!("there is nothing to import")).err().unwrap().to_string();
    assert!(said.contains("isophote.redb") && said.contains("another --data"), "{said}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "a text");
    // An emptied file is not taken for a new one.
    fs::write(&path, "").unwrap();
    let said = open(&data.0, |_| panic!("there is nothing to import")).err().unwrap().to_string();
    assert!(said.contains("isophote.redb: it is empty") && said.contains("remove it"), "{said}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "");
    fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
    assert!(open(&data.0, |_| panic!("there is nothing to import")).is_err());
}

#[test]
fn another_format_is_refused() {
    let disk = std::sync::Mutex::new(Some(InMemoryBackend::new()));
    let counters: redb::TableDefinition<&str, u64> = redb::TableDefinition::new("counters");
    let opened = RedbStore::open(move || {
        let database = database(disk.lock().unwrap().take().unwrap())?;
        let transaction = database.begin_write().unwrap();
        transaction.open_table(counters).unwrap().insert("format", 2).unwrap();
        transaction.commit().unwrap();
        Ok(database)
    });
    assert!(opened.err().unwrap().to_string().contains("newer isophote"));
}

#[test]
fn a_damaged_page_is_reported_with_the_file_and_a_remedy() {
    let data = Data::new("damaged");
    fs::create_dir_all(&data.0).unwrap();
    let import =
        |_: &std::path::Path| -> std::io::Result<(usize, Transaction)> { panic!("there is nothing to import") };
    let made = open(&data.0, import).unwrap();
    for number in 0..40 {
        made.commit(&put(RecordTable::Contents, &format!("key{number}"), &"words ".repeat(400))).unwrap();
    }
    drop(made);
    let path = data.0.join("isophote.redb");
    let whole = fs::read(&path).unwrap();
    let mut refused = 0;
    for page in (0..whole.len()).step_by(4096) {
        let mut damaged = whole.clone();
        let end = (page + 4096).min(damaged.len());
        damaged[page..end].fill(0);
        fs::write(&path, &damaged).unwrap();
        // Pages without records may be damaged.
        if let Err(error) = open(&data.0, import) {
            let error = error.to_string();
            assert!(error.contains("isophote.redb: ") && error.contains("start with another --data"), "{error}");
            refused += 1;
        }
    }
    assert!(refused > 0);
    fs::write(&path, &whole).unwrap();
    assert!(open(&data.0, import).is_ok());
}
