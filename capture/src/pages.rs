//! Files of several pictures behind one trait. A path in, its pictures by their number out, read one at a time, so that a
//! recording of many pages costs no more memory than one.
//!
//! A further format is a file with an `impl Pages` and a row in [`Format`].

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::clock::Stamp;
use crate::decode::{DecodeError, Picture};
use crate::fits::Fits;
use crate::limits::LIMITS;
use crate::mcap::Mcap;
use crate::source::SourceError;
use crate::tiff::Tiff;
use crate::y4m::Video;

/// An open file of several pictures.
pub(crate) trait Pages: Send {
    /// How many pictures there are; those beyond `most` are counted as one.
    fn count(&mut self, most: usize) -> Result<usize, PageFault>;

    /// How many pages are a volume, where the file is a series of volumes.
    fn volume(&self) -> Option<usize> {
        None
    }

    /// Width and height of a page, from 0.
    fn size(&mut self, page: usize) -> Result<[usize; 2], PageFault>;

    /// When a page was taken, where the file tells.
    fn stamp(&self, _page: usize) -> Option<Stamp> {
        None
    }

    /// The pixels of a page, from 0. Its size is checked before memory is taken.
    fn picture(&mut self, page: usize) -> Result<Picture, PageFault>;
}

/// Why a file gives no page.
pub(crate) enum PageFault {
    /// The operating system refused.
    Unreadable(std::io::Error),
    /// It is not what it should be.
    Wrong(DecodeError),
}

impl PageFault {
    pub fn about(self, path: &Path) -> SourceError {
        match self {
            PageFault::Unreadable(reason) => SourceError::Unreadable { path: path.into(), reason },
            PageFault::Wrong(error) => error.about(path),
        }
    }
}

impl From<DecodeError> for PageFault {
    fn from(error: DecodeError) -> PageFault {
        PageFault::Wrong(error)
    }
}

impl From<std::io::Error> for PageFault {
    fn from(error: std::io::Error) -> PageFault {
        PageFault::Unreadable(error)
    }
}

/// The formats whose files hold several pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Tiff,
    Fits,
    Y4m,
    Mcap,
}

impl Format {
    /// For people: what the file is called, and what its pictures are.
    fn words(self) -> [&'static str; 2] {
        match self {
            Format::Tiff => ["a TIFF", "pages"],
            Format::Fits => ["a FITS file", "pages"],
            Format::Y4m => ["a Y4M video", "frames"],
            Format::Mcap => ["an MCAP file", "pictures"],
        }
    }
}

/// What a path names: a file or folder, and of an MCAP file the topic behind a `#`.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub path: PathBuf,
    pub topic: Option<String>,
}

impl Place {
    /// A file whose own name has the `#` is that file.
    pub fn of(path: &Path) -> Place {
        const END: &str = ".mcap#";
        let text = path.to_str().filter(|_| !path.exists()).unwrap_or_default();
        match text.to_ascii_lowercase().find(END).map(|at| text.split_at(at + END.len())) {
            Some((file, topic)) => Place { path: file.trim_end_matches('#').into(), topic: Some(topic.into()) },
            None => path.to_path_buf().into(),
        }
    }
}

impl From<PathBuf> for Place {
    fn from(path: PathBuf) -> Place {
        Place { path, topic: None }
    }
}

/// A file of several pictures.
pub(crate) struct Paged {
    pub path: PathBuf,
    format: Format,
    /// Of MCAP: whose pictures.
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
        f.debug_tuple("Paged").field(path).field(format).field(topic).field(pages).field(volume).finish()
    }
}

impl Paged {
    /// Counts the pictures of a file.
    pub fn of(place: Place, format: Format) -> Result<Paged, SourceError> {
        let Place { path, topic } = place;
        let mut file = Paged { path, format, topic, pages: 0, volume: None, kept: Mutex::default() };
        match file.open().and_then(|mut open| Ok((open.count(LIMITS.files)?, open.volume(), open))) {
            // What is another format altogether should not be called by the wrong name alone.
            Err(PageFault::Wrong(DecodeError::UnknownKind)) => {
                let extension = file.path.extension().unwrap_or_default().display().to_string();
                let reason = format!("it is named .{extension} but does not begin like one");
                return Err(DecodeError::Unsupported(reason).about(&file.path));
            }
            // Where the chain of pages breaks, nobody knows how many there were.
            Err(fault) => return Err(fault.about(&file.path)),
            Ok((0, ..)) => return Err(DecodeError::Damaged("there is no picture in it".into()).about(&file.path)),
            Ok((pages, volume, open)) => (file.pages, file.volume, file.kept) = (pages, volume, Mutex::new(Some(open))),
        }
        if file.pages > LIMITS.files { Err(SourceError::too_many(&file.path)) } else { Ok(file) }
    }

    fn kept(&self) -> MutexGuard<'_, Option<Box<dyn Pages>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Of many files each would take one of the few that a process may have open.
    pub fn close(&self) {
        *self.kept() = None;
    }

    fn open(&self) -> Result<Box<dyn Pages>, PageFault> {
        Ok(match self.format {
            Format::Tiff => Box::new(Tiff::open(&self.path)?),
            Format::Fits => Box::new(Fits::open(&self.path)?),
            Format::Y4m => Box::new(Video::open(&self.path)?),
            Format::Mcap => Box::new(Mcap::open(&self.path, self.topic.as_deref())?),
        })
    }

    /// For people.
    pub fn what(&self) -> String {
        let [file, pages] = self.format.words();
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
#[derive(Default)]
pub(crate) struct Reader {
    open: Option<(Arc<Paged>, Box<dyn Pages>)>,
}

impl std::fmt::Debug for Reader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Reader").field(&self.open.as_ref().map(|(file, _)| file)).finish()
    }
}

impl Reader {
    /// The pixels of a page, from 0.
    pub fn picture(&mut self, file: &Arc<Paged>, page: usize) -> Result<Picture, SourceError> {
        let known = self.open.take().filter(|(known, _)| Arc::ptr_eq(known, file)).map(|(_, pages)| pages);
        let known = known.or_else(|| file.kept().take());
        let pages = known.map_or_else(|| file.open(), Ok).map_err(|fault| fault.about(&file.path))?;
        let (_, pages) = self.open.insert((file.clone(), pages));
        pages.picture(page).map_err(|fault| fault.about(&file.path))
    }

    /// When a page of the file that is open was taken, where that tells.
    pub fn stamp(&self, file: &Arc<Paged>, page: usize) -> Option<Stamp> {
        let (_, pages) = self.open.as_ref().filter(|(known, _)| Arc::ptr_eq(known, file))?;
        pages.stamp(page)
    }
}
