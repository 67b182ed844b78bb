//! Opens and reads regular files without ever blocking.
//!
//! Paths come from clients and may name a pipe without a writer, an endless device, or a link to either. A file is therefore
//! checked before it is opened (opening alone rewinds a tape), opened non-blocking, and checked again.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use rustix::fs::OFlags;

/// Opens a regular file, following links.
///
/// # Errors
/// I/O errors, and anything that is not a regular file.
pub fn open_regular(path: &Path) -> Result<File> {
    check(&std::fs::metadata(path)?)?;
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)?;
    // The path may name another file by now.
    check(&file.metadata()?)?;
    Ok(file)
}

/// Reads a regular file of at most `bytes_max` bytes, counted while reading, since some files report a size of 0.
///
/// # Errors
/// Those of [`open_regular`], and a larger file.
pub fn read_regular(path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
    read_opened(open_regular(path)?, bytes_max)
}

fn read_opened(file: File, bytes_max: u64) -> Result<Vec<u8>> {
    let configured = file.metadata()?.len();
    let mut bytes = Vec::new();
    if configured <= bytes_max {
        bytes.reserve_exact(configured as usize);
        file.take(bytes_max + 1).read_to_end(&mut bytes)?;
    }
    let found = configured.max(bytes.len() as u64);
    if found > bytes_max {
        return Err(Error::other(format!("it has more than the {bytes_max} bytes that are read")));
    }
    Ok(bytes)
}

/// Where readable files may be: anywhere, or below one folder with links resolved.
#[derive(Clone, Debug, Default)]
pub struct ReadableFolder(Option<Arc<Root>>);

#[derive(Debug)]
struct Root {
    /// Absolute path as configured, links unresolved.
    configured: PathBuf,
    /// Links resolved.
    real: PathBuf,
}

impl ReadableFolder {
    /// Restricts files to `folder`, to which paths are then relative.
    ///
    /// # Errors
    /// There is no such folder.
    pub fn below(folder: &Path) -> Result<ReadableFolder> {
        let real = folder.canonicalize()?;
        if !real.is_dir() {
            return Err(Error::from(ErrorKind::NotADirectory));
        }
        Ok(ReadableFolder(Some(Arc::new(Root { configured: std::path::absolute(folder)?, real }))))
    }

    /// An existing path relative to the folder; unchanged without a restriction.
    pub fn relative<'a>(&self, path: &'a Path) -> &'a Path {
        self.0.as_ref().and_then(|root| path.strip_prefix(&root.real).ok()).unwrap_or(path)
    }

    /// Normalizes a client's path and rejects one outside the folder, without file system access: errors must not reveal
    /// which outside files exist.
    pub(crate) fn normalize(&self, path: &Path) -> Result<PathBuf> {
        let Some(root) = &self.0 else { return Ok(path.to_path_buf()) };
        let mut normalized = PathBuf::new();
        for part in root.real.join(path.strip_prefix(&root.configured).unwrap_or(path)).components() {
            match part {
                Component::ParentDir => drop(normalized.pop()),
                Component::CurDir => {}
                part => normalized.push(part),
            }
        }
        if normalized.starts_with(&root.real) { Ok(normalized) } else { Err(outside()) }
    }

    /// Resolves the links of an existing path and rejects one outside the folder; unchanged without a restriction.
    pub(crate) fn resolve(&self, path: &Path) -> Result<PathBuf> {
        let Some(root) = &self.0 else { return Ok(path.to_path_buf()) };
        let real = path.canonicalize()?;
        if real.starts_with(&root.real) { Ok(real) } else { Err(outside()) }
    }

    /// [`open_regular`] with the restriction, checked on the open file, since the path may be changed at any time.
    pub(crate) fn open(&self, path: &Path) -> Result<File> {
        let file = open_regular(path)?;
        let Some(root) = &self.0 else { return Ok(file) };
        let real = std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd()))?;
        if real.starts_with(&root.real) { Ok(file) } else { Err(outside()) }
    }

    /// [`read_regular`] with the restriction.
    pub(crate) fn read(&self, path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
        read_opened(self.open(path)?, bytes_max)
    }
}

fn outside() -> Error {
    Error::new(ErrorKind::PermissionDenied, "it lies outside of the folder that recordings are read from")
}

fn check(metadata: &std::fs::Metadata) -> Result<()> {
    match metadata {
        metadata if metadata.is_file() => Ok(()),
        metadata if metadata.is_dir() => Err(Error::other("it is a folder, not a file")),
        _ => Err(Error::other("it is neither a file nor a folder")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_regular_files_up_to_the_size_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), b"12345").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", at("zero")).unwrap();
        rustix::fs::mkfifoat(rustix::fs::CWD, at("pipe"), rustix::fs::Mode::RWXU).unwrap();
        for (most, is_read) in [(4, false), (5, true), (6, true)] {
            assert_eq!(read_regular(&at("link"), most).ok(), is_read.then(|| b"12345".to_vec()), "{most}");
        }
        // This file reports a size of 0.
        assert!(read_regular(Path::new("/proc/self/status"), 10).is_err());
        assert!(read_regular(Path::new("/proc/self/status"), 1 << 20).unwrap().len() > 10);
        for name in ["zero", "pipe", "", "absent"] {
            assert!(read_regular(&at(name), 10).is_err(), "{name}");
        }
    }

    #[test]
    fn paths_and_links_cannot_escape_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("root/inner")).unwrap();
        std::fs::write(at("root/inner/file"), b"in").unwrap();
        std::fs::write(at("beside"), b"out").unwrap();
        std::os::unix::fs::symlink("inner/file", at("root/in")).unwrap();
        std::os::unix::fs::symlink("../beside", at("root/out")).unwrap();
        std::os::unix::fs::symlink("root", at("link")).unwrap();
        // The folder may be configured through a link; client paths may begin with either name.
        for root in ["root", "link"] {
            let reach = ReadableFolder::below(&at(root)).unwrap();
            let real = |name: &str| at("root").canonicalize().unwrap().join(name);
            let sent = [Path::new("inner/file").to_path_buf(), at(root).join("inner/./file"), real("inner/../in")];
            for path in &sent {
                let path = reach.normalize(path).unwrap();
                let found = reach.resolve(&path).unwrap();
                assert_eq!(reach.relative(&found), Path::new("inner/file"), "{}", path.display());
                assert_eq!(reach.read(&path, 9).unwrap(), b"in");
            }
            for path in ["..", "../beside", "inner/../../beside", "/", "/etc/passwd", at("rooted").to_str().unwrap()] {
                assert_eq!(reach.normalize(Path::new(path)).unwrap_err().kind(), ErrorKind::PermissionDenied, "{path}");
            }
            let link = reach.normalize(Path::new("out")).unwrap();
            assert_eq!(reach.resolve(&link).unwrap_err().kind(), ErrorKind::PermissionDenied);
            assert_eq!(reach.open(&link).unwrap_err().kind(), ErrorKind::PermissionDenied);
            assert_eq!(reach.open(&real("absent")).unwrap_err().kind(), ErrorKind::NotFound);
        }
        assert!(ReadableFolder::below(&at("beside")).is_err() && ReadableFolder::below(&at("absent")).is_err());
        let anywhere = ReadableFolder::default();
        assert_eq!(anywhere.read(&anywhere.normalize(&at("root/out")).unwrap(), 9).unwrap(), b"out");
    }
}
