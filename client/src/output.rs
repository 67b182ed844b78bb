//! Results on standard output: the one printer of all commands. Progress and messages go to standard error.

use std::fs::{File, OpenOptions, Permissions};
use std::io::{self, ErrorKind, StdoutLock, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use isophote_symbolic::Diagnostic;
use serde::Serialize;
use tempfile::NamedTempFile;

use crate::failure::Failure;

/// Standard output that detects a closed pipe (`isophote watch demo | head`).
pub struct StandardOutput {
    out: StdoutLock<'static>,
    is_unread: bool,
}

impl StandardOutput {
    /// Locks standard output.
    pub fn new() -> StandardOutput {
        StandardOutput { out: io::stdout().lock(), is_unread: false }
    }

    /// Whether the reader has closed the pipe.
    pub fn is_unread(&self) -> bool {
        self.is_unread
    }

    fn checked<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        self.is_unread |= result.as_ref().is_err_and(|error| error.kind() == ErrorKind::BrokenPipe);
        result
    }
}

impl Write for StandardOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.out.write(bytes);
        self.checked(result)
    }
    fn flush(&mut self) -> io::Result<()> {
        let result = self.out.flush();
        self.checked(result)
    }
}

/// Prints one JSON value on a line.
pub fn json(out: &mut dyn Write, value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(|error| Failure::Other(error.to_string()))?;
    writeln!(out, "{text}").map_err(Failure::output)
}

/// Prints rows under a head, columns as wide as their widest entry.
pub fn table(out: &mut dyn Write, head: &[&str], rows: &[Vec<String>]) -> Result<(), Failure> {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(String::as_str).chain([head[column]]);
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let mut line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded: Vec<String> = cells.zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        writeln!(out, "{}", padded.join("  ").trim_end()).map_err(Failure::output)
    };
    line(&mut head.iter().copied())?;
    rows.iter().try_for_each(|row| line(&mut row.iter().map(String::as_str)))
}

/// Writes a file.
pub fn file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes)
        .map_err(|error| Failure::Other(format!("{}: cannot be written: {error}", path.display())))
}

/// Formats a warning on one line.
pub fn warning(name: &str, warning: &Diagnostic) -> String {
    let help = warning.help.as_ref().map_or_else(String::new, |help| format!("; {help}"));
    format!("warning[{}]: {name}: {}{help}", warning.code, warning.message)
}

/// A file that appears atomically when finished: until then it has a temporary name, and is deleted if never finished.
pub enum NewFile {
    /// A temporary file to be renamed to that path.
    Beside(NamedTempFile, PathBuf),
    /// A device or a pipe, written directly.
    Direct(File, PathBuf),
}

impl NewFile {
    /// Creates the file for that path; an existing file is replaced and its permissions kept.
    pub fn create(path: &Path) -> Result<NewFile, Failure> {
        let wrong = |error| Failure::Usage(format!("{}: cannot be written: {error}", path.display()));
        // Replaces the target of a link, not the link.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        let replaced = path.metadata().ok();
        if replaced.as_ref().is_some_and(|found| !found.is_file()) {
            return OpenOptions::new().write(true).open(&path).map(|file| NewFile::Direct(file, path)).map_err(wrong);
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        let mode = replaced.as_ref().map_or(0o666, |found| found.mode() & 0o777);
        builder.prefix(".isophote-").suffix(".part").permissions(Permissions::from_mode(mode));
        let file = builder.tempfile_in(folder).map_err(wrong)?;
        if replaced.is_some() {
            // The umask applies to new files only.
            file.as_file().set_permissions(Permissions::from_mode(mode)).map_err(wrong)?;
        }
        Ok(NewFile::Beside(file, path))
    }

    /// Syncs and renames the file.
    pub fn finish(self) -> Result<(), Failure> {
        let (path, done) = match self {
            NewFile::Direct(file, path) => {
                drop(file);
                (path, Ok(()))
            }
            NewFile::Beside(file, path) => {
                let synced = file.as_file().sync_all();
                let done = synced.and_then(|()| file.persist(&path).map(drop).map_err(|error| error.error));
                (path, done)
            }
        };
        done.map_err(|error| Failure::Other(format!("{}: cannot be written: {error}", path.display())))
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            NewFile::Beside(file, _) => file.write(bytes),
            NewFile::Direct(file, _) => file.write(bytes),
        }
    }
    fn flush(&mut self) -> io::Result<()> {
        match self {
            NewFile::Beside(file, _) => file.flush(),
            NewFile::Direct(file, _) => file.flush(),
        }
    }
}

/// A number to two digits of its standard deviation; to six digits without one.
pub fn with_deviation(value: f64, deviation: Option<f64>) -> String {
    let Some(deviation) = deviation.filter(|d| d.is_finite() && *d > 0.0) else { return shortest(value) };
    let exponent = deviation.log10().floor() as i32;
    let decimals = if value.abs() < 0.1 { -4..=4 } else { -9..=4 };
    if decimals.contains(&exponent) && value.abs() < 1e9 {
        let digits = (1 - exponent).max(0) as usize;
        return format!("{value:.digits$} ± {deviation:.digits$}");
    }
    let digits = (value.abs().log10().floor() as i32 - exponent + 1).clamp(1, 12) as usize;
    format!("{value:.digits$e} ± {deviation:.1e}")
}

/// Rounds a value to two digits of its standard deviation.
pub fn rounded([value, sigma]: [f64; 2]) -> f64 {
    let digits = (1.0 - sigma.log10().floor()).clamp(0.0, 6.0);
    (value * 10f64.powf(digits)).round() / 10f64.powf(digits)
}

fn shortest(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-3..1e6).contains(&magnitude) { format!("{value:.4}") } else { format!("{value:.5e}") }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn columns_are_aligned() {
        let mut out = Vec::new();
        table(&mut out, &["NAME", "V"], &[vec!["a".into(), "10".into()], vec!["länger".into(), "2".into()]]).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "NAME    V\na       10\nlänger  2\n");
    }

    #[test]
    fn files_are_replaced_atomically() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("run.mcap"), folder.path().join("link"));
        std::fs::write(&path, "old").unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(0o602)).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let written = |text: &str| {
            let mut file = NewFile::create(&link).unwrap();
            file.write_all(text.as_bytes()).unwrap();
            file
        };
        drop(written("half"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        written("new").finish().unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(path.metadata().unwrap().mode() & 0o777, 0o602, "its permissions are those of the old one");
        assert!(link.is_symlink());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left beside them");
        let folder = NewFile::create(folder.path()).err().unwrap();
        assert!(folder.status() == 2 && folder.to_string().contains("directory"), "{folder}");
        let mut device = NewFile::create(Path::new("/dev/null")).unwrap();
        device.write_all(b"anything").unwrap();
        device.finish().unwrap();
        assert!(!Path::new("/dev/null").is_file(), "a device stays one");
    }

    #[test]
    fn numbers_show_two_digits_of_their_deviation() {
        let cases = [
            (321.33712, Some(0.01034), "321.337 ± 0.010"),
            (150.0, Some(2.5), "150.0 ± 2.5"),
            (1500.4, Some(25.0), "1500 ± 25"),
            (2.7712e-4, Some(1.5e-7), "2.7712e-4 ± 1.5e-7"),
            (2.199943, Some(9.2e-5), "2.199943 ± 0.000092"),
            (0.150007, Some(1.8e-5), "0.150007 ± 0.000018"),
            (1.5, Some(2e-12), "1.500000000000e0 ± 2.0e-12"),
            (-0.5, None, "-0.5000"),
            (2.5e-4, None, "2.50000e-4"),
            (1.0, Some(f64::NAN), "1.0000"),
        ];
        for (value, deviation, expected) in cases {
            assert_eq!(with_deviation(value, deviation), expected);
        }
    }
}
