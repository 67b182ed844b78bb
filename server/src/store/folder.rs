//! `--data DIR`: the folder, locked by one service at a time, and its database.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use isophote_capture::{open_regular, read_regular};
use redb::backends::{FileBackend, InMemoryBackend};
use redb::{Database, DatabaseError, StorageBackend};

use super::memory::{MemoryStore, ReadOnlyStore};
use super::record::{Record, RecordTable, Store, StoreError, Transaction};
use super::redb::{RedbStore, database};

/// The database's file.
const FILE: &str = "isophote.redb";
/// The file's name before it is complete.
const FILE_NEW: &str = "isophote.redb.new";
/// The folder of earlier versions.
const MODELS: &str = "models";
/// Bytes of a read-only database, which is loaded into memory.
const FILE_BYTES_MAX: u64 = 4 * 1024 * 1024 * 1024;

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct FolderError {
    path: PathBuf,
    reason: String,
}

fn at(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> FolderError {
    move |reason| FolderError { path: path.to_path_buf(), reason: reason.to_string() }
}

/// A locked folder with its store.
pub struct Folder {
    store: Box<dyn Store>,
    /// Locks against other services, held while open; the second is that of earlier versions.
    _locks: Vec<File>,
}

/// Creates the folder if missing, locks it, and opens its database. A new database takes the models of an earlier version,
/// which `import` reads and counts. A folder that cannot be written to is logged and read.
pub fn open(folder: &Path, import: impl Fn(&Path) -> io::Result<(usize, Transaction)>) -> Result<Folder, FolderError> {
    fs::create_dir_all(folder).map_err(|error| at(folder)(&error))?;
    let models = folder.join(MODELS);
    let mut locks = Vec::from_iter(locked(folder)?);
    if models.is_dir() {
        locks.extend(locked(&models)?);
    }
    let path = folder.join(FILE);
    let store: Box<dyn Store> = match file(&path) {
        Ok(found) => {
            check_filled(&path, &found)?;
            Box::new(opened(&path)?)
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => made(folder, import)?,
        Err(error) if is_read_only(&error) => Box::new(read(&path, &error)?),
        Err(error) => return Err(at(&path)(&error)),
    };
    Ok(Folder { store, _locks: locks })
}

/// Refuses an empty file: a database is complete before it gets its name, so somebody emptied it, and a new one in its place
/// would hide that loss.
fn check_filled(path: &Path, file: &File) -> Result<(), FolderError> {
    let bytes = file.metadata().map_err(|error| at(path)(&error))?.len();
    if bytes > 0 {
        return Ok(());
    }
    Err(at(path)(
        &"it is empty, which no database of this program ever is: put a copy of it back, or remove it to begin anew",
    ))
}

fn locked(folder: &Path) -> Result<Option<File>, FolderError> {
    let lock = File::open(folder).map_err(|error| at(folder)(&error))?;
    match lock.try_lock() {
        Ok(()) => Ok(Some(lock)),
        Err(TryLockError::WouldBlock) => {
            Err(at(folder)(&"another service keeps its models and sessions here; give each a --data of its own"))
        }
        // Some network file systems have no locks.
        Err(TryLockError::Error(error)) => {
            warn(folder, &format!("cannot be locked ({error}), used all the same"));
            Ok(None)
        }
    }
}

/// Whether a folder or file is only readable; it is used all the same.
pub fn is_read_only(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem)
}

/// Opens a file for writing, after a check that it is a regular file and no pipe.
fn file(path: &Path) -> io::Result<File> {
    open_regular(path)?;
    OpenOptions::new().read(true).write(true).open(path)
}

fn of_file(path: &Path) -> Result<Database, DatabaseError> {
    database(FileBackend::new(file(path)?)?)
}

/// Opens the database and reads it once: on damaged pages redb panics, on opening or on the first read.
fn opened(path: &Path) -> Result<RedbStore, FolderError> {
    let again = path.to_path_buf();
    let sound = || -> Result<RedbStore, StoreError> {
        let store = RedbStore::open(move || of_file(&again))?;
        RecordTable::ALL.into_iter().try_for_each(|table| store.list(table).map(drop))?;
        Ok(store)
    };
    let found = catch_unwind(AssertUnwindSafe(sound));
    let found = found.unwrap_or_else(|_| Err(StoreError::Failed("it is damaged".into())));
    found.map_err(|error| {
        at(path)(&format!("{error}; keep a copy of it, and start with another --data to go on without it"))
    })
}

/// Creates a database under another name and renames it when it is complete, with all that the folder had.
fn made(
    folder: &Path,
    import: impl Fn(&Path) -> io::Result<(usize, Transaction)>,
) -> Result<Box<dyn Store>, FolderError> {
    let (path, new, models) = (folder.join(FILE), folder.join(FILE_NEW), folder.join(MODELS));
    let found = if models.is_dir() { Some(import(&models).map_err(|error| at(&models)(&error))?) } else { None };
    match replaced(&new) {
        Ok(_) => {}
        Err(error) if is_read_only(&error) => {
            let records = MemoryStore::default();
            if let Some((_, transaction)) = &found {
                records.commit(transaction).map_err(|error| at(&models)(&error))?;
            }
            return Ok(Box::new(refusing(folder, records, &error)));
        }
        Err(error) => return Err(at(&new)(&error)),
    }
    {
        let store = opened(&new)?;
        if let Some((_, transaction)) = &found {
            store.commit(transaction).map_err(|error| at(&new)(&error))?;
        }
    }
    let name = || -> io::Result<()> {
        fs::rename(&new, &path)?;
        File::open(folder)?.sync_all()
    };
    name().map_err(|error| at(&path)(&error))?;
    if let Some((count, _)) = found.filter(|(count, _)| *count > 0) {
        warn(&models, &format!("{count} models are now kept in {FILE} beside it; this folder is not read any more"));
    }
    Ok(Box::new(opened(&path)?))
}

/// Replaces whatever is at `path` by an empty file, without opening it: it may be a pipe or a link.
fn replaced(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)
}

/// Loads the records of a database that cannot be written to.
fn read(path: &Path, why: &io::Error) -> Result<ReadOnlyStore, FolderError> {
    let bytes = read_regular(path, FILE_BYTES_MAX).map_err(|error| at(path)(&error))?;
    let copy = InMemoryBackend::new();
    let fill = || -> io::Result<()> {
        copy.set_len(bytes.len() as u64)?;
        copy.write(0, &bytes)
    };
    fill().map_err(|error| at(path)(&error))?;
    let copy = std::sync::Mutex::new(Some(copy));
    let take = move || {
        let copy = copy.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        database(copy.ok_or_else(|| io::Error::other("it was read before"))?)
    };
    let whole = || -> Result<MemoryStore, StoreError> {
        let store = RedbStore::open(take)?;
        let mut records = Vec::new();
        for table in RecordTable::ALL {
            records.extend(store.list(table)?.into_iter().map(|(key, record)| (table, key, record)));
        }
        Ok(MemoryStore::of(records))
    };
    Ok(refusing(path, whole().map_err(|error| at(path)(&error))?, why))
}

fn refusing(path: &Path, records: MemoryStore, why: &io::Error) -> ReadOnlyStore {
    let reason = format!("the data folder cannot be written to: {why}");
    warn(path, &format!("cannot be written to, so what is put will be refused: {why}"));
    ReadOnlyStore { records, reason }
}

/// Logs a message about a path.
pub fn warn(path: &Path, what: &str) {
    tracing::warn!("{}: {what}", path.display());
}

impl Store for Folder {
    fn get(&self, table: RecordTable, key: &str) -> Result<Option<Record>, StoreError> {
        self.store.get(table, key)
    }

    fn list(&self, table: RecordTable) -> Result<Vec<(String, Record)>, StoreError> {
        self.store.list(table)
    }

    fn commit(&self, transaction: &Transaction) -> Result<u64, StoreError> {
        self.store.commit(transaction)
    }
}
