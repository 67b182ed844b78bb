//! MCAP reader: the pictures of one topic, ordered by log time.
//!
//! It holds at most two decompressed chunks and an index in memory, and ignores all other topics.
//!
//! ```text
//! file ─► index (records) ─► chunk ─► message (protobuf, ros, JSON) ─┬─► decode (PNG, JPEG)
//!                                                                    └─► pixels ─► Picture
//! ```

mod chunk;
mod index;
mod message;
mod messages;
mod pixels;
mod protobuf;
mod records;
mod ros;

use std::collections::{BTreeSet, VecDeque};
use std::fs::File;
use std::io::BufReader;

use super::format::{Content, FolderPrecedence, Format, PageFault, Pages, Topics};
use super::image;
use crate::clock::Stamp;
use crate::limits::LIMITS;
use crate::picture::{DecodeError, StoredPicture};

pub(crate) use chunk::{Chunk, unpack};
pub(crate) use index::content;
pub use messages::{LogMessage, LogReader};
pub(crate) use records::{CHUNK_HEAD_BYTES, MAGIC, chunk_header, head, record, split};

use index::{Index, PictureRecord, PictureTopic};
use message::{Image, MessageFields};
pub(crate) use records::HEAD_BYTES;
use records::{Record, op};

pub(crate) const FORMAT: Format = Format {
    name: "MCAP",
    extensions: &["mcap"],
    signatures: &[records::MAGIC],
    content: Content::Pages {
        words: ["an MCAP file", "pictures"],
        open: |file, topic| Ok(Box::new(Mcap::open(file, topic)?)),
        topics: Topics::Named,
    },
    precedence: FolderPrecedence::Recordings,
};

/// Decompressed chunks kept in memory: two may overlap in time.
const CHUNKS_KEPT: usize = 2;

/// Topics listed in an error message.
const TOPICS_SHOWN: usize = 20;

/// An open file.
struct Mcap {
    file: BufReader<File>,
    file_bytes: u64,
    index: Index,
    unpacked: VecDeque<(u32, Vec<u8>)>,
}

impl Mcap {
    /// Indexes the pictures and keeps those of `topic`, or of the only one.
    pub fn open(file: File, topic: Option<&str>) -> Result<Mcap, PageFault> {
        let file_bytes = file.metadata()?.len();
        let mut file = BufReader::new(file);
        let mut index = Index::of(&mut file, file_bytes)?;
        let topic = chosen(&index, topic)?;
        let Index { streams, pictures, .. } = &mut index;
        pictures.retain(|picture| {
            streams.get(&picture.channel).is_some_and(|s| s.as_ref().is_some_and(|s| s.topic == topic))
        });
        Ok(Mcap { file, file_bytes, index, unpacked: VecDeque::new() })
    }

    /// Passes the picture at index `page` to `read`.
    fn with_image<T>(
        &mut self,
        page: usize,
        read: impl FnOnce(Image) -> Result<T, DecodeError>,
    ) -> Result<T, PageFault> {
        let wrong = || DecodeError::Damaged(format!("message {page} is not where the file says"));
        if page == self.index.pictures.len() && !self.index.is_whole {
            return Err(DecodeError::Damaged(format!("it breaks off behind picture {page}")).into());
        }
        let picture = *self.index.pictures.get(page).ok_or_else(wrong)?;
        let Some(Some(stream)) = self.index.streams.get(&picture.channel) else { return Err(wrong().into()) };
        let unchunked;
        let record = match picture.chunk {
            Some(number) => {
                let at = self.unpacked.iter().position(|(known, _)| *known == number);
                if at.is_none() {
                    self.unpacked.truncate(CHUNKS_KEPT - 1);
                    let chunk = self.index.chunks.get(number as usize).ok_or_else(wrong)?;
                    self.unpacked.push_front((number, chunk::unpack(&mut self.file, chunk)?));
                }
                let (_, unpacked) = &self.unpacked[at.unwrap_or(0)];
                usize::try_from(picture.offset).ok().and_then(|offset| records::split(unpacked.get(offset..)?))
            }
            None => {
                unchunked = record_at(&mut self.file, self.file_bytes, picture)?;
                records::split(&unchunked)
            }
        };
        let message = record.filter(|(opcode, ..)| *opcode == op::MESSAGE);
        let message = message.and_then(|(opcode, content, _)| records::record(opcode, content));
        let Some(Record::Message { header, data }) = message else { return Err(wrong().into()) };
        if header.channel_id != picture.channel {
            return Err(wrong().into());
        }
        let PictureTopic { layout, encoding, .. } = stream;
        Ok(message::image(*layout, encoding, &data).and_then(read)?)
    }
}

/// Reads a record outside chunks.
fn record_at(file: &mut BufReader<File>, file_bytes: u64, picture: PictureRecord) -> Result<Vec<u8>, PageFault> {
    let head = index::content_of(file, picture.offset, HEAD_BYTES as u64, HEAD_BYTES as u64)?;
    let bytes = records::head(&head).and_then(|(_, bytes)| bytes.checked_add(HEAD_BYTES as u64));
    let end = bytes.and_then(|bytes| picture.offset.checked_add(bytes));
    match bytes.filter(|_| end.is_some_and(|end| end <= file_bytes)) {
        Some(bytes) => index::content_of(file, picture.offset, bytes, LIMITS.file_bytes),
        None => Err(DecodeError::Damaged("a message is cut off".into()).into()),
    }
}

/// Resolves the wanted topic.
fn chosen(index: &Index, wanted: Option<&str>) -> Result<String, DecodeError> {
    let of = |picture: &PictureRecord| index.streams.get(&picture.channel)?.as_ref();
    let is_video = |stream: &&PictureTopic| stream.layout == MessageFields::FoxgloveVideo;
    let streams = || index.pictures.iter().filter_map(of);
    let mut topics: BTreeSet<&str> =
        streams().filter(|stream| !is_video(stream)).map(|stream| stream.topic.as_str()).collect();
    // A video is chosen only if there is nothing else: the error for its first picture then names its compression.
    if topics.is_empty()
        || wanted.is_some_and(|wanted| streams().any(|stream| is_video(&stream) && stream.topic == wanted))
    {
        topics.extend(streams().map(|stream| stream.topic.as_str()));
    }
    let mut shown: Vec<String> =
        topics.iter().take(TOPICS_SHOWN).map(|topic| topic.escape_debug().to_string()).collect();
    if let Some(more) = topics.len().checked_sub(TOPICS_SHOWN).filter(|more| *more > 0) {
        shown.push(format!("and {more} more"));
    }
    let shown = shown.join(", ");
    let first = topics.first().copied().unwrap_or_default().escape_debug();
    let unsupported = |reason| Err(DecodeError::Unsupported(reason));
    match (wanted, topics.len()) {
        (_, 0) if !index.is_whole => Err(DecodeError::Damaged(format!(
            "it breaks off: the record at byte {} is not whole, and no image stands before it; mcap recover FILE -o OUT.mcap may \
             save some of what is in it",
            index.end
        ))),
        (_, 0) => {
            let others: Vec<&str> = index.others.iter().map(String::as_str).collect();
            let found =
                if others.is_empty() { String::new() } else { format!(" (its messages are {})", others.join(", ")) };
            unsupported(format!(
                "there are no images in it{found}; of MCAP the topics with foxglove.CompressedImage, foxglove.RawImage and \
                 ROS's sensor_msgs Image and CompressedImage are read"
            ))
        }
        (Some(wanted), _) if topics.contains(wanted) => Ok(wanted.into()),
        (Some(wanted), _) => unsupported(format!("no images stand on the topic {wanted}; they do on {shown}")),
        (None, 1) => Ok(topics.first().copied().unwrap_or_default().into()),
        (None, _) => unsupported(format!(
            "it holds images on several topics, {shown}; name one behind the file: FILE.mcap#{first}"
        )),
    }
}

impl Pages for Mcap {
    fn count(&mut self, most: usize) -> Result<usize, PageFault> {
        // A truncated file counts one picture more; reading it gives the error.
        let pictures = self.index.pictures.len() + usize::from(!self.index.is_whole);
        Ok(pictures.min(most.saturating_add(1)))
    }

    fn stamp(&self, page: usize) -> Option<Stamp> {
        self.index.pictures.get(page).map(|picture| Stamp::LogTime(picture.log_time))
    }

    fn size(&mut self, page: usize) -> Result<[usize; 2], PageFault> {
        self.with_image(page, |image| match image {
            Image::Compressed { bytes, .. } => image::size(&bytes),
            Image::Raw(raw) => pixels::size(&raw),
        })
    }

    fn picture(&mut self, page: usize) -> Result<StoredPicture, PageFault> {
        self.with_image(page, |image| match image {
            Image::Compressed { format, bytes } => image::picture(&bytes).map_err(|error| match error {
                DecodeError::UnknownKind => {
                    let shown: String = format.chars().filter(|c| !c.is_control()).take(40).collect();
                    DecodeError::Unsupported(format!(
                        "its images are compressed as `{shown}`; png and jpeg are read, so record it as these or raw"
                    ))
                }
                other => other,
            }),
            Image::Raw(raw) => pixels::picture(&raw),
        })
    }
}

const _: () = assert!(LIMITS.files <= u32::MAX as usize, "chunks are counted in u32");
