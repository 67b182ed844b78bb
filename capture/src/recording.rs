//! Recordings: a folder of images, one image, or one CSV file, as a source of frames.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use isophote_tracker::Frame;

use crate::decode::{self, DecodeError};
use crate::limits::LIMITS;
use crate::order::natural;
use crate::source::{Captured, FrameSource, SourceError};
use crate::table::Table;
use crate::truth;

/// Files that are frames, in natural name order, decoded one at a time.
///
/// Of a folder, the PNG and JPEG files count; if there are none, its CSV files. Everything else in it (licences, notes,
/// subfolders) is left alone. [`Recording::for_channels`] fits the planes to a model.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    files: Vec<PathBuf>,
    next: usize,
    sequence: u64,
    channels: Option<Vec<String>>,
    truth: BTreeMap<String, BTreeMap<String, f64>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Image,
    Csv,
}

impl Kind {
    fn of(path: &Path) -> Option<Kind> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" | "jpg" | "jpeg" => Some(Kind::Image),
            "csv" => Some(Kind::Csv),
            _ => None,
        }
    }
}

impl Recording {
    /// Opens a folder or a file. No pixel is read yet.
    pub fn open(path: impl AsRef<Path>) -> Result<Recording, SourceError> {
        let path = path.as_ref().to_path_buf();
        let about = std::fs::metadata(&path).map_err(|reason| match reason.kind() {
            std::io::ErrorKind::NotFound => SourceError::Missing { path: path.clone() },
            _ => SourceError::Unreadable { path: path.clone(), reason },
        })?;
        let (files, folder) = if about.is_dir() {
            (files_of(&path)?, Some(path.as_path()))
        } else {
            Kind::of(&path).ok_or_else(|| SourceError::UnknownKind { path: path.clone() })?;
            (vec![path.clone()], path.parent())
        };
        let truth = folder.map_or_else(|| Ok(BTreeMap::new()), truth::read)?;
        Ok(Recording { path, files, next: 0, sequence: 0, channels: None, truth })
    }

    /// Fits every frame's planes to the channels of a model: one channel takes the image's only plane or the Rec. 601 luma
    /// of a colour image; three take r, g, b in this order; a CSV file gives the columns of these names.
    pub fn for_channels(mut self, channels: &[String]) -> Recording {
        self.channels = Some(channels.to_vec());
        self
    }

    /// How many frames there are.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Never true: an empty recording cannot be opened.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// The columns that the first file's header names; `None` when it is an image.
    pub fn csv_channels(&self) -> Result<Option<Vec<String>>, SourceError> {
        match Kind::of(&self.files[0]) {
            Some(Kind::Csv) => Ok(Some(Table::parse(&self.files[0], &read(&self.files[0])?)?.names)),
            _ => Ok(None),
        }
    }

    /// Starts over with the first file; frames go on being counted.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    fn load(&self, path: &Path) -> Result<Frame, SourceError> {
        let bytes = read(path)?;
        if Kind::of(path) == Some(Kind::Csv) {
            let table = Table::parse(path, &bytes)?;
            return table.frame(path, self.channels.as_ref().unwrap_or(&table.names));
        }
        let frame = decode::decode(&bytes).map_err(|error| about(path, error))?;
        match &self.channels {
            Some(channels) => fitted(path, frame, channels),
            None => Ok(frame),
        }
    }
}

impl FrameSource for Recording {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        let Some(path) = self.files.get(self.next).cloned() else { return Ok(None) };
        self.next += 1;
        let sequence = self.sequence;
        self.sequence += 1;
        let frame = self.load(&path)?.with_sequence(sequence);
        let file = path.file_name().map(|name| name.to_string_lossy().into_owned());
        let truth = file.as_ref().and_then(|name| self.truth.get(name)).cloned();
        Ok(Some(Captured { frame, file, truth }))
    }

    fn description(&self) -> String {
        format!("recording {} ({} frames)", self.path.display(), self.files.len())
    }

    fn size(&self) -> Option<Vec<usize>> {
        let path = &self.files[0];
        let bytes = read(path).ok()?;
        match Kind::of(path)? {
            Kind::Csv => Some(vec![Table::parse(path, &bytes).ok()?.columns[0].len()]),
            Kind::Image => decode::size(&bytes).ok().map(Vec::from),
        }
    }
}

/// Fits an image's planes to a model's channels; see [`Recording::for_channels`].
fn fitted(path: &Path, frame: Frame, channels: &[String]) -> Result<Frame, SourceError> {
    let planes = frame.planes().len();
    if channels.len() == planes {
        return Ok(frame);
    }
    if channels.len() == 1 && planes == 3 {
        return Ok(frame.luma());
    }
    let names = channels.join(", ");
    let image =
        if planes == 1 { "a gray image has one channel" } else { "a colour image has three channels (r, g, b)" };
    let reason = format!("{image}, but the model reads {}: {names}", channels.len());
    Err(SourceError::Channels { path: path.into(), reason })
}

fn files_of(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let unreadable = |reason| SourceError::Unreadable { path: folder.into(), reason };
    let mut found: Vec<(String, PathBuf, Kind)> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let Some(kind) = Kind::of(&path).filter(|_| path.is_file()) else { continue };
        if found.len() == LIMITS.files {
            let reason = format!("more than {} files; split the recording", LIMITS.files);
            return Err(SourceError::TooLarge { path: folder.into(), reason });
        }
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        found.push((name, path, kind));
    }
    let kind = if found.iter().any(|(_, _, kind)| *kind == Kind::Image) { Kind::Image } else { Kind::Csv };
    found.retain(|(_, _, k)| *k == kind);
    found.sort_by(|a, b| natural(&a.0, &b.0));
    if found.is_empty() {
        return Err(SourceError::Empty { path: folder.into() });
    }
    Ok(found.into_iter().map(|(_, path, _)| path).collect())
}

fn read(path: &Path) -> Result<Vec<u8>, SourceError> {
    let unreadable = |reason| SourceError::Unreadable { path: path.into(), reason };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > LIMITS.file_bytes {
        let reason = format!("{bytes} bytes; at most {} are read", LIMITS.file_bytes);
        return Err(SourceError::TooLarge { path: path.into(), reason });
    }
    std::fs::read(path).map_err(unreadable)
}

fn about(path: &Path, error: DecodeError) -> SourceError {
    let path = path.to_path_buf();
    match error {
        DecodeError::UnknownKind => SourceError::UnknownKind { path },
        DecodeError::TooLarge(reason) => SourceError::TooLarge { path, reason },
        DecodeError::Damaged(reason) => SourceError::Damaged { path, reason },
    }
}
