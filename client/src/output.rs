//! Results on standard output: the one printer of all commands. Progress and messages go to standard error.

use std::io::{self, ErrorKind, StdoutLock, Write};

use serde::Serialize;

use crate::failure::Failure;

/// Standard output, which knows when its reader has gone away (`isophote watch demo | head`).
pub struct Output {
    out: StdoutLock<'static>,
    is_unread: bool,
}

impl Output {
    /// Takes standard output.
    pub fn new() -> Output {
        Output { out: io::stdout().lock(), is_unread: false }
    }

    /// True when nobody reads: there is nothing left to do and nobody to tell.
    pub fn is_unread(&self) -> bool {
        self.is_unread
    }

    fn checked<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        self.is_unread |= result.as_ref().is_err_and(|error| error.kind() == ErrorKind::BrokenPipe);
        result
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.out.write(bytes);
        self.checked(result)
    }
    fn flush(&mut self) -> io::Result<()> {
        let result = self.out.flush();
        self.checked(result)
    }
}

/// One JSON value on a line.
pub fn json(out: &mut dyn Write, value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(|error| Failure::Other(error.to_string()))?;
    writeln!(out, "{text}").map_err(Failure::output)
}

/// Rows under a head, columns as wide as their widest entry.
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
}
