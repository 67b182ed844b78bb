//! Files that may be read. A path in, an open file or its bytes out; nothing here ever waits.
//!
//! A path comes from outside, and behind it may stand a pipe that nobody writes to, a device without end, or a link to either.
//! So a file is looked at before it is opened (opening alone rewinds a tape), opened without waiting, and looked at again.

use std::fs::{File, OpenOptions};
use std::io::{Error, Read, Result};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

/// Opens a regular file, links resolved.
///
/// # Errors
/// The system's, and for everything that is no regular file what it is.
pub fn open_regular(path: &Path) -> Result<File> {
    check(&std::fs::metadata(path)?)?;
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)?;
    // What the path names may have changed in between.
    check(&file.metadata()?)?;
    Ok(file)
}

/// The bytes of a regular file, if they are at most `bytes_max`: counted as they come, since some files say that they have none.
///
/// # Errors
/// Those of [`open_regular`], and that there are too many.
pub fn read_regular(path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
    let file = open_regular(path)?;
    let said = file.metadata()?.len();
    let mut bytes = Vec::new();
    if said <= bytes_max {
        bytes.reserve_exact(said as usize);
        file.take(bytes_max + 1).read_to_end(&mut bytes)?;
    }
    let found = said.max(bytes.len() as u64);
    if found > bytes_max {
        return Err(Error::other(format!("it has more than the {bytes_max} bytes that are read")));
    }
    Ok(bytes)
}

fn check(about: &std::fs::Metadata) -> Result<()> {
    match about {
        about if about.is_file() => Ok(()),
        about if about.is_dir() => Err(Error::other("it is a folder, not a file")),
        _ => Err(Error::other("it is neither a file nor a folder")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_regular_files_are_read_and_at_most_so_many_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), b"12345").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", at("zero")).unwrap();
        rustix::fs::mkfifoat(rustix::fs::CWD, at("pipe"), rustix::fs::Mode::RWXU).unwrap();
        for (most, is_read) in [(4, false), (5, true), (6, true)] {
            assert_eq!(read_regular(&at("link"), most).ok(), is_read.then(|| b"12345".to_vec()), "{most}");
        }
        // It says that it has no bytes.
        assert!(read_regular(Path::new("/proc/self/status"), 10).is_err());
        assert!(read_regular(Path::new("/proc/self/status"), 1 << 20).unwrap().len() > 10);
        for name in ["zero", "pipe", "", "absent"] {
            assert!(read_regular(&at(name), 10).is_err(), "{name}");
        }
    }
}
