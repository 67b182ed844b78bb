//! `RecordingFolder`: the one folder in which recordings are written, and from which they are served.
//!
//! Clients reach only files in that folder: names are restricted to a few characters, and links are not followed. A file being
//! written ends in `.part.mcap` and is locked by its writer. Its [`TenantSpace`] limits the bytes.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{Error, ErrorKind};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::http::StatusCode;
use isophote_capture::ReadableFolder;
use isophote_capture::record::{MendedFile, mend};
use isophote_wire::{RecordedFile, RecordedTable};
use rustix::fs::{FlockOperation, OFlags, flock};

use super::space::{RecordingSpace, SpaceFault, TenantSpace};
use crate::problem::Problem;

/// Upper bound of a new file's bytes.
const BEGIN_BYTES: u64 = 64 << 10;
const END: &str = ".mcap";
const PART: &str = ".part.mcap";
const TABLE: &str = ".csv";

/// The name of a file in the folder, `[a-z0-9][a-z0-9-]*.mcap`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileName(String);

impl FileName {
    /// Parses a name of that form.
    pub fn parse(text: &str) -> Option<FileName> {
        let stem = text.strip_suffix(END)?;
        let is_plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        let is_name = (1..=120).contains(&stem.len()) && !stem.starts_with('-') && stem.bytes().all(is_plain);
        is_name.then(|| FileName(text.to_string()))
    }

    /// The number-th file of a recording.
    pub fn of(stem: &str, number: u32) -> Option<FileName> {
        FileName::parse(&format!("{stem}-{number:04}{END}"))
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn stem(&self) -> &str {
        self.0.trim_end_matches(END)
    }

    /// Name of the CSV file beside it.
    fn table(&self) -> String {
        format!("{}{TABLE}", self.stem())
    }

    /// Whether `file` is this file's `.part.mcap` or its CSV file.
    pub fn is_of(&self, file: &str) -> bool {
        file.strip_prefix(self.stem()).is_some_and(|end| end == PART || end == TABLE)
    }
}

/// A file to be served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WantedFile {
    /// A recording.
    Recording(FileName),
    /// The CSV file of estimates beside that recording.
    Table(FileName),
}

impl WantedFile {
    /// Parses a file name.
    pub fn parse(text: &str) -> Option<WantedFile> {
        match text.strip_suffix(TABLE) {
            Some(stem) => FileName::parse(&format!("{stem}{END}")).map(WantedFile::Table),
            None => FileName::parse(text).map(WantedFile::Recording),
        }
    }

    fn recording(&self) -> &FileName {
        let (WantedFile::Recording(name) | WantedFile::Table(name)) = self;
        name
    }

    fn file(&self) -> String {
        match self {
            WantedFile::Recording(name) => name.0.clone(),
            WantedFile::Table(name) => name.table(),
        }
    }
}

/// Why a file cannot be opened or written.
#[derive(Debug)]
pub enum FolderFault {
    /// The service was started without a folder for recordings.
    None,
    /// A recording of that name exists.
    Taken(String),
    /// There is no file of that name.
    Missing(String),
    /// It is served only after the recording has ended.
    Unfinished,
    /// It is being written.
    Open,
    /// A bound on the bytes of recordings is reached.
    Full(SpaceFault),
    /// The disk failed.
    Disk(Error),
}

impl From<Error> for FolderFault {
    fn from(error: Error) -> FolderFault {
        FolderFault::Disk(error)
    }
}

impl FolderFault {
    /// The response to the client.
    pub fn problem(self) -> Problem {
        match self {
            FolderFault::None => {
                let detail = "this service has no folder for recordings: start it with --recordings DIR or --data DIR";
                Problem::conflict("not-applicable", detail)
            }
            FolderFault::Taken(name) => {
                Problem::conflict("in-use", format!("there is a recording {name}; take another name"))
            }
            FolderFault::Missing(file) => Problem::unknown("recording", &file),
            FolderFault::Unfinished => {
                let detail = "the file is being written; it is there when the recording has ended";
                Problem::new(StatusCode::NOT_FOUND, "unknown-name", detail)
            }
            FolderFault::Full(fault @ SpaceFault::Free { .. }) => {
                Problem::new(StatusCode::INSUFFICIENT_STORAGE, "storage", fault.to_string())
            }
            FolderFault::Full(fault) => Problem::new(StatusCode::TOO_MANY_REQUESTS, "over-limit", fault.to_string()),
            FolderFault::Open => Problem::conflict("in-use", "the file is being written; end the recording first"),
            FolderFault::Disk(error) => {
                let detail = format!("the folder of recordings cannot be written or read: {error}");
                Problem::new(StatusCode::INSUFFICIENT_STORAGE, "storage", detail)
            }
        }
    }
}

/// The folder of one tenant's recordings.
#[derive(Clone)]
pub struct RecordingFolder {
    path: Option<PathBuf>,
    space: Arc<TenantSpace>,
}

impl RecordingFolder {
    /// `recorded` in the operator's folder of recordings, else `recordings` in the data folder.
    pub fn of(recordings: Option<&Path>, data: Option<&Path>, space: &Arc<RecordingSpace>) -> RecordingFolder {
        let path = recordings.map(|folder| folder.join("recorded")).or(data.map(|folder| folder.join("recordings")));
        RecordingFolder::at(path, space)
    }

    /// That folder, or none, with its part of `space`.
    pub fn at(path: Option<PathBuf>, space: &Arc<RecordingSpace>) -> RecordingFolder {
        RecordingFolder { path, space: space.part() }
    }

    /// Bytes of all its files.
    pub fn bytes(&self) -> u64 {
        self.space.bytes()
    }

    /// Grants an open file of `written` bytes `more` bytes; returns the length up to which it may grow.
    pub fn grow(&self, name: &FileName, written: u64, more: u64) -> Result<u64, FolderFault> {
        self.space.grow(self.path()?, name, written, more)?.map_err(FolderFault::Full)
    }

    fn path(&self) -> Result<&Path, FolderFault> {
        self.path.as_deref().ok_or(FolderFault::None)
    }

    /// Creates the file of that name, and the folder if it is missing.
    pub fn begin(&self, name: &FileName) -> Result<File, FolderFault> {
        let folder = self.path()?;
        fs::create_dir_all(folder)?;
        if fs::symlink_metadata(folder.join(&name.0)).is_ok() {
            return Err(FolderFault::Taken(name.0.clone()));
        }
        let part = self.part(folder, name);
        if fs::symlink_metadata(&part).is_ok() {
            return Err(FolderFault::Taken(name.0.clone())); // its writer has claimed its bytes
        }
        let make = || {
            let file = OpenOptions::new().read(true).write(true).create_new(true).mode(0o640).open(part)?;
            flock(&file, FlockOperation::NonBlockingLockExclusive)?;
            Ok(file)
        };
        self.space.count(folder)?;
        let made = self.grow(name, 0, BEGIN_BYTES).and_then(|_| {
            make().map_err(|error: Error| match error.kind() {
                ErrorKind::AlreadyExists => FolderFault::Taken(name.0.clone()),
                _ => FolderFault::Disk(error),
            })
        });
        made.inspect_err(|_| drop(self.space.ended(folder, name)))
    }

    fn part(&self, folder: &Path, name: &FileName) -> PathBuf {
        folder.join(format!("{}{PART}", name.stem()))
    }

    /// Renames a finished file to its final name.
    pub fn finish(&self, name: &FileName) -> Result<(), FolderFault> {
        let folder = self.path()?;
        fs::rename(self.part(folder, name), folder.join(&name.0))?;
        self.space.ended(folder, name)?;
        Ok(File::open(folder)?.sync_all()?)
    }

    /// Keeps the readable part of a file that could not be finished.
    pub fn give_up(&self, name: &FileName) -> Result<MendedFile, FolderFault> {
        let part = self.part(self.path()?, name);
        let mended = mend(&part)?;
        match mended {
            MendedFile::Empty => {
                fs::remove_file(part)?;
                self.remove_table(name)?;
                self.space.ended(self.path()?, name)?;
            }
            MendedFile::Mended { .. } | MendedFile::Whole => self.finish(name)?,
        }
        Ok(mended)
    }

    /// Finished recordings, sorted by name, with their CSV files.
    pub fn list(&self) -> Result<Vec<RecordedFile>, FolderFault> {
        let folder = self.path()?;
        let mut files = Vec::new();
        for name in self.names(folder, END)? {
            let about = fs::symlink_metadata(folder.join(&name.0));
            let Some(about) = about.ok().filter(Metadata::is_file) else { continue };
            let file = name.table();
            let table = fs::symlink_metadata(folder.join(&file)).ok().filter(Metadata::is_file);
            let csv = table.map(|table| RecordedTable { file, bytes: table.len() });
            files.push(RecordedFile { file: name.0, bytes: about.len(), csv });
        }
        files.sort_by(|one, other| one.file.cmp(&other.file));
        Ok(files)
    }

    /// Names of files with that suffix; none if there is no folder yet.
    fn names(&self, folder: &Path, end: &str) -> Result<Vec<FileName>, FolderFault> {
        let entries = match fs::read_dir(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let name =
            |entry: fs::DirEntry| FileName::parse(&format!("{}{END}", entry.file_name().to_str()?.strip_suffix(end)?));
        Ok(entries.filter_map(Result::ok).filter_map(name).collect())
    }

    /// Opens a finished file for reading.
    pub fn open(&self, wanted: &WantedFile) -> Result<(File, Metadata), FolderFault> {
        let path = self.finished(wanted).map_err(|fault| match fault {
            FolderFault::Open => FolderFault::Unfinished,
            fault => fault,
        })?;
        let no_link = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
        let file = OpenOptions::new().read(true).custom_flags(no_link).open(path);
        let missing = || FolderFault::Missing(wanted.file());
        let file = file.map_err(|_| missing())?;
        let about = file.metadata()?;
        if about.is_file() { Ok((file, about)) } else { Err(missing()) }
    }

    /// Resolves the name of a finished recording to this folder, before any other folder with a file of that name.
    pub fn reach(&self, path: &str) -> Option<ReadableFolder> {
        let wanted = WantedFile::Recording(FileName::parse(path)?);
        self.open(&wanted).ok()?;
        ReadableFolder::below(self.path().ok()?).ok()
    }

    /// Metadata of a file that may be deleted.
    pub fn about(&self, wanted: &WantedFile) -> Result<Metadata, FolderFault> {
        fs::symlink_metadata(self.finished(wanted)?).map_err(|_| FolderFault::Missing(wanted.file()))
    }

    /// Deletes a finished file; with a recording, its CSV file.
    pub fn remove(&self, wanted: &WantedFile) -> Result<(), FolderFault> {
        fs::remove_file(self.finished(wanted)?).map_err(|error| match error.kind() {
            ErrorKind::NotFound => FolderFault::Missing(wanted.file()),
            _ => FolderFault::Disk(error),
        })?;
        if let WantedFile::Recording(name) = wanted {
            self.remove_table(name)?;
        }
        Ok(self.space.count(self.path()?)?)
    }

    /// The path of a file, unless it is being written.
    fn finished(&self, wanted: &WantedFile) -> Result<PathBuf, FolderFault> {
        let (folder, name) = (self.path()?, wanted.recording());
        if fs::symlink_metadata(self.part(folder, name)).is_ok() {
            return Err(FolderFault::Open);
        }
        Ok(folder.join(wanted.file()))
    }

    /// Removes the CSV file, if there is one.
    fn remove_table(&self, name: &FileName) -> Result<(), FolderFault> {
        drop(fs::remove_file(self.path()?.join(name.table())));
        Ok(())
    }

    /// Creates the CSV file beside that recording.
    pub fn table(&self, name: &FileName) -> Result<File, FolderFault> {
        let path = self.path()?.join(name.table());
        // The name is new; an existing table was left by a recording that never began.
        let no_link = OFlags::NOFOLLOW.bits() as i32;
        Ok(OpenOptions::new().write(true).create(true).truncate(true).mode(0o640).custom_flags(no_link).open(path)?)
    }

    /// After a start: repairs files that a killed service left, skips those locked by another writer, and counts all.
    pub fn mend_all(&self) {
        let Ok(folder) = self.path() else { return };
        for name in self.names(folder, PART).unwrap_or_default() {
            let file = name.as_str();
            let no_link = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
            let opened = OpenOptions::new().read(true).custom_flags(no_link).open(self.part(folder, &name));
            let lock = opened.and_then(|file| {
                if !file.metadata()?.is_file() {
                    return Err(Error::from(ErrorKind::InvalidInput));
                }
                flock(&file, FlockOperation::NonBlockingLockExclusive)?;
                Ok(file)
            });
            let Ok(_held) = lock else { continue };
            match self.give_up(&name) {
                Ok(MendedFile::Mended { messages, lost_bytes }) => {
                    tracing::info!(file, messages, lost_bytes, "a recording that was cut off has its end");
                }
                Ok(MendedFile::Whole) => tracing::info!(file, "a recording that was whole has its name"),
                Ok(MendedFile::Empty) => tracing::info!(file, "a recording in which nothing was written is gone"),
                Err(fault) => tracing::warn!(file, ?fault, "a recording that was cut off is left as it is"),
            }
        }
        if let Err(error) = self.space.count(folder) {
            tracing::warn!(%error, "the recordings that are there cannot be counted yet");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_validated() {
        for good in ["a.mcap", "demo-12-1700000000-0001.mcap", "0-.mcap"] {
            assert!(FileName::parse(good).is_some(), "{good}");
        }
        let long = format!("{}.mcap", "a".repeat(121));
        for bad in [
            "",
            ".mcap",
            "-a.mcap",
            "a",
            "a.part.mcap",
            "../a.mcap",
            "a/b.mcap",
            "A.mcap",
            "a.mcap\0",
            "ä.mcap",
            "%2e.mcap",
            &long,
        ] {
            assert!(FileName::parse(bad).is_none(), "{bad}");
        }
    }
}
