//! Reads `truth.jsonl` of a rendered recording: the parameters and time of each file.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use crate::limits::LIMITS;
use crate::regular::ReadableFolder;
use crate::source::SourceError;

/// The file's name in a recording's folder.
pub(crate) const FILE: &str = "truth.jsonl";

#[derive(Deserialize)]
struct Line {
    file: String,
    parameters: BTreeMap<String, f64>,
    t: Option<f64>,
}

/// Ground truth of one frame.
#[derive(Clone, Debug)]
pub(crate) struct Truth {
    /// Parameters that the frame was rendered from.
    pub parameters: BTreeMap<String, f64>,
    /// Time, s.
    pub t_s: Option<f64>,
}

/// Ground truth by file name. A folder without the file has no truth, which is not an error.
pub(crate) fn read(folder: &Path, reach: &ReadableFolder) -> Result<BTreeMap<String, Truth>, SourceError> {
    let path = folder.join(FILE);
    let bytes = match reach.read(&path, LIMITS.file_bytes) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
        Err(reason) => return Err(SourceError::Unreadable { path, reason }),
    };
    let Ok(text) = String::from_utf8(bytes) else {
        let reason = std::io::Error::other("it is not UTF-8 text");
        return Err(SourceError::Unreadable { path, reason });
    };
    let mut truth = BTreeMap::new();
    for (i, text) in text.lines().enumerate().filter(|(_, text)| !text.trim().is_empty()) {
        // The decoder's message quotes the file: a client that may name a path may not be allowed to read it.
        let line: Line = serde_json::from_str(text).map_err(|error| SourceError::Line {
            path: path.clone(),
            line: i as u64 + 1,
            reason: format!(
                "not a line of truth (wrong at column {}); `isophote render` writes such files",
                error.column()
            ),
        })?;
        truth.insert(line.file, Truth { parameters: line.parameters, t_s: line.t });
    }
    Ok(truth)
}
