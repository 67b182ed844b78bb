//! Parses a CSV file into one 1-D frame of f64 planes, one per column, with channel names from the header.
//!
//! Errors name line and column and never quote the file: a client that may name a path may not be allowed to read it.

use std::path::Path;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;

use super::format::{Content, FolderPrecedence, Format};
use crate::limits::LIMITS;
use crate::source::SourceError;

pub(crate) const FORMAT: Format = Format {
    name: "CSV",
    extensions: &["csv"],
    signatures: &[],
    content: Content::Table,
    precedence: FolderPrecedence::Tables,
};

/// The columns of a CSV file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Columns {
    /// From the header, in order.
    pub names: Vec<String>,
    /// One vector per column; all of equal length, not empty.
    pub columns: Vec<Vec<f64>>,
}

impl Columns {
    /// Parses `text`; `path` is only for messages. Lines that start with `#` and blank lines are skipped.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Columns, SourceError> {
        let fault = |line: u64, reason: String| SourceError::Line { path: path.into(), line, reason };
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text);
        let csv_fault = |error: csv::Error| {
            let line = error.position().map_or(1, |p| line_of(text, p));
            let reason = match error.kind() {
                csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                    format!(
                        "{len} fields where the header names {expected_len} channels; give each line {expected_len} numbers"
                    )
                }
                csv::ErrorKind::Utf8 { .. } => "not UTF-8 text; save the file as UTF-8".to_string(),
                _ => error.to_string(),
            };
            fault(line, reason)
        };
        let names: Vec<String> = reader.headers().map_err(csv_fault)?.iter().map(str::to_string).collect();
        check_names(&names).map_err(|reason| fault(1, reason))?;
        let mut columns = vec![Vec::new(); names.len()];
        for record in reader.records() {
            let record = record.map_err(csv_fault)?;
            let line = record.position().map_or(0, |p| line_of(text, p));
            for (column, field) in record.iter().enumerate() {
                let Ok(number) = field.parse::<f64>() else {
                    return Err(fault(line, format!("what stands in column {} is not a number", column + 1)));
                };
                columns[column].push(number);
            }
        }
        if columns[0].is_empty() {
            return Err(fault(1, "there is a header but no line of numbers below it".into()));
        }
        Ok(Columns { names, columns })
    }

    /// The frame whose planes are the columns that `channels` names, in that order.
    pub fn frame(&self, path: &Path, channels: &[String]) -> Result<Frame, SourceError> {
        let fault = |reason: String| SourceError::Channels { path: path.into(), reason };
        let mut planes = Vec::new();
        for channel in channels {
            let Some(index) = self.names.iter().position(|name| name == channel) else {
                let columns = self.names.len();
                return Err(fault(format!(
                    "none of the {columns} columns is named `{channel}`, which the model reads"
                )));
            };
            let column = &self.columns[index];
            let bytes = column.iter().flat_map(|number| number.to_le_bytes()).collect();
            planes.push(Plane::owned(PixelFormat::F64, bytes, column.len()));
        }
        let frame = Frame::new(&[self.columns[0].len()], planes).map_err(|error| fault(error.to_string()))?;
        Ok(frame.with_names(channels.into()))
    }
}

/// Line number of a record, from 1. The reader's position is the end of the previous record: comments and blank lines may
/// follow it.
fn line_of(text: &[u8], position: &csv::Position) -> u64 {
    let rest = text.get(position.byte() as usize..).unwrap_or(&[]);
    let is_skipped = |line: &&[u8]| line.starts_with(b"#") || line.trim_ascii().is_empty();
    position.line() + rest.split(|byte| *byte == b'\n').take_while(is_skipped).count() as u64
}

/// Requires distinct, non-empty, non-numeric names; numbers mean that the header is missing.
fn check_names(names: &[String]) -> Result<(), String> {
    if names.iter().all(String::is_empty) {
        return Err("the file is empty; its first line must name the channels, e.g. `x,y`".into());
    }
    if names.len() > LIMITS.columns {
        return Err(format!("{} columns; at most {} are read", names.len(), LIMITS.columns));
    }
    for (i, name) in names.iter().enumerate() {
        if name.is_empty() {
            return Err(format!("column {} has no name; the first line must name the channels, e.g. `x,y`", i + 1));
        }
        if name.parse::<f64>().is_ok() {
            return Err(format!("column {} is a number; the first line must name the channels, e.g. `x,y`", i + 1));
        }
        if let Some(before) = names[..i].iter().position(|one| one == name) {
            return Err(format!("columns {} and {} have the same name", before + 1, i + 1));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn columns_accept_all_number_notations() {
        let table =
            Columns::parse(Path::new("t.csv"), b"\xef\xbb\xbf# measured\n x ,\"y\"\n1, -2.5e3\r\n\n 2,+.5\n3,\"nan\"")
                .unwrap();
        assert_eq!(table.names, ["x", "y"]);
        assert_eq!(table.columns[0], [1.0, 2.0, 3.0]);
        assert_eq!(table.columns[1][..2], [-2500.0, 0.5]);
        assert!(table.columns[1][2].is_nan());
    }

    #[test]
    fn faults_name_file_line_and_remedy() {
        let cases: [(&[u8], &str); 9] = [
            (b"", "t.csv:1: the file is empty; its first line must name the channels, e.g. `x,y`"),
            (b"1,2\n3,4\n", "t.csv:1: column 1 is a number; the first line must name the channels, e.g. `x,y`"),
            (b"x,x\n1,2\n", "t.csv:1: columns 1 and 2 have the same name"),
            (b"x,,y\n1,2,3\n", "t.csv:1: column 2 has no name; the first line must name the channels, e.g. `x,y`"),
            (b"x,y\n", "t.csv:1: there is a header but no line of numbers below it"),
            (b"x,y\n1,2\n3\n", "t.csv:3: 1 fields where the header names 2 channels; give each line 2 numbers"),
            (
                b"x,y\n1,2\n# so\n3,4,5\n",
                "t.csv:4: 3 fields where the header names 2 channels; give each line 2 numbers",
            ),
            (b"x,y\n1,two\n", "t.csv:2: what stands in column 2 is not a number"),
            (b"x,y\n1,\xff\n", "t.csv:2: not UTF-8 text; save the file as UTF-8"),
        ];
        for (text, expected) in cases {
            let error = Columns::parse(Path::new("t.csv"), text).unwrap_err();
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn channels_select_columns_by_name() {
        let table = Columns::parse(Path::new("t.csv"), b"x,y,z\n1,2,3\n4,5,6\n").unwrap();
        let frame = table.frame(Path::new("t.csv"), &["z".into(), "x".into()]).unwrap();
        assert_eq!(frame.size(), [2]);
        assert_eq!((frame.plane_view(0).pixel(1, 0), frame.plane_view(1).pixel(1, 0)), (6.0, 4.0));
        let error = table.frame(Path::new("t.csv"), &["w".into()]).unwrap_err();
        assert_eq!(error.to_string(), "t.csv: none of the 3 columns is named `w`, which the model reads");
    }
}
