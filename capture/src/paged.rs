//! Multi-picture files, read one page at a time, so that a recording of many pages takes the memory of one.

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::clock::Stamp;
use crate::files::{Content, Format, Open, PageFault, Pages, extensions_with_topics, format_of_signature};
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture};
use crate::regular::ReadableFolder;
use crate::source::SourceError;

/// A file or folder, with the topic behind a `#` for files with several.
#[derive(Clone, Debug)]
pub(crate) struct Address {
    pub path: PathBuf,
    pub topic: Option<String>,
    /// Folder that it must be in.
    pub reach: ReadableFolder,
}

impl Address {
    /// Splits off the topic. An existing file whose name contains the `#` is that file.
    pub fn of(path: &Path, reach: ReadableFolder) -> Address {
        let text = path.to_str().filter(|_| !path.exists()).unwrap_or_default();
        let small = text.to_ascii_lowercase();
        let found = extensions_with_topics().find_map(|extension| {
            let end = format!(".{extension}#");
            small.find(&end).map(|at| text.split_at(at + end.len()))
        });
        match found {
            Some((file, topic)) => {
                Address { path: file.trim_end_matches('#').into(), topic: Some(topic.into()), reach }
            }
            None => Address::of_entry(path.to_path_buf(), &reach),
        }
    }

    /// An entry of a folder.
    pub fn of_entry(path: PathBuf, reach: &ReadableFolder) -> Address {
        Address { path, topic: None, reach: reach.clone() }
    }
}

/// Longer than any signature.
const SIGNATURE_BYTES_MAX: u64 = 64;

/// A multi-picture file.
pub(crate) struct Paged {
    pub path: PathBuf,
    reach: ReadableFolder,
    format: &'static Format,
    open: Open,
    words: [&'static str; 2],
    /// Selected topic, for formats with several.
    topic: Option<String>,
    /// Number of pages.
    pub pages: usize,
    /// Pages per volume, if the file is a series of volumes.
    pub volume: Option<usize>,
    /// The reader opened to count the pages, kept for the first read: indexing a file may require decompression.
    kept: Mutex<Option<Box<dyn Pages>>>,
}

impl std::fmt::Debug for Paged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Paged { path, format, topic, pages, volume, .. } = self;
        f.debug_tuple("Paged").field(path).field(&format.name).field(topic).field(pages).field(volume).finish()
    }
}

impl Paged {
    /// Opens a file and counts its pages.
    pub fn of(address: Address, format: &'static Format) -> Result<Paged, SourceError> {
        let Address { path, topic, reach } = address;
        let Content::Pages { words, open, .. } = format.content else {
            return Err(DecodeError::UnknownKind.in_file(&path));
        };
        let mut file =
            Paged { path, reach, format, open, words, topic, pages: 0, volume: None, kept: Mutex::default() };
        match file.open().and_then(|mut open| Ok((open.count(LIMITS.files)?, open.volume(), open))) {
            Err(PageFault::Wrong(DecodeError::UnknownKind)) => return Err(file.misnamed(&[]).in_file(&file.path)),
            // If the chain of pages is broken, their number is unknown.
            Err(fault) => return Err(fault.in_file(&file.path)),
            Ok((0, ..)) => return Err(DecodeError::Damaged("there is no picture in it".into()).in_file(&file.path)),
            Ok((pages, volume, open)) => (file.pages, file.volume, file.kept) = (pages, volume, Mutex::new(Some(open))),
        }
        if file.pages > LIMITS.files { Err(SourceError::too_many(&file.path)) } else { Ok(file) }
    }

    /// The error for a file of another format, which it names.
    fn misnamed(&self, begin: &[u8]) -> DecodeError {
        let extension = self.path.extension().unwrap_or_default().display();
        let other = format_of_signature(begin).map(|name| format!("; it begins like a {name} file, so rename it"));
        let reason = format!("it is named .{extension} but does not begin like one{}", other.unwrap_or_default());
        DecodeError::Unsupported(reason)
    }

    fn kept(&self) -> MutexGuard<'_, Option<Box<dyn Pages>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Closes the kept reader, to limit the open file descriptors of a recording with many files.
    pub fn close(&self) {
        *self.kept() = None;
    }

    fn open(&self) -> Result<Box<dyn Pages>, PageFault> {
        let mut begin = Vec::new();
        let mut file = self.reach.open(&self.path)?;
        (&mut file).take(SIGNATURE_BYTES_MAX).read_to_end(&mut begin)?;
        if !self.format.matches_signature(&begin) {
            return Err(self.misnamed(&begin).into());
        }
        file.rewind()?;
        (self.open)(file, self.topic.as_deref())
    }

    /// Description for messages.
    pub fn what(&self) -> String {
        let [file, pages] = self.words;
        match self.volume {
            _ if self.pages == 1 => "one picture".into(),
            Some(volume) => format!("{file} of {} volumes of {volume} {pages}", self.pages / volume.max(1)),
            None => format!("{file} of {} {pages}", self.pages),
        }
    }

    /// The file name, followed by the page's number if there are several.
    pub fn name_of(&self, page: usize) -> String {
        let name = self.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if self.pages == 1 { name } else { format!("{name}#{page}") }
    }

    /// Width and height of a page.
    pub fn size(&self, page: usize) -> Option<[usize; 2]> {
        match &mut *self.kept() {
            Some(open) => open.size(page).ok(),
            None => self.open().ok()?.size(page).ok(),
        }
    }
}

/// Reads pages and keeps the file open for the next one.
pub(crate) struct OpenFile {
    /// Folder that files must be in.
    pub reach: ReadableFolder,
    open: Option<(Arc<Paged>, Box<dyn Pages>)>,
    /// The last read failed: reopen the file, since it may have been replaced.
    has_failed: bool,
}

impl std::fmt::Debug for OpenFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("OpenFile").field(&self.open.as_ref().map(|(file, _)| file)).finish()
    }
}

impl OpenFile {
    /// Starts without an open file.
    pub fn new(reach: ReadableFolder) -> OpenFile {
        OpenFile { reach, open: None, has_failed: false }
    }

    /// The pixels of a page, from 0.
    pub fn picture(&mut self, file: &Arc<Paged>, page: usize) -> Result<StoredPicture, SourceError> {
        let has_failed = std::mem::take(&mut self.has_failed);
        let known = self.open.take().filter(|(known, _)| Arc::ptr_eq(known, file) && !has_failed);
        let known = known.map(|(_, pages)| pages).or_else(|| file.kept().take());
        let pages = known.map_or_else(|| file.open(), Ok).map_err(|fault| fault.in_file(&file.path))?;
        let (_, pages) = self.open.insert((file.clone(), pages));
        let picture = pages.picture(page).map_err(|fault| fault.in_file(&file.path));
        self.has_failed = picture.is_err();
        picture
    }

    /// Time stamp of a page of the currently open file, if it has one.
    pub fn stamp(&self, file: &Arc<Paged>, page: usize) -> Option<Stamp> {
        let (_, pages) = self.open.as_ref().filter(|(known, _)| Arc::ptr_eq(known, file))?;
        pages.stamp(page)
    }
}
