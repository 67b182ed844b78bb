//! Indexes the pictures of an MCAP file by log time.
//!
//! The file is walked record by record. Chunks are skipped: the message indexes after them list their content, and the
//! summary at the end of the file lists the channels. A chunk is decompressed only if one of these is missing (a recorder
//! that crashed or writes none). The walk ends where the file is truncated.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use crate::files::PageFault;
use crate::limits::LIMITS;
use crate::picture::DecodeError;

use super::chunk::{self, Chunk};
use super::message::{MessageEncoding, MessageFields};
use super::records::{self, CHUNK_HEAD_BYTES, HEAD_BYTES, MAGIC, MESSAGE_BYTES, NONE, Record, op};

/// Most bytes of a schema, channel or message index record, and of a topic name; `INDEXES_MAX` and `PICTURES_MAX` limit
/// the message indexes and the pictures of all topics.
const RECORD_BYTES_MAX: u64 = 64 << 20;
const TOPIC_BYTES_MAX: usize = 1024;
/// Bytes decompressed to find the pictures: at most this, or this multiple of the file's size if that is more.
const UNPACKED_BYTES_MAX: u64 = 16 << 30;
const UNPACKED_TIMES_MAX: u64 = 4;
/// A budget: names of other schemas shown in an error message.
const OTHERS_MAX: usize = 10;
const INDEXES_MAX: usize = 4_000_000;
const PICTURES_MAX: usize = 4_000_000;

/// A channel with picture messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PictureTopic {
    pub topic: String,
    pub layout: MessageFields,
    pub encoding: MessageEncoding,
}

/// Location of a picture message.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureRecord {
    pub log_time: u64,
    pub channel: u16,
    /// Index into [`Index::chunks`]; `None` if the message is outside chunks.
    pub chunk: Option<u32>,
    /// Offset of its record in the decompressed chunk, or in the file.
    pub offset: u64,
}

/// Index of a file.
#[derive(Default)]
pub(super) struct Index {
    schemas: BTreeMap<u16, Option<MessageFields>>,
    /// Names of some non-picture schemas.
    pub others: BTreeSet<String>,
    /// By channel id; `None` for non-picture channels.
    pub streams: BTreeMap<u16, Option<PictureTopic>>,
    pub chunks: Vec<Chunk>,
    /// Message indexes of each chunk: channel, offset of the content, bytes.
    indexes: Vec<Vec<(u16, u64, u64)>>,
    /// Sorted by log time; equal times keep the file's order.
    pub pictures: Vec<PictureRecord>,
    /// The recording was closed properly; otherwise an unknown part is missing.
    pub is_whole: bool,
    /// End of the last complete record.
    pub end: u64,
}

impl Index {
    /// Builds the index.
    pub fn of(file: &mut BufReader<File>, file_bytes: u64) -> Result<Index, PageFault> {
        let unpacked_max = UNPACKED_BYTES_MAX.max(file_bytes.saturating_mul(UNPACKED_TIMES_MAX));
        Index::within(file, file_bytes, unpacked_max)
    }

    fn within(file: &mut BufReader<File>, file_bytes: u64, unpacked_max: u64) -> Result<Index, PageFault> {
        let mut index = Index::default();
        let mut unpacked = 0u64;
        index.is_whole = index.walk(file, file_bytes)?;
        if let (false, Some(last)) = (index.is_whole, index.indexes.last_mut()) {
            // Some of its indexes may be missing.
            last.clear();
        }
        for number in 0..index.chunks.len() {
            let indexes = std::mem::take(&mut index.indexes[number]);
            let is_known = |(channel, ..): &(u16, u64, u64)| index.streams.contains_key(channel);
            if indexes.is_empty() || !indexes.iter().all(is_known) {
                let records = chunk::unpack(file, &index.chunks[number])?;
                unpacked += records.len() as u64;
                if unpacked > unpacked_max {
                    return Err(too_many("bytes in chunks without an index"));
                }
                index.scan(&records, number as u32)?;
                continue;
            }
            for (channel, begin, bytes) in indexes {
                if index.streams.get(&channel).is_some_and(Option::is_some) {
                    let content = content(file, begin, bytes)?;
                    index.message_index(&content, channel, number as u32)?;
                }
            }
        }
        index.pictures.sort_by_key(|picture| picture.log_time);
        Ok(index)
    }

    /// Reads the file's records; true if the data section is complete.
    fn walk(&mut self, file: &mut BufReader<File>, file_bytes: u64) -> Result<bool, PageFault> {
        let mut magic = Vec::new();
        file.take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(DecodeError::UnknownKind.into());
        }
        let (mut at, mut count, mut is_whole) = (MAGIC.len() as u64, 0, false);
        self.end = at;
        while at + (HEAD_BYTES as u64) <= file_bytes {
            let head = content(file, at, HEAD_BYTES as u64)?;
            let begin = at + HEAD_BYTES as u64;
            let Some((opcode, bytes)) = records::head(&head) else { break };
            let Some(end) = begin.checked_add(bytes).filter(|end| *end <= file_bytes) else { break };
            match opcode {
                // Preallocated space that the recorder never filled.
                NONE => break,
                op::FOOTER => return Ok(true),
                op::DATA_END => is_whole = true,
                op::SCHEMA | op::CHANNEL => self.take(opcode, &content(file, begin, bytes)?, None, at)?,
                op::MESSAGE => {
                    let head = content(file, begin, bytes.min(MESSAGE_BYTES as u64))?;
                    self.take(opcode, &head, None, at)?;
                }
                op::CHUNK => {
                    let head = content(file, begin, bytes.min(CHUNK_HEAD_BYTES as u64))?;
                    let chunk = Chunk::parse(&head, [begin, end]);
                    let Some(chunk) = chunk else { return Err(damaged("the first fields of a chunk")) };
                    if self.chunks.len() == LIMITS.files {
                        return Err(too_many("chunks"));
                    }
                    self.chunks.push(chunk);
                    self.indexes.push(Vec::new());
                }
                op::MESSAGE_INDEX => {
                    let head = content(file, begin, bytes.min(2))?;
                    if let (Some(channel), Some(indexes)) = (head.first_chunk(), self.indexes.last_mut()) {
                        indexes.push((u16::from_le_bytes(*channel), begin, bytes));
                        count += 1;
                    }
                    if count > INDEXES_MAX {
                        return Err(too_many("message indexes"));
                    }
                }
                _ => {}
            }
            at = end;
            self.end = end;
        }
        Ok(is_whole)
    }

    /// Reads the records of a chunk.
    fn scan(&mut self, mut records: &[u8], chunk: u32) -> Result<(), PageFault> {
        let bytes = records.len();
        while !records.is_empty() {
            let offset = (bytes - records.len()) as u64;
            let Some((opcode, content, rest)) = records::split(records) else {
                return Err(damaged("a record of a chunk"));
            };
            self.take(opcode, content, Some(chunk), offset)?;
            records = rest;
        }
        Ok(())
    }

    /// Reads one record. An unreadable record is ignored, and its dependents then have no channel.
    fn take(&mut self, opcode: u8, content: &[u8], chunk: Option<u32>, offset: u64) -> Result<(), PageFault> {
        match records::record(opcode, content) {
            Some(Record::Schema { header, .. }) => {
                let fields = MessageFields::of(&header.name);
                if fields.is_none() && self.others.len() < OTHERS_MAX {
                    self.others.insert(header.name.chars().filter(|c| !c.is_control()).take(60).collect());
                }
                self.schemas.insert(header.id, fields);
            }
            Some(Record::Channel(mcap::records::Channel { id, schema_id, topic, message_encoding, .. })) => {
                let layout = self.schemas.get(&schema_id).copied().flatten();
                if layout.is_some() && topic.len() > TOPIC_BYTES_MAX {
                    let reason = format!("a topic's name of {} bytes; at most {TOPIC_BYTES_MAX} are read", topic.len());
                    return Err(DecodeError::TooLarge(reason).into());
                }
                let stream = |layout| PictureTopic { topic, layout, encoding: MessageEncoding::of(&message_encoding) };
                self.streams.insert(id, layout.map(stream));
            }
            Some(Record::Message { header, .. }) => {
                self.add_picture(header.log_time, header.channel_id, chunk, offset)?
            }
            _ => {}
        }
        Ok(())
    }

    fn message_index(&mut self, content: &[u8], channel: u16, chunk: u32) -> Result<(), PageFault> {
        let Some(Record::MessageIndex(index)) = records::record(op::MESSAGE_INDEX, content) else {
            return Err(damaged("a message index"));
        };
        index.records.iter().try_for_each(|entry| self.add_picture(entry.log_time, channel, Some(chunk), entry.offset))
    }

    fn add_picture(&mut self, log_time: u64, channel: u16, chunk: Option<u32>, offset: u64) -> Result<(), PageFault> {
        if self.streams.get(&channel).is_none_or(Option::is_none) {
            return Ok(());
        }
        if self.pictures.len() == PICTURES_MAX {
            return Err(too_many("pictures"));
        }
        self.pictures.push(PictureRecord { log_time, channel, chunk, offset });
        Ok(())
    }
}

/// Reads a small record; the bytes must exist.
pub(crate) fn content(file: &mut BufReader<File>, begin: u64, bytes: u64) -> Result<Vec<u8>, PageFault> {
    content_of(file, begin, bytes, RECORD_BYTES_MAX)
}

/// Reads `bytes` bytes, at most `most`; they must exist.
pub(super) fn content_of(file: &mut BufReader<File>, begin: u64, bytes: u64, most: u64) -> Result<Vec<u8>, PageFault> {
    if bytes > most {
        return Err(DecodeError::TooLarge(format!("a record of {bytes} bytes; at most {most} are read")).into());
    }
    // Records are contiguous: a relative seek keeps the read-ahead buffer.
    let here = file.stream_position()?;
    match begin.checked_signed_diff(here) {
        Some(steps) => file.seek_relative(steps)?,
        None => drop(file.seek(SeekFrom::Start(begin))?),
    }
    let mut content = vec![0; bytes as usize];
    file.read_exact(&mut content)?;
    Ok(content)
}

fn damaged(what: &str) -> PageFault {
    DecodeError::Damaged(format!("{what} cannot be read")).into()
}

fn too_many(what: &str) -> PageFault {
    DecodeError::TooLarge(format!("too many {what}; split the recording")).into()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Chunks without pictures or indexes, each of 100 bytes.
    #[test]
    fn all_chunks_share_one_decompression_budget() {
        let record =
            |opcode: u8, content: &[u8]| [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat();
        let inner = record(1, &[0; 91]);
        let head = [&[0; 16][..], &100u64.to_le_bytes(), &[0; 8], &100u64.to_le_bytes()].concat();
        let chunk = record(op::CHUNK, &[head, inner].concat());
        let bytes = [MAGIC, &chunk.repeat(3), &record(op::FOOTER, &[0; 20]), MAGIC].concat();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chunks.mcap");
        std::fs::write(&path, &bytes).unwrap();
        let read = |most| Index::within(&mut BufReader::new(File::open(&path).unwrap()), bytes.len() as u64, most);
        assert_eq!(read(300).ok().unwrap().chunks.len(), 3);
        let Err(PageFault::Wrong(error)) = read(299) else { panic!("it is within its budget") };
        assert!(error.to_string().contains("too many bytes in chunks without an index"), "{error}");
    }
}
