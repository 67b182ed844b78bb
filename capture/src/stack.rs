//! `StackNode`: the tree of pictures that make up a frame.
//!
//! A picture has two dimensions, a multi-page file three, and a folder one more than its entries. A document of three
//! coordinates therefore takes a multi-page file, or a folder of pictures, as one frame; one of four takes a folder of
//! either.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_frame::{Buffer, Frame, Plane};

use crate::clock::Stamp;
use crate::files::{Content, FolderPrecedence, format_of, misnamed};
use crate::limits::LIMITS;
use crate::order::natural;
use crate::paged::{Address, OpenFile, Paged};
use crate::picture::{DecodeError, StoredPicture, check_size};
use crate::regular::ReadableFolder;
use crate::source::SourceError;

/// A tree of pictures.
#[derive(Clone, Debug)]
pub(crate) enum StackNode {
    /// A single-picture file.
    Image(PathBuf),
    /// A CSV file.
    Table(PathBuf),
    /// One page of a multi-page file, from 0.
    Page(Arc<Paged>, usize),
    /// Consecutive pages of a file: all of them, or those of one volume.
    Pages(Arc<Paged>, Range<usize>),
    /// The entries of a folder, all of one kind; or the volumes of a file.
    Folder(PathBuf, Vec<StackNode>),
}

impl StackNode {
    /// A file; multi-page formats by their number of pages and volumes.
    pub fn of_file(address: Address) -> Result<StackNode, SourceError> {
        let path = &address.path;
        let format = format_of(path).ok_or_else(|| SourceError::UnknownKind { path: path.clone() })?;
        let file = match format.content {
            Content::Picture { .. } => return Ok(StackNode::Image(address.path)),
            Content::Table => return Ok(StackNode::Table(address.path)),
            Content::Pages { .. } => Arc::new(Paged::of(address, format)?),
        };
        let all = 0..file.pages;
        Ok(match file.volume {
            _ if file.pages == 1 => StackNode::Page(file, 0),
            None => StackNode::Pages(file, all),
            Some(volume) => {
                let starts = all.step_by(volume);
                let volumes = starts.map(|start| StackNode::Pages(file.clone(), start..start + volume)).collect();
                StackNode::Folder(file.path.clone(), volumes)
            }
        })
    }

    /// A file in a folder. Closes multi-page files, to limit open file descriptors.
    pub fn of_entry(path: PathBuf, reach: &ReadableFolder) -> Result<StackNode, SourceError> {
        let node = StackNode::of_file(Address::of_entry(path, reach))?;
        if let StackNode::Page(file, _) | StackNode::Pages(file, _) = node.first() {
            file.close();
        }
        Ok(node)
    }

    /// A file, or a folder with its pictures or, if it has none, its subfolders, at most `levels` deep.
    pub fn of_path(address: Address, levels: usize) -> Result<StackNode, SourceError> {
        if !address.path.is_dir() {
            return StackNode::of_file(address);
        }
        let path = &address.path;
        let reach = &address.reach;
        let entries = entries(path, reach)?;
        let files = pictures_of(entries.iter().filter(|path| path.is_file()).cloned().collect());
        let nodes = match files.is_empty() {
            false => files.into_iter().map(|path| StackNode::of_entry(path, reach)).collect::<Result<Vec<_>, _>>()?,
            true => {
                let folders = entries.iter().filter(|path| path.is_dir() && levels > 1);
                let nodes = folders.map(|path| StackNode::of_path(Address::of_entry(path.clone(), reach), levels - 1));
                nodes.filter(|node| !matches!(node, Err(SourceError::Empty { .. }))).collect::<Result<_, _>>()?
            }
        };
        let Some(first) = nodes.first() else { return Err(SourceError::Empty { path: path.into() }) };
        if let Some(odd) = nodes.iter().find(|node| node.dimensions() != first.dimensions()) {
            let reason = format!("{} where {} is {}", odd.what(), first.name(), first.what());
            return Err(odd_one(odd.path(), &reason));
        }
        Ok(StackNode::Folder(path.into(), nodes))
    }

    /// Number of dimensions of its pixels.
    pub fn dimensions(&self) -> usize {
        match self {
            StackNode::Table(_) => 1,
            StackNode::Image(_) | StackNode::Page(..) => 2,
            StackNode::Pages(..) => 3,
            StackNode::Folder(_, nodes) => 1 + nodes.first().map_or(0, StackNode::dimensions),
        }
    }

    /// Description for messages.
    pub fn what(&self) -> String {
        match self {
            StackNode::Table(_) => "a table".into(),
            StackNode::Image(_) | StackNode::Page(..) => "one picture".into(),
            StackNode::Pages(file, _) => file.what(),
            StackNode::Folder(path, nodes) => match (nodes.len(), nodes.first()) {
                (_, Some(StackNode::Pages(file, _))) if file.path == *path => file.what(),
                (1, Some(first)) => format!("a folder of {}", first.what()),
                (n, Some(StackNode::Pages(..))) => format!("a folder of {n} stacks"),
                (n, Some(StackNode::Folder(..))) => format!("a folder of {n} folders"),
                (n, _) => format!("a folder of {n} pictures"),
            },
        }
    }

    pub fn path(&self) -> &Path {
        match self {
            StackNode::Image(path) | StackNode::Table(path) | StackNode::Folder(path, _) => path,
            StackNode::Page(file, _) | StackNode::Pages(file, _) => &file.path,
        }
    }

    /// Name of the file or folder; of a page with its number.
    pub fn name(&self) -> String {
        match self {
            StackNode::Page(file, page) => file.name_of(*page),
            StackNode::Pages(file, range) if range.len() < file.pages => file.name_of(range.start / range.len().max(1)),
            _ => self.path().file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        }
    }

    /// The first picture.
    pub fn first(&self) -> &StackNode {
        match self {
            StackNode::Folder(_, nodes) => nodes.first().map_or(self, StackNode::first),
            _ => self,
        }
    }

    /// Size beyond x and y: empty for a picture, slices, or slices and volumes.
    pub fn outer(&self) -> Result<Vec<usize>, SourceError> {
        match self {
            StackNode::Image(_) | StackNode::Table(_) | StackNode::Page(..) => Ok(Vec::new()),
            StackNode::Pages(_, range) => Ok(vec![range.len()]),
            StackNode::Folder(_, nodes) => {
                let mut size = nodes.first().map_or(Ok(Vec::new()), StackNode::outer)?;
                for node in nodes {
                    let other = node.outer()?;
                    if other != size {
                        let reason = format!("it has {} slices where {} has {}", other[0], nodes[0].name(), size[0]);
                        return Err(odd_one(node.path(), &reason));
                    }
                }
                size.push(nodes.len());
                Ok(size)
            }
        }
    }

    /// Time stamp of the first picture, if the file has one; `reader` must have read it last.
    pub fn stamp(&self, reader: &OpenFile) -> Option<Stamp> {
        match self {
            StackNode::Image(_) | StackNode::Table(_) => None,
            StackNode::Page(file, page) => reader.stamp(file, *page),
            StackNode::Pages(file, range) => reader.stamp(file, range.start),
            StackNode::Folder(_, nodes) => nodes.first()?.stamp(reader),
        }
    }

    /// Loads all its pictures as one frame.
    pub fn load(&self, reader: &mut OpenFile) -> Result<Frame, SourceError> {
        let outer = self.outer()?;
        let mut stack = Stack { slices: outer.iter().product(), outer, picture: None, name: String::new() };
        stack.add(self, reader)?;
        let Some(StoredPicture { size, format, stored, used, bytes }) = stack.picture else {
            return Err(SourceError::Empty { path: self.path().into() });
        };
        let buffer = Buffer::Owned(bytes.into());
        let planes = (0..used).map(|channel| Plane::interleaved(format, &buffer, size[0], stored, channel)).collect();
        let damaged = |reason: String| SourceError::Damaged { path: self.path().into(), reason };
        Frame::new(&[&size[..], &stack.outer].concat(), planes).map_err(|error| damaged(error.to_string()))
    }
}

/// Pictures being stacked.
struct Stack {
    outer: Vec<usize>,
    slices: usize,
    /// All pictures so far, concatenated.
    picture: Option<StoredPicture>,
    /// Name of the first picture.
    name: String,
}

impl Stack {
    fn add(&mut self, node: &StackNode, reader: &mut OpenFile) -> Result<(), SourceError> {
        match node {
            StackNode::Folder(_, nodes) => nodes.iter().try_for_each(|node| self.add(node, reader)),
            StackNode::Pages(file, range) => {
                range.clone().try_for_each(|page| self.add(&StackNode::Page(file.clone(), page), reader))
            }
            StackNode::Image(path) => {
                let Some(Content::Picture { picture, .. }) = format_of(path).map(|format| &format.content) else {
                    return Err(DecodeError::UnknownKind.in_file(path));
                };
                let bytes = read(path, &reader.reach)?;
                self.push(node, picture(&bytes).map_err(|error| misnamed(error, &bytes).in_file(path))?)
            }
            StackNode::Table(path) => Err(DecodeError::UnknownKind.in_file(path)),
            StackNode::Page(file, number) => self.push(node, reader.picture(file, *number)?),
        }
    }

    fn push(&mut self, node: &StackNode, picture: StoredPicture) -> Result<(), SourceError> {
        let Some(first) = &mut self.picture else {
            let pixels = (picture.size[0] * picture.size[1]) as u64 * self.slices as u64;
            if pixels > LIMITS.frame_pixels {
                let sides: Vec<String> = picture.size.iter().chain(&self.outer).map(usize::to_string).collect();
                let reason = format!(
                    "{} px are more than the {} that a frame may have; crop or bin its pictures, or take some out of it",
                    sides.join("×"),
                    LIMITS.frame_pixels
                );
                return Err(SourceError::TooLarge { path: node.path().into(), reason });
            }
            self.name = node.name();
            let mut picture = picture;
            picture.bytes.reserve_exact(picture.bytes.len() * (self.slices - 1));
            self.picture = Some(picture);
            return Ok(());
        };
        if first.kind() != picture.kind() {
            let reason = format!("{} has {} where {} has {}", node.name(), picture.what(), self.name, first.what());
            return Err(odd_one(node.path(), &reason));
        }
        first.bytes.extend_from_slice(&picture.bytes);
        Ok(())
    }
}

/// Size of a file's first picture.
pub(crate) fn picture_size(node: &StackNode, reach: &ReadableFolder) -> Option<[usize; 2]> {
    match node {
        StackNode::Image(path) => match format_of(path)?.content {
            Content::Picture { size, .. } => size(&read(path, reach).ok()?).ok(),
            Content::Pages { .. } | Content::Table => None,
        },
        StackNode::Page(file, page) => file.size(*page),
        StackNode::Pages(file, range) => file.size(range.start),
        StackNode::Table(_) | StackNode::Folder(..) => None,
    }
}

/// Checks the declared size of the first picture only: one that is too large fails in every frame. Other faults are reported
/// when the file is read, and may be fixed by then.
pub(crate) fn check_picture(node: &StackNode, reach: &ReadableFolder) -> Result<(), SourceError> {
    let sized = match node {
        StackNode::Image(path) => match format_of(path).map(|format| &format.content) {
            Some(Content::Picture { size, .. }) => match read(path, reach) {
                Ok(bytes) => size(&bytes),
                Err(error @ SourceError::TooLarge { .. }) => return Err(error),
                Err(_) => return Ok(()),
            },
            _ => return Ok(()),
        },
        StackNode::Page(..) | StackNode::Pages(..) => match picture_size(node, reach) {
            Some(size) => Ok(size),
            None => return Ok(()),
        },
        StackNode::Table(_) | StackNode::Folder(..) => return Ok(()),
    };
    let side = |px: usize| u32::try_from(px).unwrap_or(u32::MAX);
    match sized.and_then(|[width, height]| check_size(side(width), side(height))) {
        Err(fault @ DecodeError::TooLarge(_)) => Err(fault.in_file(node.path())),
        _ => Ok(()),
    }
}

/// Frame files and subfolders of a folder, in natural order.
pub(crate) fn entries(folder: &Path, reach: &ReadableFolder) -> Result<Vec<PathBuf>, SourceError> {
    let unreadable = |reason| SourceError::Unreadable { path: folder.into(), reason };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(reach.resolve(folder).map_err(unreadable)?).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if format_of(&path).is_none() && !path.is_dir() {
            continue;
        }
        if found.len() == LIMITS.files {
            return Err(SourceError::too_many(folder));
        }
        found.push((name, path));
    }
    found.sort_by(|a, b| natural(&a.0, &b.0));
    Ok(found.into_iter().map(|(_, path)| path).collect())
}

/// The picture files of a folder; none if it has only tables.
pub(crate) fn pictures_of(mut files: Vec<PathBuf>) -> Vec<PathBuf> {
    let precedence = |path: &PathBuf| format_of(path).map_or(FolderPrecedence::Tables, |format| format.precedence);
    let first = files.iter().map(precedence).min().unwrap_or(FolderPrecedence::Tables);
    files.retain(|path| first != FolderPrecedence::Tables && precedence(path) == first);
    files
}

fn odd_one(path: &Path, reason: &str) -> SourceError {
    SourceError::Odd { path: path.into(), reason: reason.into() }
}

/// Reads a file within the size limit.
pub(crate) fn read(path: &Path, reach: &ReadableFolder) -> Result<Vec<u8>, SourceError> {
    let unreadable = |reason| SourceError::Unreadable { path: path.into(), reason };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > LIMITS.file_bytes {
        let reason = format!("{bytes} bytes; at most {} are read", LIMITS.file_bytes);
        return Err(SourceError::TooLarge { path: path.into(), reason });
    }
    reach.read(path, LIMITS.file_bytes).map_err(unreadable)
}
