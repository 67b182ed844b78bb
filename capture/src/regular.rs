//! Files that may be read. A path in, an open file or its bytes out; nothing here ever waits.
//!
//! A path comes from outside, and behind it may stand a pipe that nobody writes to, a device without end, or a link to either.
//! So a file is looked at before it is opened (opening alone rewinds a tape), opened without waiting, and looked at again.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

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
    read_opened(open_regular(path)?, bytes_max)
}

fn read_opened(file: File, bytes_max: u64) -> Result<Vec<u8>> {
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

/// Where files may be: anywhere, or below one folder, whatever links say.
#[derive(Clone, Debug, Default)]
pub struct ReadableFolder(Option<Arc<Root>>);

#[derive(Debug)]
struct Root {
    /// As it was named.
    said: PathBuf,
    /// Links resolved.
    real: PathBuf,
}

impl ReadableFolder {
    /// Below a folder, to which paths are then relative.
    ///
    /// # Errors
    /// There is no such folder.
    pub fn below(folder: &Path) -> Result<ReadableFolder> {
        let real = folder.canonicalize()?;
        if !real.is_dir() {
            return Err(Error::from(ErrorKind::NotADirectory));
        }
        Ok(ReadableFolder(Some(Arc::new(Root { said: std::path::absolute(folder)?, real }))))
    }

    /// The path of a file or folder that is there, as it is said from the folder; as it is where files may be anywhere.
    pub fn relative<'a>(&self, path: &'a Path) -> &'a Path {
        self.0.as_ref().and_then(|root| path.strip_prefix(&root.real).ok()).unwrap_or(path)
    }

    /// Where a path that was sent would be. Nothing is looked up: of what is outside nobody learns whether it is there.
    pub(crate) fn place(&self, path: &Path) -> Result<PathBuf> {
        let Some(root) = &self.0 else { return Ok(path.to_path_buf()) };
        let mut place = PathBuf::new();
        for part in root.real.join(path.strip_prefix(&root.said).unwrap_or(path)).components() {
            match part {
                Component::ParentDir => drop(place.pop()),
                Component::CurDir => {}
                part => place.push(part),
            }
        }
        if place.starts_with(&root.real) { Ok(place) } else { Err(outside()) }
    }

    /// A file or folder that is there, links resolved where that matters.
    pub(crate) fn resolve(&self, path: &Path) -> Result<PathBuf> {
        let Some(root) = &self.0 else { return Ok(path.to_path_buf()) };
        let real = path.canonicalize()?;
        if real.starts_with(&root.real) { Ok(real) } else { Err(outside()) }
    }

    /// [`open_regular`], within reach. What was opened is asked where it is, since what a path names may change at any time.
    pub(crate) fn open(&self, path: &Path) -> Result<File> {
        let file = open_regular(path)?;
        let Some(root) = &self.0 else { return Ok(file) };
        let real = std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd()))?;
        if real.starts_with(&root.real) { Ok(file) } else { Err(outside()) }
    }

    /// [`read_regular`], within reach.
    pub(crate) fn read(&self, path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
        read_opened(self.open(path)?, bytes_max)
    }
}

fn outside() -> Error {
    Error::new(ErrorKind::PermissionDenied, "it lies outside of the folder that recordings are read from")
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

    #[test]
    fn a_reach_ends_at_its_folder_whatever_paths_and_links_say() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("root/inner")).unwrap();
        std::fs::write(at("root/inner/file"), b"in").unwrap();
        std::fs::write(at("beside"), b"out").unwrap();
        std::os::unix::fs::symlink("inner/file", at("root/in")).unwrap();
        std::os::unix::fs::symlink("../beside", at("root/out")).unwrap();
        std::os::unix::fs::symlink("root", at("link")).unwrap();
        // The folder may be named through a link; what is sent may begin with either name.
        for root in ["root", "link"] {
            let reach = ReadableFolder::below(&at(root)).unwrap();
            let real = |name: &str| at("root").canonicalize().unwrap().join(name);
            let sent = [Path::new("inner/file").to_path_buf(), at(root).join("inner/./file"), real("inner/../in")];
            for path in &sent {
                let place = reach.place(path).unwrap();
                let found = reach.resolve(&place).unwrap();
                assert_eq!(reach.relative(&found), Path::new("inner/file"), "{}", path.display());
                assert_eq!(reach.read(&place, 9).unwrap(), b"in");
            }
            for path in ["..", "../beside", "inner/../../beside", "/", "/etc/passwd", at("rooted").to_str().unwrap()] {
                assert_eq!(reach.place(Path::new(path)).unwrap_err().kind(), ErrorKind::PermissionDenied, "{path}");
            }
            let link = reach.place(Path::new("out")).unwrap();
            assert_eq!(reach.resolve(&link).unwrap_err().kind(), ErrorKind::PermissionDenied);
            assert_eq!(reach.open(&link).unwrap_err().kind(), ErrorKind::PermissionDenied);
            assert_eq!(reach.open(&real("absent")).unwrap_err().kind(), ErrorKind::NotFound);
        }
        assert!(ReadableFolder::below(&at("beside")).is_err() && ReadableFolder::below(&at("absent")).is_err());
        let anywhere = ReadableFolder::default();
        assert_eq!(anywhere.read(&anywhere.place(&at("root/out")).unwrap(), 9).unwrap(), b"out");
    }
}
