//! MCAP, the recordings of robots: one topic of images in, its pictures out in the order of their log times.
//!
//! In: a file, and the name of a topic where it holds several of images. Out: pages. It never holds more of the file than
//! two chunks and an index, and knows nothing of what else was recorded.
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

use super::format::{Beside, Content, Format, PageFault, Pages, Topics};
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
    beside: Beside::Recordings,
};

/// Unpacked chunks that are kept: two may overlap in time.
const CHUNKS_KEPT: usize = 2;

/// Topics that are listed in a message.
const TOPICS_SHOWN: usize = 20;

/// An open file.
struct Mcap {
    file: BufReader<File>,
    file_bytes: u64,
    index: Index,
    unpacked: VecDeque<(u32, Vec<u8>)>,
}

impl Mcap {
    /// Finds a file's pictures and keeps those of `topic`, or of the only one.
    pub fn open(file: File, topic: Option<&str>) -> Result<Mcap, PageFault> {
        let file_bytes = file.metadata()?.len();
        let mut file = BufReader::new(file);
        let mut index = Index::of(&mut file, file_bytes)?;
        let topic = chosen(&index, topic)?;
        let Index { streams, places, .. } = &mut index;
        places
            .retain(|place| streams.get(&place.channel).is_some_and(|s| s.as_ref().is_some_and(|s| s.topic == topic)));
        Ok(Mcap { file, file_bytes, index, unpacked: VecDeque::new() })
    }

    /// The picture of a place, handed to `read`.
    fn with_image<T>(
        &mut self,
        page: usize,
        read: impl FnOnce(Image) -> Result<T, DecodeError>,
    ) -> Result<T, PageFault> {
        let wrong = || DecodeError::Damaged(format!("message {page} is not where the file says"));
        if page == self.index.places.len() && !self.index.is_whole {
            return Err(DecodeError::Damaged(format!("it breaks off behind picture {page}")).into());
        }
        let place = *self.index.places.get(page).ok_or_else(wrong)?;
        let Some(Some(stream)) = self.index.streams.get(&place.channel) else { return Err(wrong().into()) };
        let standing;
        let record = match place.chunk {
            Some(number) => {
                let at = self.unpacked.iter().position(|(known, _)| *known == number);
                if at.is_none() {
                    self.unpacked.truncate(CHUNKS_KEPT - 1);
                    let chunk = self.index.chunks.get(number as usize).ok_or_else(wrong)?;
                    self.unpacked.push_front((number, chunk::unpack(&mut self.file, chunk)?));
                }
                let (_, unpacked) = &self.unpacked[at.unwrap_or(0)];
                usize::try_from(place.offset).ok().and_then(|offset| records::split(unpacked.get(offset..)?))
            }
            None => {
                standing = record_at(&mut self.file, self.file_bytes, place)?;
                records::split(&standing)
            }
        };
        let message = record.filter(|(opcode, ..)| *opcode == op::MESSAGE);
        let message = message.and_then(|(opcode, content, _)| records::record(opcode, content));
        let Some(Record::Message { header, data }) = message else { return Err(wrong().into()) };
        if header.channel_id != place.channel {
            return Err(wrong().into());
        }
        let PictureTopic { layout, encoding, .. } = stream;
        Ok(message::image(*layout, encoding, &data).and_then(read)?)
    }
}

/// The bytes of a record that stands in the file itself.
fn record_at(file: &mut BufReader<File>, file_bytes: u64, place: PictureRecord) -> Result<Vec<u8>, PageFault> {
    let head = index::content_of(file, place.offset, HEAD_BYTES as u64, HEAD_BYTES as u64)?;
    let bytes = records::head(&head).and_then(|(_, bytes)| bytes.checked_add(HEAD_BYTES as u64));
    let end = bytes.and_then(|bytes| place.offset.checked_add(bytes));
    match bytes.filter(|_| end.is_some_and(|end| end <= file_bytes)) {
        Some(bytes) => index::content_of(file, place.offset, bytes, LIMITS.file_bytes),
        None => Err(DecodeError::Damaged("a message is cut off".into()).into()),
    }
}

/// The topic that is meant.
fn chosen(index: &Index, wanted: Option<&str>) -> Result<String, DecodeError> {
    let of = |place: &PictureRecord| index.streams.get(&place.channel)?.as_ref();
    let is_video = |stream: &&PictureTopic| stream.layout == MessageFields::FoxgloveVideo;
    let streams = || index.places.iter().filter_map(of);
    let mut topics: BTreeSet<&str> =
        streams().filter(|stream| !is_video(stream)).map(|stream| stream.topic.as_str()).collect();
    // A video is the choice only where nothing else is: its first picture says what it is compressed as.
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
        // One that breaks off has a picture more than can be read: reading it says so.
        let pictures = self.index.places.len() + usize::from(!self.index.is_whole);
        Ok(pictures.min(most.saturating_add(1)))
    }

    fn stamp(&self, page: usize) -> Option<Stamp> {
        self.index.places.get(page).map(|place| Stamp::LogTime(place.log_time))
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
