//! File formats: one file each, and a row in one table.
//!
//! In: the name of a file. Out: its [`Format`], which says what its bytes begin with, how it is read, and what it counts for in
//! a folder. A further format is a file with its row, and the row's place in [`FORMATS`]; nobody else knows formats by name.

pub(crate) mod csv;
mod fits;
mod foreign;
mod format;
pub(crate) mod image;
pub(crate) mod mcap;
pub(crate) mod tiff;
mod y4m;

use std::path::Path;

use crate::picture::DecodeError;

pub(crate) use foreign::remedy;
pub(crate) use format::{Beside, Content, Format, Open, PageFault, Pages, Topics};

/// All that are read.
static FORMATS: [Format; 8] =
    [image::PNG, image::JPEG, tiff::FORMAT, fits::FORMAT, fits::PACKED, y4m::FORMAT, mcap::FORMAT, csv::FORMAT];

/// The format that a file's name says; `None` for all that is no frame.
pub(crate) fn format_of(path: &Path) -> Option<&'static Format> {
    let name = path.file_name()?.to_str()?.to_ascii_lowercase();
    let is_of = |format: &&Format| {
        let stem = |extension: &&str| name.strip_suffix(extension)?.strip_suffix('.');
        format.extensions.iter().any(|extension| stem(extension).is_some_and(|stem| !stem.is_empty()))
    };
    FORMATS.iter().find(is_of)
}

/// The name of the format that bytes begin like, whatever their file is called.
pub(crate) fn format_begun(bytes: &[u8]) -> Option<&'static str> {
    FORMATS.iter().find(|format| !format.signatures.is_empty() && format.begins(bytes)).map(|format| format.name)
}

/// The error for bytes that are no PNG or JPEG; it names the format that they begin like.
pub(crate) fn misnamed(error: DecodeError, bytes: &[u8]) -> DecodeError {
    match (&error, format_begun(bytes)) {
        (DecodeError::UnknownKind, Some(name)) => {
            DecodeError::Unsupported(format!("its bytes are those of a {name} file, not of a PNG or JPEG"))
        }
        _ => error,
    }
}

/// The extensions of formats whose files hold pictures of several things.
pub(crate) fn extensions_with_topics() -> impl Iterator<Item = &'static str> {
    let named = |format: &&Format| matches!(format.content, Content::Pages { topics: Topics::Named, .. });
    FORMATS.iter().filter(named).flat_map(|format| format.extensions.iter().copied())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::source::SourceError;

    /// What is said of a file or folder that is no recording names every format; no two rows claim one name.
    #[test]
    fn messages_name_every_format_of_the_table() {
        let path = PathBuf::from("there");
        let messages = [SourceError::Empty { path: path.clone() }, SourceError::UnknownKind { path }];
        for message in messages.map(|error| error.to_string()) {
            let missing = FORMATS.iter().find(|format| !message.contains(format.name));
            assert!(missing.is_none(), "{message}: {:?}", missing.map(|format| format.name));
        }
        let all: Vec<&str> = FORMATS.iter().flat_map(|format| format.extensions).copied().collect();
        for (i, extension) in all.iter().enumerate() {
            let found = format_of(Path::new(&format!("a.{}", extension.to_uppercase())));
            assert!(found.is_some_and(|format| format.extensions.contains(extension)), "{extension}");
            assert!(!all[..i].contains(extension), "{extension} twice");
        }
        assert!(format_of(Path::new("notes.txt")).is_none());
    }
}
