//! `--models DIR`: model documents, each named by its file.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use isophote_capture::read_regular;

use super::entry::Media;
use crate::limits::LIMITS;
use crate::name::Name;

/// A file that may be a model's document.
pub struct ModelFile {
    /// Its path.
    pub path: PathBuf,
    /// Its media type, by extension.
    pub media: Media,
}

/// The files of a folder that end in `.toml` or `.json`, in name order.
///
/// # Errors
/// The folder cannot be read.
pub fn models_in(folder: &Path) -> io::Result<Vec<ModelFile>> {
    let mut paths: Vec<_> = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
    paths.sort();
    let file = |path: PathBuf| match path.extension().and_then(|extension| extension.to_str()) {
        Some("toml") => Some(ModelFile { path, media: Media::Toml }),
        Some("json") => Some(ModelFile { path, media: Media::Json }),
        _ => None,
    };
    Ok(paths.into_iter().filter_map(file).collect())
}

impl ModelFile {
    /// The model's name and the text of its document.
    ///
    /// # Errors
    /// Why it cannot be one.
    pub fn read(&self) -> Result<(Name, String), String> {
        let stem = self.path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let name = Name::parse(stem).ok_or("the name of a model is made of a-z, 0-9 and -")?;
        let bytes = read_regular(&self.path, LIMITS.document_bytes as u64).map_err(|error| error.to_string())?;
        Ok((name, String::from_utf8(bytes).map_err(|_| "it is not UTF-8")?))
    }
}
