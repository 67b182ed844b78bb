//! Models on disk: one file each, written beside and renamed, so that a name has the old document or the new one.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use axum::http::StatusCode;
use isophote_capture::read_regular;
use serde::{Deserialize, Serialize};

use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::Media;

/// What a file holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// Counts the documents put under this name.
    pub version: u64,
    /// How it was sent.
    pub media: Media,
    /// As it was sent.
    pub text: String,
}

/// The disk failed.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct StoreError {
    path: PathBuf,
    reason: io::Error,
}

impl StoreError {
    fn at(path: &Path) -> impl FnOnce(io::Error) -> StoreError {
        move |reason| StoreError { path: path.to_path_buf(), reason }
    }

    /// 507: nothing was changed.
    pub fn problem(self) -> Problem {
        Problem::new(StatusCode::INSUFFICIENT_STORAGE, "storage", format!("not stored, nothing was changed: {self}"))
    }
}

/// Bytes of a stored model: its document, every character of it escaped, and what stands around it.
const FILE_BYTES_MAX: u64 = 8 * LIMITS.document_bytes as u64;

/// `DIR/models`, of one service at a time.
pub struct Store {
    folder: PathBuf,
    /// Locked for as long as it is open, also against services of other processes.
    _lock: File,
}

/// What a folder holds.
#[derive(Debug, Default, PartialEq)]
pub struct Loaded {
    /// Documents by name.
    pub models: Vec<(Name, Stored)>,
    /// Shipped models that were removed.
    pub removed: Vec<Name>,
}

impl Store {
    /// Makes the folder when it is missing, takes it for itself, and sweeps what a crash left behind. A folder that cannot be
    /// written to is said and read all the same: what is put is refused then, one by one.
    pub fn open(data: &Path) -> Result<Store, StoreError> {
        let folder = data.join("models");
        fs::create_dir_all(&folder).map_err(StoreError::at(&folder))?;
        let lock = File::open(&folder).map_err(StoreError::at(&folder))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let reason = io::Error::other("another service keeps its models here; give each a --data of its own");
                return Err(StoreError { path: folder, reason });
            }
            // Some network drives have no locks.
            Err(TryLockError::Error(error)) => said(&folder, &format!("cannot be locked ({error}), used all the same")),
        }
        for entry in fs::read_dir(&folder).map_err(StoreError::at(&folder))? {
            let path = entry.map_err(StoreError::at(&folder))?.path();
            if path.extension().is_some_and(|extension| extension == "new")
                && let Err(error) = fs::remove_file(&path)
            {
                said(&path, &format!("left over from a save, and cannot be removed: {error}"));
            }
        }
        let store = Store { folder, _lock: lock };
        let probe = store.folder.join("writable.new");
        if let Err(error) = replaced(&probe).and_then(|_| fs::remove_file(&probe)) {
            said(&store.folder, &format!("cannot be written to, so models that are put will be refused: {error}"));
        }
        Ok(store)
    }

    /// Everything that is stored. What is no file of ours, or cannot be read, is reported and left alone.
    pub fn load(&self) -> Result<Loaded, StoreError> {
        let mut loaded = Loaded::default();
        for entry in fs::read_dir(&self.folder).map_err(StoreError::at(&self.folder))? {
            let path = entry.map_err(StoreError::at(&self.folder))?.path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
            match (Name::parse(stem), extension) {
                (Some(name), "removed") => loaded.removed.push(name),
                (Some(name), "json") => match read(&path) {
                    Ok(stored) => loaded.models.push((name, stored)),
                    Err(error) => said(&path, &format!("not a stored model, left alone: {error}")),
                },
                (_, "new") => {} // said before
                _ => said(&path, "not a stored model, left alone"),
            }
        }
        Ok(loaded)
    }

    /// Writes a model: when this returns it survives a crash.
    pub fn save(&self, name: &Name, stored: &Stored) -> Result<(), StoreError> {
        let path = self.path(name);
        let new = path.with_extension("new");
        let write = || {
            let mut file = replaced(&new)?;
            file.write_all(&serde_json::to_vec_pretty(stored)?)?;
            file.sync_all()?;
            fs::rename(&new, &path)?;
            absent(&self.mark(name))?;
            File::open(&self.folder)?.sync_all()
        };
        write().map_err(|reason| {
            // Nothing of it stays; if not even that can be done, the next start does it.
            fs::remove_file(&new).ok();
            StoreError { path, reason }
        })
    }

    /// Forgets a model.
    pub fn remove(&self, name: &Name) -> Result<(), StoreError> {
        let path = self.path(name);
        let forget = || {
            absent(&path)?;
            File::open(&self.folder)?.sync_all()
        };
        forget().map_err(StoreError::at(&path))
    }

    /// Forgets a model that is shipped, and marks that it is to stay away.
    pub fn remove_shipped(&self, name: &Name) -> Result<(), StoreError> {
        let mark = self.mark(name);
        replaced(&mark).and_then(|file| file.sync_all()).map_err(StoreError::at(&mark))?;
        self.remove(name)
    }

    fn mark(&self, name: &Name) -> PathBuf {
        self.folder.join(format!("{name}.removed"))
    }

    fn path(&self, name: &Name) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }
}

fn said(path: &Path, what: &str) {
    tracing::warn!("{}: {what}", path.display());
}

fn read(path: &Path) -> io::Result<Stored> {
    Ok(serde_json::from_slice(&read_regular(path, FILE_BYTES_MAX)?)?)
}

/// An empty file in the place of whatever was there, which is never opened: it may be a pipe, or a link to somewhere else.
fn replaced(path: &Path) -> io::Result<File> {
    absent(path)?;
    OpenOptions::new().write(true).create_new(true).open(path)
}

fn absent(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        result => result,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_was_saved_is_loaded_and_leftovers_are_swept() {
        let data = std::env::temp_dir().join(format!("isophote-store-{}", std::process::id()));
        let store = Store::open(&data).unwrap();
        let name = Name::parse("a-b").unwrap();
        let stored = Stored { version: 3, media: Media::Toml, text: "name = \"x\" # ü\n".into() };
        store.save(&name, &stored).unwrap();
        fs::write(data.join("models/torn.new"), "{").unwrap();
        assert!(Store::open(&data).is_err_and(|error| error.to_string().contains("another service")));
        drop(store);
        let store = Store::open(&data).unwrap();
        assert!(!data.join("models/torn.new").exists());
        let of = |models, removed| Loaded { models, removed };
        assert_eq!(store.load().unwrap(), of(vec![(name.clone(), stored.clone())], Vec::new()));
        store.remove(&name).unwrap();
        store.remove(&name).unwrap();
        assert_eq!(store.load().unwrap(), Loaded::default());
        store.remove_shipped(&name).unwrap();
        assert_eq!(store.load().unwrap(), of(Vec::new(), vec![name.clone()]));
        store.save(&name, &stored).unwrap();
        assert_eq!(store.load().unwrap(), of(vec![(name, stored)], Vec::new()));
        fs::remove_dir_all(&data).unwrap();
    }

    /// Where the file should go stands a folder: the save fails, and leaves nothing behind.
    #[test]
    fn a_save_that_fails_leaves_nothing() {
        let data = std::env::temp_dir().join(format!("isophote-store-fails-{}", std::process::id()));
        let store = Store::open(&data).unwrap();
        let name = Name::parse("a").unwrap();
        fs::create_dir(data.join("models/a.json")).unwrap();
        fs::write(data.join("models/a.json/file"), "").unwrap();
        let stored = Stored { version: 1, media: Media::Toml, text: String::new() };
        assert!(store.save(&name, &stored).is_err());
        assert!(!data.join("models/a.new").exists());
        assert_eq!(store.load().unwrap(), Loaded::default(), "said, and no reason not to start");
        fs::remove_dir_all(&data).unwrap();
    }
}
