//! `Format`, a row of the format table, and `Pages`, the trait of multi-picture files.

use std::fs::File;
use std::path::Path;

use crate::clock::Stamp;
use crate::picture::{DecodeError, StoredPicture};
use crate::source::SourceError;

/// One file format.
pub(crate) struct Format {
    /// Display name.
    pub name: &'static str,
    /// File name extensions, lower case.
    pub extensions: &'static [&'static str],
    /// Possible signatures; empty if files may begin with any bytes.
    pub signatures: &'static [&'static [u8]],
    /// Content of a file, and its reader.
    pub content: Content,
    /// Precedence in a folder.
    pub precedence: FolderPrecedence,
}

impl Format {
    /// Whether `bytes` begin with one of the signatures.
    pub fn matches_signature(&self, bytes: &[u8]) -> bool {
        self.signatures.is_empty() || self.signatures.iter().any(|signature| bytes.starts_with(signature))
    }
}

/// Opens a just-opened file as pages; the string names the topic in files with several.
pub(crate) type Open = fn(File, Option<&str>) -> Result<Box<dyn Pages>, PageFault>;

/// Content of a file.
pub(crate) enum Content {
    /// One picture: decoders of the whole file, and of width and height alone.
    Picture {
        picture: fn(&[u8]) -> Result<StoredPicture, DecodeError>,
        size: fn(&[u8]) -> Result<[usize; 2], DecodeError>,
    },
    /// Several pictures, read one at a time.
    Pages {
        /// Display names of a file and of its pictures.
        words: [&'static str; 2],
        open: Open,
        /// Whether a topic may be named after the path.
        topics: Topics,
    },
    /// Columns of numbers.
    Table,
}

/// Whether a file holds several topics, of which one is named behind a `#`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topics {
    One,
    Named,
}

/// Which files of a folder are its frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FolderPrecedence {
    /// Always.
    Pictures,
    /// Only if the folder has no pictures: next to those they are something else.
    Recordings,
    /// Only if there is nothing else.
    Tables,
}

/// An open multi-picture file.
pub(crate) trait Pages: Send {
    /// Number of pictures; may stop at `most` + 1.
    fn count(&mut self, most: usize) -> Result<usize, PageFault>;

    /// Pages per volume, if the file is a series of volumes.
    fn volume(&self) -> Option<usize> {
        None
    }

    /// Width and height of a page, from 0.
    fn size(&mut self, page: usize) -> Result<[usize; 2], PageFault>;

    /// Time stamp of a page, if the file has one.
    fn stamp(&self, _page: usize) -> Option<Stamp> {
        None
    }

    /// The pixels of a page, from 0. Its size is checked before memory is allocated.
    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault>;
}

/// Why a page cannot be read.
pub(crate) enum PageFault {
    /// An I/O error.
    Unreadable(std::io::Error),
    /// Wrong content.
    Wrong(DecodeError),
}

impl PageFault {
    pub fn in_file(self, path: &Path) -> SourceError {
        match self {
            PageFault::Unreadable(reason) => SourceError::Unreadable { path: path.into(), reason },
            PageFault::Wrong(error) => error.in_file(path),
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
