//! Recordings: pictures, stacks of pictures, or CSV files, as a source of frames.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_frame::Frame;

use crate::clock::{Clock, Stamp};
use crate::files::csv::Columns;
use crate::files::format_of;
use crate::limits::LIMITS;
use crate::paged::{Address, OpenFile, Paged};
use crate::regular::ReadableFolder;
use crate::source::{Captured, FrameSource, Reel, SourceError};
use crate::stack::{StackNode, check_picture, entries, picture_size, pictures_of, read};
use crate::truth::{self, Truth};

/// Files as frames, in natural name order, decoded one at a time.
///
/// In a folder, the PNG, JPEG, TIFF and FITS files count; if there are none, Y4M and MCAP files; else CSV files. Everything
/// else (licences, notes) is ignored. Each page of a TIFF or FITS file, each frame of a video and each image of an MCAP file
/// is a frame. If an MCAP file holds several image topics, the path names one behind a `#`: `run.mcap#/camera/image`.
/// [`Recording::of_dimensions`] builds stacks of pictures, from subfolders as well; [`Recording::for_channels`] matches the
/// planes to a model.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    topic: Option<String>,
    frames: Vec<StackNode>,
    next: usize,
    sequence: u64,
    channels: Option<Vec<String>>,
    truth: BTreeMap<String, Truth>,
    clock: Clock,
    /// State before the last frame, for [`FrameSource::take_back`].
    clock_before: Clock,
    file: OpenFile,
}

impl Recording {
    /// Opens a folder or a file of pictures. Reads no pixels yet.
    pub fn open(path: impl AsRef<Path>) -> Result<Recording, SourceError> {
        Recording::of_dimensions(path, 2)
    }

    /// Opens a folder or a file for a document with `dimensions` coordinates. Up to two, every picture and every page is a
    /// frame. A frame of three dimensions is a multi-page file, or all pictures of a folder; one of four is a folder of
    /// either. A folder of such frames is a recording of them.
    pub fn of_dimensions(path: impl AsRef<Path>, dimensions: usize) -> Result<Recording, SourceError> {
        Recording::within(path, dimensions, &ReadableFolder::default())
    }

    /// Like [`Recording::of_dimensions`], restricted to files within `reach`, checked whenever a file is opened.
    pub fn within(path: impl AsRef<Path>, dimensions: usize, reach: &ReadableFolder) -> Result<Recording, SourceError> {
        Recording::opened(path.as_ref(), dimensions, reach).map_err(|error| error.within(reach))
    }

    fn opened(sent: &Path, dimensions: usize, reach: &ReadableFolder) -> Result<Recording, SourceError> {
        let sent = sent.to_path_buf();
        let named = Address::of(&sent, reach.clone()).path;
        let wrong = |reason: std::io::Error| match reason.kind() {
            std::io::ErrorKind::NotFound => SourceError::Missing { path: named.clone() },
            _ => SourceError::Unreadable { path: named.clone(), reason },
        };
        let mut address = Address::of(&reach.normalize(&sent).map_err(wrong)?, reach.clone());
        address.path = reach.resolve(&address.path).map_err(wrong)?;
        let (path, topic) = (address.path.clone(), address.topic.clone());
        let metadata = std::fs::metadata(&path).map_err(wrong)?;
        if !metadata.is_dir() {
            // Opening a pipe would block.
            if !metadata.is_file() {
                let reason = std::io::Error::other("it is neither a file nor a folder");
                return Err(SourceError::Unreadable { path, reason });
            }
            format_of(&path).ok_or_else(|| SourceError::UnknownKind { path: path.clone() })?;
        }
        let (frames, is_folder) = match dimensions {
            0..=2 if metadata.is_dir() => {
                let entries = files_of(&path, reach)?.into_iter().map(|path| StackNode::of_entry(path, reach));
                (pictures(entries)?, true)
            }
            0..=2 => (pictures([StackNode::of_file(address)])?, false),
            _ => stacks(address, dimensions)?,
        };
        // truth.jsonl is next to the frames.
        let folder = if is_folder && metadata.is_dir() { Some(path.as_path()) } else { path.parent() };
        let truth = folder.map_or_else(|| Ok(BTreeMap::new()), |folder| truth::read(folder, reach))?;
        Ok(Recording {
            path,
            topic,
            frames,
            next: 0,
            sequence: 0,
            channels: None,
            truth,
            clock: Clock::default(),
            clock_before: Clock::default(),
            file: OpenFile::new(reach.clone()),
        })
    }

    /// Matches every frame's planes to the channels of a model: one channel takes the only plane or the Rec. 601 luma of a
    /// colour image; three take r, g, b in this order; a CSV file yields the columns of these names.
    pub fn for_channels(mut self, channels: &[String]) -> Recording {
        self.channels = Some(channels.to_vec());
        self
    }

    /// Frame rate, Hz, for frames without a time in their file or in `truth.jsonl`. Without a rate they have no time.
    pub fn at_rate(mut self, rate_hz: f64) -> Recording {
        self.clock.rate_hz = (rate_hz > 0.0 && rate_hz.is_finite()).then_some(rate_hz);
        self
    }

    /// The file or folder, without its topic.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Path for requests: relative to the readable folder, with the topic.
    pub fn address(&self) -> String {
        let path = self.file.reach.relative(&self.path).to_string_lossy();
        self.topic.as_ref().map_or_else(|| path.to_string(), |topic| format!("{path}#{topic}"))
    }

    /// Checks the size that the first picture declares, before frames are read.
    ///
    /// # Errors
    /// It is too large. Other faults are reported when the picture is read.
    pub fn check_picture(&self) -> Result<(), SourceError> {
        let reach = &self.file.reach;
        check_picture(self.frames[0].first(), reach).map_err(|error| error.within(reach))
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Never true: an empty recording cannot be opened.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// The column names of the first file's header; `None` if it is an image.
    pub fn csv_channels(&self) -> Result<Option<Vec<String>>, SourceError> {
        let StackNode::Table(path) = &self.frames[0] else { return Ok(None) };
        let reach = &self.file.reach;
        let columns = read(path, reach).and_then(|bytes| Columns::parse(path, &bytes));
        columns.map(|columns| Some(columns.names)).map_err(|error| error.within(reach))
    }

    /// Returns to the first file; sequence numbers and time continue.
    pub fn rewind(&mut self) {
        self.seek(0);
    }

    fn load(&mut self, node: &StackNode) -> Result<Frame, SourceError> {
        let path = node.path();
        if let StackNode::Table(path) = node {
            let table = Columns::parse(path, &read(path, &self.file.reach)?)?;
            return table.frame(path, self.channels.as_ref().unwrap_or(&table.names));
        }
        let frame = node.load(&mut self.file)?;
        match &self.channels {
            Some(channels) => fitted(path, frame, channels),
            None => Ok(frame),
        }
    }
}

impl FrameSource for Recording {
    fn next(&mut self) -> Result<Option<Captured>, SourceError> {
        let Some(node) = self.frames.get(self.next).cloned() else { return Ok(None) };
        self.next += 1;
        self.clock_before = self.clock.clone();
        let sequence = self.sequence;
        self.sequence += 1;
        let frame = self.load(&node).map_err(|error| error.within(&self.file.reach));
        let file = node.name();
        let truth = self.truth.get(&file);
        let told = truth.and_then(|truth| truth.t_s).map(Stamp::Seconds);
        // An unreadable frame advances the clock, too.
        let time_s = self.clock.time_s(told.or_else(|| node.stamp(&self.file)));
        let frame = frame?.with_sequence(sequence).with_time_s(time_s);
        let truth = truth.map(|truth| truth.parameters.clone());
        Ok(Some(Captured { frame, file: Some(file).filter(|name| !name.is_empty()), truth }))
    }

    fn description(&self) -> String {
        format!("recording {} ({} frames)", self.path.display(), self.frames.len())
    }

    fn reel(&mut self) -> Option<&mut dyn Reel> {
        Some(self)
    }

    fn take_back(&mut self) -> bool {
        let (Some(next), Some(sequence)) = (self.next.checked_sub(1), self.sequence.checked_sub(1)) else {
            return false;
        };
        (self.next, self.sequence, self.clock) = (next, sequence, self.clock_before.clone());
        true
    }

    fn size(&self) -> Option<Vec<usize>> {
        let node = &self.frames[0];
        if let StackNode::Table(path) = node {
            return Some(vec![Columns::parse(path, &read(path, &self.file.reach).ok()?).ok()?.columns[0].len()]);
        }
        Some([&picture_size(node.first(), &self.file.reach)?[..], &node.outer().ok()?].concat())
    }
}

impl Reel for Recording {
    fn count(&self) -> usize {
        self.frames.len()
    }

    fn place(&self) -> usize {
        self.next
    }

    fn seek(&mut self, place: usize) {
        self.next = place.min(self.frames.len());
        self.clock.rewind();
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

/// Expands files to frames: every picture, every page and every table is one.
fn pictures(files: impl IntoIterator<Item = Result<StackNode, SourceError>>) -> Result<Vec<StackNode>, SourceError> {
    let mut frames = Vec::new();
    for file in files {
        match file? {
            StackNode::Pages(file, range) => add(&mut frames, &file, range)?,
            StackNode::Folder(_, volumes) => {
                for volume in volumes {
                    if let StackNode::Pages(file, range) = volume {
                        add(&mut frames, &file, range)?;
                    }
                }
            }
            node => frames.push(node),
        }
    }
    Ok(frames)
}

fn add(frames: &mut Vec<StackNode>, file: &Arc<Paged>, pages: Range<usize>) -> Result<(), SourceError> {
    if frames.len() + pages.len() > LIMITS.files {
        return Err(SourceError::too_many(&file.path));
    }
    frames.extend(pages.map(|page| StackNode::Page(file.clone(), page)));
    Ok(())
}

/// The frames; true if the folder holds several.
fn stacks(address: Address, dimensions: usize) -> Result<(Vec<StackNode>, bool), SourceError> {
    let path = address.path.clone();
    let node = StackNode::of_path(address, dimensions - 1)?;
    let wanted = match dimensions {
        3 => "a TIFF of several pages, a folder of pictures, or a folder of such stacks",
        _ => "a folder of TIFFs of several pages, a folder of folders of pictures, or a folder of such folders",
    };
    let wrong = |what: String| {
        let reason = format!("{what}, but the document has {dimensions} coordinates and is fitted to {wanted}");
        Err(SourceError::Dimensions { path: path.clone(), reason })
    };
    let (frames, is_folder) = match node {
        StackNode::Folder(_, nodes) if nodes.first().is_some_and(|node| node.dimensions() == dimensions) => {
            (nodes, true)
        }
        node if node.dimensions() == dimensions => (vec![node], false),
        node => return wrong(node.what()),
    };
    // One slice does not determine a target's z.
    if let Some(flat) = frames.iter().find(|node| matches!(node, StackNode::Folder(_, nodes) if nodes.len() < 2)) {
        return wrong(flat.what());
    }
    Ok((frames, is_folder))
}

fn files_of(folder: &Path, reach: &ReadableFolder) -> Result<Vec<PathBuf>, SourceError> {
    let mut files = entries(folder, reach)?;
    files.retain(|path| path.is_file());
    let pictures = pictures_of(files.clone());
    if !pictures.is_empty() {
        files = pictures;
    }
    if files.is_empty() {
        return Err(SourceError::Empty { path: folder.into() });
    }
    Ok(files)
}
