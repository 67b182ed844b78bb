//! Models on disk: one file each, written beside and renamed, so that a name has the old document or the new one.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use axum::http::StatusCode;
use serde::{Deserialize, Serialize};

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

/// `DIR/models`.
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Makes the folder when it is missing and sweeps what a crash left behind.
    pub fn open(data: &Path) -> Result<Store, StoreError> {
        let folder = data.join("models");
        fs::create_dir_all(&folder).map_err(StoreError::at(&folder))?;
        for entry in fs::read_dir(&folder).map_err(StoreError::at(&folder))? {
            let path = entry.map_err(StoreError::at(&folder))?.path();
            if path.extension().is_some_and(|extension| extension == "new") {
                fs::remove_file(&path).map_err(StoreError::at(&path))?;
            }
        }
        Ok(Store { folder })
    }

    /// Everything that is stored. A file that is not ours is reported and left.
    pub fn load(&self) -> Result<Vec<(Name, Stored)>, StoreError> {
        let mut models = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(StoreError::at(&self.folder))? {
            let path = entry.map_err(StoreError::at(&self.folder))?.path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let (Some(name), true) = (Name::parse(stem), path.extension().is_some_and(|e| e == "json")) else {
                eprintln!("isophote: {}: not a stored model, left alone", path.display());
                continue;
            };
            let text = fs::read_to_string(&path).map_err(StoreError::at(&path))?;
            match serde_json::from_str(&text) {
                Ok(stored) => models.push((name, stored)),
                Err(error) => eprintln!("isophote: {}: not a stored model ({error}), left alone", path.display()),
            }
        }
        Ok(models)
    }

    /// Writes a model: when this returns it survives a crash.
    pub fn save(&self, name: &Name, stored: &Stored) -> Result<(), StoreError> {
        let path = self.path(name);
        let new = path.with_extension("new");
        let write = || {
            let mut file = File::create(&new)?;
            file.write_all(&serde_json::to_vec_pretty(stored)?)?;
            file.sync_all()?;
            fs::rename(&new, &path)?;
            File::open(&self.folder)?.sync_all()
        };
        write().map_err(StoreError::at(&path))
    }

    /// Forgets a model; one that was never stored (a shipped one) is forgotten until the next start.
    pub fn remove(&self, name: &Name) -> Result<(), StoreError> {
        let path = self.path(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            result => result.and_then(|()| File::open(&self.folder)?.sync_all()).map_err(StoreError::at(&path)),
        }
    }

    fn path(&self, name: &Name) -> PathBuf {
        self.folder.join(format!("{name}.json"))
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
        let store = Store::open(&data).unwrap();
        assert!(!data.join("models/torn.new").exists());
        assert_eq!(store.load().unwrap(), [(name.clone(), stored)]);
        store.remove(&name).unwrap();
        store.remove(&name).unwrap();
        assert_eq!(store.load().unwrap(), []);
        fs::remove_dir_all(&data).unwrap();
    }
}
