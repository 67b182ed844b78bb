//! Reads the messages in the chunks of an MCAP file in write order, with topic, schema, time and, for pictures, the frame.
//!
//! It holds one decompressed chunk, and stops after the last complete one.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_frame::{Buffer, Frame, Plane};

use super::chunk::{self, Chunk};
use super::index::content;
use super::message::{self, Image, MessageEncoding, MessageFields};
use super::records::{self, CHUNK_HEAD_BYTES, HEAD_BYTES, MAGIC, Record, op};
use super::{image, pixels};
use crate::files::PageFault;
use crate::picture::{DecodeError, StoredPicture};
use crate::source::SourceError;

/// Channel of a message.
#[derive(Clone)]
struct LogTopic {
    topic: Arc<str>,
    schema: Arc<str>,
    encoding: MessageEncoding,
}

/// One message.
pub struct LogMessage {
    /// Topic of its channel.
    pub topic: Arc<str>,
    /// Name of its schema, such as `isophote.Estimate`.
    pub schema: Arc<str>,
    /// Log time, ns since 1970.
    pub log_time: u64,
    /// Payload as written.
    pub payload: Vec<u8>,
    encoding: MessageEncoding,
}

impl LogMessage {
    /// Decodes its picture; `None` for other messages.
    ///
    /// # Errors
    /// The picture cannot be decoded.
    pub fn frame(&self) -> Option<Result<Frame, DecodeError>> {
        let fields = MessageFields::of(&self.schema)?;
        Some(message::image(fields, &self.encoding, &self.payload).and_then(frame))
    }

    /// Whether its picture is a JPEG, and so lossy.
    pub fn is_jpeg(&self) -> bool {
        let fields = MessageFields::of(&self.schema);
        let image = fields.and_then(|fields| message::image(fields, &self.encoding, &self.payload).ok());
        matches!(image, Some(Image::Compressed { bytes, .. }) if image::JPEG.matches_signature(&bytes))
    }
}

fn frame(image: Image) -> Result<Frame, DecodeError> {
    let StoredPicture { size, format, stored, used, bytes } = match image {
        Image::Compressed { bytes, .. } => image::picture(&bytes)?,
        Image::Raw(raw) => pixels::picture(&raw)?,
    };
    let buffer = Buffer::Owned(bytes.into());
    let planes = (0..used).map(|channel| Plane::interleaved(format, &buffer, size[0], stored, channel)).collect();
    Frame::new(&size, planes).map_err(|error| DecodeError::Damaged(error.to_string()))
}

/// An MCAP file open for reading.
pub struct LogReader {
    path: PathBuf,
    file: BufReader<File>,
    file_bytes: u64,
    at: u64,
    schemas: BTreeMap<u16, Arc<str>>,
    topics: BTreeMap<u16, LogTopic>,
    unpacked: Vec<u8>,
    /// Offset of the next record in `unpacked`.
    next: usize,
}

impl LogReader {
    /// Opens a file.
    ///
    /// # Errors
    /// It cannot be read or is not an MCAP file.
    pub fn open(path: &Path) -> Result<LogReader, SourceError> {
        let wrong = |fault: PageFault| fault.in_file(path);
        let file = crate::regular::open_regular(path).map_err(|error| wrong(error.into()))?;
        let file_bytes = file.metadata().map_err(|error| wrong(error.into()))?.len();
        let mut file = BufReader::new(file);
        let at = MAGIC.len() as u64;
        if file_bytes < at || content(&mut file, 0, at).map_err(wrong)? != MAGIC {
            return Err(wrong(DecodeError::Damaged("it is no MCAP file".into()).into()));
        }
        let (schemas, topics, unpacked) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        Ok(LogReader { path: path.into(), file, file_bytes, at, schemas, topics, unpacked, next: 0 })
    }

    /// The next message; `None` at the end, and where the file is truncated.
    ///
    /// # Errors
    /// A chunk cannot be decompressed.
    pub fn next_message(&mut self) -> Result<Option<LogMessage>, SourceError> {
        loop {
            if let Some(message) = self.of_chunk().map_err(|fault| fault.in_file(&self.path))? {
                return Ok(Some(message));
            }
            if !self.chunk().map_err(|fault| fault.in_file(&self.path))? {
                return Ok(None);
            }
        }
    }

    fn of_chunk(&mut self) -> Result<Option<LogMessage>, PageFault> {
        while self.next < self.unpacked.len() {
            let rest = &self.unpacked[self.next..];
            let damaged = || DecodeError::Damaged("a record of a chunk cannot be read".into());
            let (opcode, content, behind) = records::split(rest).ok_or_else(damaged)?;
            self.next = self.unpacked.len() - behind.len();
            match records::record(opcode, content) {
                Some(Record::Schema { header, .. }) => drop(self.schemas.insert(header.id, header.name.into())),
                Some(Record::Channel(channel)) => {
                    let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_else(|| "".into());
                    let encoding = MessageEncoding::of(&channel.message_encoding);
                    self.topics.insert(channel.id, LogTopic { topic: channel.topic.into(), schema, encoding });
                }
                Some(Record::Message { header, data }) => {
                    let Some(LogTopic { topic, schema, encoding }) = self.topics.get(&header.channel_id).cloned()
                    else {
                        return Err(damaged().into());
                    };
                    let (log_time, payload) = (header.log_time, data.into_owned());
                    return Ok(Some(LogMessage { topic, schema, log_time, payload, encoding }));
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Decompresses the next chunk; false if there is none.
    fn chunk(&mut self) -> Result<bool, PageFault> {
        while self.at + HEAD_BYTES as u64 <= self.file_bytes {
            let head = content(&mut self.file, self.at, HEAD_BYTES as u64)?;
            let begin = self.at + HEAD_BYTES as u64;
            let Some((opcode, bytes)) = records::head(&head) else { break };
            let Some(end) = begin.checked_add(bytes).filter(|end| *end <= self.file_bytes) else { break };
            self.at = end;
            match opcode {
                op::DATA_END | op::FOOTER => break,
                op::CHUNK => {
                    let head = content(&mut self.file, begin, bytes.min(CHUNK_HEAD_BYTES as u64))?;
                    let chunk = Chunk::parse(&head, [begin, end]);
                    let chunk = chunk.ok_or_else(|| DecodeError::Damaged("a chunk cannot be read".into()))?;
                    (self.unpacked, self.next) = (chunk::unpack(&mut self.file, &chunk)?, 0);
                    return Ok(true);
                }
                _ => {}
            }
        }
        self.at = self.file_bytes;
        Ok(false)
    }
}
