//! Imports the data folder of earlier versions once: `DIR/models` with a file for each model, `NAME.json`, and a mark for each
//! removed shipped model, `NAME.removed`. It changes nothing in the folder.

use std::fs;
use std::io;
use std::path::Path;

use isophote_capture::read_regular;
use serde::{Deserialize, Serialize};

use super::entry::{Media, ModelText};
use super::history::ModelRecord;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::store::{RecordTable, Transaction, warn};

/// The content of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Stored {
    /// Counts the documents put under this name.
    version: u64,
    /// Its media type.
    media: Media,
    /// The text as sent.
    text: String,
}

/// Bytes of a file: its document with every character escaped, and the keys around it.
const FILE_BYTES_MAX: u64 = 8 * LIMITS.document_bytes as u64;

/// The content of such a folder as one transaction, with the number of names. Logs and skips files that do not belong to it or
/// cannot be read.
pub fn imported(folder: &Path) -> io::Result<(usize, Transaction)> {
    let (mut count, mut transaction) = (0, Transaction::default());
    let mut paths: Vec<_> =
        fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
    paths.sort();
    for path in paths {
        let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        let record = match (Name::parse(stem), extension) {
            (Some(_), "removed") if path.with_extension("json").exists() => continue, // left by an interrupted save
            (Some(_), "removed") => Ok((ModelRecord::default(), None)),
            (Some(_), "json") => model(&path).map(|(record, content)| (record, Some(content))),
            (_, "new") => continue, // left by an interrupted save
            _ => Err("not a stored model".to_string()),
        };
        match record {
            Ok((record, content)) => {
                if let Some(content) = content {
                    transaction = transaction.put(RecordTable::Contents, &content.key(), content.bytes()?);
                }
                transaction = transaction.put(RecordTable::Models, stem, serde_json::to_vec(&record)?);
                count += 1;
            }
            Err(reason) => warn(&path, &format!("{reason}, left alone")),
        }
    }
    Ok((count, transaction))
}

fn model(path: &Path) -> Result<(ModelRecord, ModelText), String> {
    let no_model = |error: &dyn std::fmt::Display| format!("not a stored model: {error}");
    let bytes = read_regular(path, FILE_BYTES_MAX).map_err(|error| no_model(&error))?;
    let stored: Stored = serde_json::from_slice(&bytes).map_err(|error| no_model(&error))?;
    let model = stored.media.model(&stored.text).map_err(|faults| {
        format!("refused: {}", faults.first().map(|fault| fault.message.clone()).unwrap_or_default())
    })?;
    let content = ModelText { digest: model.digest().to_string(), media: stored.media, text: stored.text.into() };
    let mut record = ModelRecord::default();
    record.add(stored.version, &content, None);
    Ok((record, content))
}
