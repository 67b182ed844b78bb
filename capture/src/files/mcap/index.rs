//! An MCAP file in, where its pictures are out, in the order of their log times.
//!
//! The file is walked from record to record. Chunks are passed over: the message indexes behind them say what is in them,
//! and the summary at the end of the file which channels there are. Only where one of these is missing (a recorder that
//! crashed, or that writes none) a chunk is unpacked for it. Where the file breaks off the walk ends.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use crate::files::PageFault;
use crate::limits::LIMITS;
use crate::picture::DecodeError;

use super::chunk::{self, Chunk};
use super::message::{MessageEncoding, MessageFields};
use super::records::{self, CHUNK_HEAD_BYTES, HEAD_BYTES, MAGIC, MESSAGE_BYTES, NONE, Record, op};

/// Bytes of a schema, a channel or a message index; message indexes, and pictures of all topics; bytes of a topic's name.
const RECORD_BYTES_MAX: u64 = 64 << 20;
const TOPIC_BYTES_MAX: usize = 1024;
/// Bytes that are unpacked to find the pictures: so many, or so many times the file's bytes where that is more.
const UNPACKED_BYTES_MAX: u64 = 16 << 30;
const UNPACKED_TIMES_MAX: u64 = 4;
/// Names of other schemas that are shown in a message; a budget.
const OTHERS_MAX: usize = 10;
const INDEXES_MAX: usize = 4_000_000;
const PLACES_MAX: usize = 4_000_000;

/// A channel whose messages are pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PictureTopic {
    pub topic: String,
    pub layout: MessageFields,
    pub encoding: MessageEncoding,
}

/// Where a picture is.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureRecord {
    pub log_time: u64,
    pub channel: u16,
    /// Of [`Index::chunks`]; `None` where the message stands in the file itself.
    pub chunk: Option<u32>,
    /// The byte of its record in the unpacked chunk, or in the file.
    pub offset: u64,
}

/// What is known of a file.
#[derive(Default)]
pub(super) struct Index {
    schemas: BTreeMap<u16, Option<MessageFields>>,
    /// The names of some schemas that are none of pictures.
    pub others: BTreeSet<String>,
    /// By number; `None` for channels of other things.
    pub streams: BTreeMap<u16, Option<PictureTopic>>,
    pub chunks: Vec<Chunk>,
    /// The message indexes of each chunk: channel, first byte of the content, bytes.
    indexes: Vec<Vec<(u16, u64, u64)>>,
    /// In the order of their log times; with the same time, of the file.
    pub places: Vec<PictureRecord>,
    /// The file has what was recorded to the end; without, nobody knows how much is missing.
    pub is_whole: bool,
    /// Where the last whole record ends.
    pub end: u64,
}

impl Index {
    /// Walks through the file.
    pub fn of(file: &mut BufReader<File>, file_bytes: u64) -> Result<Index, PageFault> {
        let unpacked_max = UNPACKED_BYTES_MAX.max(file_bytes.saturating_mul(UNPACKED_TIMES_MAX));
        Index::within(file, file_bytes, unpacked_max)
    }

    fn within(file: &mut BufReader<File>, file_bytes: u64, unpacked_max: u64) -> Result<Index, PageFault> {
        let mut index = Index::default();
        let mut unpacked = 0u64;
        index.is_whole = index.walk(file, file_bytes)?;
        if let (false, Some(last)) = (index.is_whole, index.indexes.last_mut()) {
            // Some of its indexes may not have been written any more.
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
        index.places.sort_by_key(|place| place.log_time);
        Ok(index)
    }

    /// Takes note of the file's records; whether those with pictures end as they should.
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
                // What a recorder made room for and never filled.
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

    /// Takes note of what is in a chunk.
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

    /// Takes note of a record. One that cannot be read says nothing: what belongs to it has no channel then.
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
            Some(Record::Message { header, .. }) => self.place(header.log_time, header.channel_id, chunk, offset)?,
            _ => {}
        }
        Ok(())
    }

    fn message_index(&mut self, content: &[u8], channel: u16, chunk: u32) -> Result<(), PageFault> {
        let Some(Record::MessageIndex(index)) = records::record(op::MESSAGE_INDEX, content) else {
            return Err(damaged("a message index"));
        };
        index.records.iter().try_for_each(|entry| self.place(entry.log_time, channel, Some(chunk), entry.offset))
    }

    fn place(&mut self, log_time: u64, channel: u16, chunk: Option<u32>, offset: u64) -> Result<(), PageFault> {
        if self.streams.get(&channel).is_none_or(Option::is_none) {
            return Ok(());
        }
        if self.places.len() == PLACES_MAX {
            return Err(too_many("pictures"));
        }
        self.places.push(PictureRecord { log_time, channel, chunk, offset });
        Ok(())
    }
}

/// Bytes of a small record, which are there.
pub(crate) fn content(file: &mut BufReader<File>, begin: u64, bytes: u64) -> Result<Vec<u8>, PageFault> {
    content_of(file, begin, bytes, RECORD_BYTES_MAX)
}

/// Bytes of the file, which are there, but not more than `most`.
pub(super) fn content_of(file: &mut BufReader<File>, begin: u64, bytes: u64, most: u64) -> Result<Vec<u8>, PageFault> {
    if bytes > most {
        return Err(DecodeError::TooLarge(format!("a record of {bytes} bytes; at most {most} are read")).into());
    }
    // Records lie behind each other: what was read ahead is kept.
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

    /// Chunks of other things, each packed with 100 bytes, and no index behind any.
    #[test]
    fn all_chunks_together_have_one_budget() {
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
