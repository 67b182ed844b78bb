//! By which a file that has changed is known.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Identity, length and time of the file; `None` if it is absent.
pub type FileStamp = Option<[i64; 6]>;

/// Of the file that the path leads to now.
pub fn stamp(path: &Path) -> FileStamp {
    let about = std::fs::metadata(path).ok()?;
    let number = |number: u64| number as i64;
    Some([
        number(about.ino()),
        number(about.len()),
        about.mtime(),
        about.mtime_nsec(),
        about.ctime(),
        about.ctime_nsec(),
    ])
}
