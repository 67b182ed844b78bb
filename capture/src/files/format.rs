//! What a row of the table of formats says, and the trait of files that hold several pictures.

use std::fs::File;
use std::path::Path;

use crate::clock::Stamp;
use crate::picture::{DecodeError, StoredPicture};
use crate::source::SourceError;

/// One file format.
pub(crate) struct Format {
    /// For people.
    pub name: &'static str,
    /// Of file names, in small letters.
    pub extensions: &'static [&'static str],
    /// What its bytes begin with, one of these; none where they may begin with anything.
    pub signatures: &'static [&'static [u8]],
    /// What is in a file, and how it is read.
    pub content: Content,
    /// What it counts for in a folder.
    pub beside: Beside,
}

impl Format {
    /// Whether bytes begin as those of its files do.
    pub fn begins(&self, bytes: &[u8]) -> bool {
        self.signatures.is_empty() || self.signatures.iter().any(|signature| bytes.starts_with(signature))
    }
}

/// Reads a file that has just been opened, or of one that holds several things that which is named.
pub(crate) type Open = fn(File, Option<&str>) -> Result<Box<dyn Pages>, PageFault>;

/// What is in a file of a format.
pub(crate) enum Content {
    /// One picture, of all bytes of the file; and its width and height, for which no pixel is decoded.
    Picture {
        picture: fn(&[u8]) -> Result<StoredPicture, DecodeError>,
        size: fn(&[u8]) -> Result<[usize; 2], DecodeError>,
    },
    /// Several pictures, read one at a time.
    Pages {
        /// For people: what a file is called, and its pictures.
        words: [&'static str; 2],
        open: Open,
        /// Whose pictures they are can be named behind the file.
        topics: Topics,
    },
    /// Columns of numbers.
    Table,
}

/// Whether a file holds pictures of several things, of which one is named behind a `#`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topics {
    One,
    Named,
}

/// Which files of a folder are its frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Beside {
    /// They always count.
    Pictures,
    /// They count where there are no pictures: beside those they are something else.
    Recordings,
    /// They count where there is nothing else.
    Tables,
}

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
    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault>;
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
