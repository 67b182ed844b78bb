//! `RecordingFolder`: the one folder in which recordings are written, and from which they are handed out.
//!
//! What comes in: the operator's folder, names of files. What goes out: files below that folder and nowhere else: names are a few
//! letters, and links are not followed. A file that is being written ends in `.part.mcap`, and whoever writes it holds its lock.
//! How many bytes there may be in it, its [`TenantSpace`] says.

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

/// Bytes that a file has at its beginning, at most.
const BEGIN_BYTES: u64 = 64 << 10;
const END: &str = ".mcap";
const PART: &str = ".part.mcap";
const TABLE: &str = ".csv";

/// The name of a file in the folder, `[a-z0-9][a-z0-9-]*.mcap`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileName(String);

impl FileName {
    /// Of that form only.
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

    /// The name of the table beside it.
    fn table(&self) -> String {
        format!("{}{TABLE}", self.stem())
    }

    /// Whether a file of that name is this one while it is written, or its table.
    pub fn is_of(&self, file: &str) -> bool {
        file.strip_prefix(self.stem()).is_some_and(|end| end == PART || end == TABLE)
    }
}

/// A file that is handed out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WantedFile {
    /// A recording.
    Recording(FileName),
    /// The CSV file of estimates beside that recording.
    Table(FileName),
}

impl WantedFile {
    /// By the name of the file.
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

/// Why there is no file.
#[derive(Debug)]
pub enum FolderFault {
    /// The service was started without a folder for recordings.
    None,
    /// There is one of that name.
    Taken(String),
    /// There is no file of that name.
    Missing(String),
    /// It is not there before the recording has ended.
    Unfinished,
    /// It is being written.
    Open,
    /// There may be no more of them.
    Full(SpaceFault),
    /// The disk.
    Disk(Error),
}

impl From<Error> for FolderFault {
    fn from(error: Error) -> FolderFault {
        FolderFault::Disk(error)
    }
}

impl FolderFault {
    /// For whoever asked.
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

/// See the text above.
#[derive(Clone)]
pub struct RecordingFolder {
    path: Option<PathBuf>,
    space: Arc<TenantSpace>,
}

impl RecordingFolder {
    /// Below the operator's folder of recordings, else below the one where everything is kept.
    pub fn of(recordings: Option<&Path>, data: Option<&Path>, space: &Arc<RecordingSpace>) -> RecordingFolder {
        let path = recordings.map(|folder| folder.join("recorded")).or(data.map(|folder| folder.join("recordings")));
        RecordingFolder::at(path, space)
    }

    /// That one, or none, with a part of that space.
    pub fn at(path: Option<PathBuf>, space: &Arc<RecordingSpace>) -> RecordingFolder {
        RecordingFolder { path, space: space.part() }
    }

    /// Bytes of all its files.
    pub fn bytes(&self) -> u64 {
        self.space.bytes()
    }

    /// An open file, which has so many bytes on the disk, may get so many more: the length up to which it may grow.
    pub fn grow(&self, name: &FileName, written: u64, more: u64) -> Result<u64, FolderFault> {
        self.space.grow(self.path()?, name, written, more)?.map_err(FolderFault::Full)
    }

    fn path(&self) -> Result<&Path, FolderFault> {
        self.path.as_deref().ok_or(FolderFault::None)
    }

    /// Begins the file of that name; the folder is made where there is none.
    pub fn begin(&self, name: &FileName) -> Result<File, FolderFault> {
        let folder = self.path()?;
        fs::create_dir_all(folder)?;
        if fs::symlink_metadata(folder.join(&name.0)).is_ok() {
            return Err(FolderFault::Taken(name.0.clone()));
        }
        let part = self.part(folder, name);
        if fs::symlink_metadata(&part).is_ok() {
            return Err(FolderFault::Taken(name.0.clone())); // who writes it has claimed its bytes
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

    /// A file that has its end gets its name.
    pub fn finish(&self, name: &FileName) -> Result<(), FolderFault> {
        let folder = self.path()?;
        fs::rename(self.part(folder, name), folder.join(&name.0))?;
        self.space.ended(folder, name)?;
        Ok(File::open(folder)?.sync_all()?)
    }

    /// A file that could not be written to its end: what is whole of it is kept.
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

    /// The recordings that are finished, by name, with the tables beside them.
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

    /// Names of files with that end; none where there is no folder yet.
    fn names(&self, folder: &Path, end: &str) -> Result<Vec<FileName>, FolderFault> {
        let entries = match fs::read_dir(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let name =
            |entry: fs::DirEntry| FileName::parse(&format!("{}{END}", entry.file_name().to_str()?.strip_suffix(end)?));
        Ok(entries.filter_map(Result::ok).filter_map(name).collect())
    }

    /// A finished file, to be read.
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

    /// Where paths lead that are the name of a finished recording of this folder, whatever other folders have one of that name.
    pub fn reach(&self, path: &str) -> Option<ReadableFolder> {
        let wanted = WantedFile::Recording(FileName::parse(path)?);
        self.open(&wanted).ok()?;
        ReadableFolder::below(self.path().ok()?).ok()
    }

    /// Metadata of a file that may be deleted.
    pub fn about(&self, wanted: &WantedFile) -> Result<Metadata, FolderFault> {
        fs::symlink_metadata(self.finished(wanted)?).map_err(|_| FolderFault::Missing(wanted.file()))
    }

    /// Deletes a finished file; with a recording goes the table beside it.
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

    /// Most files have none.
    fn remove_table(&self, name: &FileName) -> Result<(), FolderFault> {
        drop(fs::remove_file(self.path()?.join(name.table())));
        Ok(())
    }

    /// The file of estimates beside that one.
    pub fn table(&self, name: &FileName) -> Result<File, FolderFault> {
        let path = self.path()?.join(name.table());
        // The name is new; a table that is there was left by a recording that never began.
        let no_link = OFlags::NOFOLLOW.bits() as i32;
        Ok(OpenOptions::new().write(true).create(true).truncate(true).mode(0o640).custom_flags(no_link).open(path)?)
    }

    /// After a start: files that a killed service left get their end; those that another one is writing are left alone. All are
    /// counted.
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
    fn names_are_names_and_nothing_else() {
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
