//! Files of several pictures. A path in, its pictures by their number out, read one at a time, so that a recording of many pages
//! costs no more memory than one.

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::clock::Stamp;
use crate::files::{Content, Format, Open, PageFault, Pages, extensions_with_topics, format_begun};
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture};
use crate::regular::ReadableFolder;
use crate::source::SourceError;

/// What a path names: a file or folder, and of a file with several topics the one behind a `#`.
#[derive(Clone, Debug)]
pub(crate) struct Address {
    pub path: PathBuf,
    pub topic: Option<String>,
    /// Where it may be.
    pub reach: ReadableFolder,
}

impl Address {
    /// A file whose own name has the `#` is that file.
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

    /// What a folder holds.
    pub fn of_entry(path: PathBuf, reach: &ReadableFolder) -> Address {
        Address { path, topic: None, reach: reach.clone() }
    }
}

/// More than any signature has.
const SIGNATURE_BYTES_MAX: u64 = 64;

/// A file of several pictures.
pub(crate) struct Paged {
    pub path: PathBuf,
    reach: ReadableFolder,
    format: &'static Format,
    open: Open,
    words: [&'static str; 2],
    /// Whose pictures, where the file has several topics.
    topic: Option<String>,
    /// How many.
    pub pages: usize,
    /// How many of them are a volume, where the file is a series of volumes.
    pub volume: Option<usize>,
    /// As it was opened to count them, for whoever reads first: finding out what is in a file may mean unpacking it.
    kept: Mutex<Option<Box<dyn Pages>>>,
}

impl std::fmt::Debug for Paged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Paged { path, format, topic, pages, volume, .. } = self;
        f.debug_tuple("Paged").field(path).field(&format.name).field(topic).field(pages).field(volume).finish()
    }
}

impl Paged {
    /// Counts the pictures of a file.
    pub fn of(address: Address, format: &'static Format) -> Result<Paged, SourceError> {
        let Address { path, topic, reach } = address;
        let Content::Pages { words, open, .. } = format.content else {
            return Err(DecodeError::UnknownKind.about(&path));
        };
        let mut file =
            Paged { path, reach, format, open, words, topic, pages: 0, volume: None, kept: Mutex::default() };
        match file.open().and_then(|mut open| Ok((open.count(LIMITS.files)?, open.volume(), open))) {
            Err(PageFault::Wrong(DecodeError::UnknownKind)) => return Err(file.misnamed(&[]).about(&file.path)),
            // Where the chain of pages breaks, nobody knows how many there were.
            Err(fault) => return Err(fault.about(&file.path)),
            Ok((0, ..)) => return Err(DecodeError::Damaged("there is no picture in it".into()).about(&file.path)),
            Ok((pages, volume, open)) => (file.pages, file.volume, file.kept) = (pages, volume, Mutex::new(Some(open))),
        }
        if file.pages > LIMITS.files { Err(SourceError::too_many(&file.path)) } else { Ok(file) }
    }

    /// The error for a file of another format names that format.
    fn misnamed(&self, begin: &[u8]) -> DecodeError {
        let extension = self.path.extension().unwrap_or_default().display();
        let other = format_begun(begin).map(|name| format!("; it begins like a {name} file, so rename it"));
        let reason = format!("it is named .{extension} but does not begin like one{}", other.unwrap_or_default());
        DecodeError::Unsupported(reason)
    }

    fn kept(&self) -> MutexGuard<'_, Option<Box<dyn Pages>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Of many files each would take one of the few that a process may have open.
    pub fn close(&self) {
        *self.kept() = None;
    }

    fn open(&self) -> Result<Box<dyn Pages>, PageFault> {
        let mut begin = Vec::new();
        let mut file = self.reach.open(&self.path)?;
        (&mut file).take(SIGNATURE_BYTES_MAX).read_to_end(&mut begin)?;
        if !self.format.begins(&begin) {
            return Err(self.misnamed(&begin).into());
        }
        file.rewind()?;
        (self.open)(file, self.topic.as_deref())
    }

    /// For people.
    pub fn what(&self) -> String {
        let [file, pages] = self.words;
        match self.volume {
            _ if self.pages == 1 => "one picture".into(),
            Some(volume) => format!("{file} of {} volumes of {volume} {pages}", self.pages / volume.max(1)),
            None => format!("{file} of {} {pages}", self.pages),
        }
    }

    /// The file's name; where there are several pictures, with the number of this one behind it.
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

/// Reads pages; the file stays open for the page after it.
pub(crate) struct OpenFile {
    /// Where files may be.
    pub reach: ReadableFolder,
    open: Option<(Arc<Paged>, Box<dyn Pages>)>,
    /// What is open has failed: by the next time another file may be in its place.
    has_failed: bool,
}

impl std::fmt::Debug for OpenFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("OpenFile").field(&self.open.as_ref().map(|(file, _)| file)).finish()
    }
}

impl OpenFile {
    /// Nothing is open yet.
    pub fn new(reach: ReadableFolder) -> OpenFile {
        OpenFile { reach, open: None, has_failed: false }
    }

    /// The pixels of a page, from 0.
    pub fn picture(&mut self, file: &Arc<Paged>, page: usize) -> Result<StoredPicture, SourceError> {
        let has_failed = std::mem::take(&mut self.has_failed);
        let known = self.open.take().filter(|(known, _)| Arc::ptr_eq(known, file) && !has_failed);
        let known = known.map(|(_, pages)| pages).or_else(|| file.kept().take());
        let pages = known.map_or_else(|| file.open(), Ok).map_err(|fault| fault.about(&file.path))?;
        let (_, pages) = self.open.insert((file.clone(), pages));
        let picture = pages.picture(page).map_err(|fault| fault.about(&file.path));
        self.has_failed = picture.is_err();
        picture
    }

    /// When a page of the file that is open was taken, where that tells.
    pub fn stamp(&self, file: &Arc<Paged>, page: usize) -> Option<Stamp> {
        let (_, pages) = self.open.as_ref().filter(|(known, _)| Arc::ptr_eq(known, file))?;
        pages.stamp(page)
    }
}
