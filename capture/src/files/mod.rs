//! File formats, one module and one row of [`FORMATS`] each.
//!
//! A [`Format`] has signatures, readers and the precedence of its files in a folder. A new format needs a module and its
//! row; no other code refers to formats by name.

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
pub(crate) use format::{Content, FolderPrecedence, Format, Open, PageFault, Pages, Topics};

/// All supported formats.
static FORMATS: [Format; 8] =
    [image::PNG, image::JPEG, tiff::FORMAT, fits::FORMAT, fits::PACKED, y4m::FORMAT, mcap::FORMAT, csv::FORMAT];

/// The format of a file by its extension; `None` for files that are not frames.
pub(crate) fn format_of(path: &Path) -> Option<&'static Format> {
    let name = path.file_name()?.to_str()?.to_ascii_lowercase();
    let is_of = |format: &&Format| {
        let stem = |extension: &&str| name.strip_suffix(extension)?.strip_suffix('.');
        format.extensions.iter().any(|extension| stem(extension).is_some_and(|stem| !stem.is_empty()))
    };
    FORMATS.iter().find(is_of)
}

/// Name of the format whose signature `bytes` begin with.
pub(crate) fn format_of_signature(bytes: &[u8]) -> Option<&'static str> {
    FORMATS
        .iter()
        .find(|format| !format.signatures.is_empty() && format.matches_signature(bytes))
        .map(|format| format.name)
}

/// Turns an unknown-kind error into one that names the format whose signature `bytes` begin with.
pub(crate) fn misnamed(error: DecodeError, bytes: &[u8]) -> DecodeError {
    match (&error, format_of_signature(bytes)) {
        (DecodeError::UnknownKind, Some(name)) => {
            DecodeError::Unsupported(format!("its bytes are those of a {name} file, not of a PNG or JPEG"))
        }
        _ => error,
    }
}

/// Extensions of formats whose files may hold several topics.
pub(crate) fn extensions_with_topics() -> impl Iterator<Item = &'static str> {
    let named = |format: &&Format| matches!(format.content, Content::Pages { topics: Topics::Named, .. });
    FORMATS.iter().filter(named).flat_map(|format| format.extensions.iter().copied())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::source::SourceError;

    /// The errors for an empty folder and an unknown file name every format; extensions are unique.
    #[test]
    fn error_messages_name_every_format() {
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
