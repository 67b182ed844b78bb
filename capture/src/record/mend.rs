//! `mend`: a recording that was cut off gets its end.
//!
//! In: a file that a killed process left. Out: the same file with all of its whole chunks, an index and a footer. What stands
//! behind the last whole chunk is cut off. Nothing before that is moved or written again, so that it needs no room on the disk.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, Error, ErrorKind, Seek, SeekFrom, Write};
use std::path::Path;

use mcap::records::{AttachmentIndex, ChunkIndex, MessageIndex, MessageIndexEntry, MetadataIndex, Record, op};

use super::summary::{FileSummary, message_index};
use crate::files::PageFault;
use crate::files::mcap::{self as files, Chunk, HEAD_BYTES, MAGIC};

/// Bytes of an attachment's fields before its content, at most.
const ATTACHMENT_HEAD_BYTES: u64 = 4096;

/// Chunks that make room for the end of a file on a disk that is full, at most.
const CHUNKS_GIVEN: usize = 8;

/// What became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MendedFile {
    /// It has its end now, so many messages, and so many bytes fewer.
    Mended {
        /// In all whole chunks.
        messages: u64,
        /// Cut off.
        lost_bytes: u64,
    },
    /// Not one chunk is whole: nothing was recorded.
    Empty,
    /// It had its end.
    Whole,
}

/// One file's.
struct Mender {
    file: BufReader<File>,
    bytes: u64,
    summary: FileSummary,
    /// The last chunk, with what is in it, and where it ends.
    last: Option<(u64, BTreeMap<u16, Vec<MessageIndexEntry>>)>,
    /// Behind the last record that is kept.
    end: u64,
}

/// Gives the file its end. Nobody else may write it. Where the disk has no room even for that, the last chunks make it.
///
/// # Errors
/// When it cannot be read or written, or is no MCAP file; what was whole of it can still be read.
pub fn mend(path: &Path) -> Result<MendedFile, Error> {
    let bytes = std::fs::metadata(path)?.len();
    let (mut kept, mut result) = (bytes, mend_to(path, bytes)?);
    for _ in 0..CHUNKS_GIVEN {
        let Ended::Full(error, last) = result else { break };
        // The first one says what is recorded.
        kept = last.filter(|last| *last < kept).ok_or(error)?;
        result = mend_to(path, kept)?;
    }
    match result {
        Ended::So(MendedFile::Mended { messages, lost_bytes }) => {
            Ok(MendedFile::Mended { messages, lost_bytes: lost_bytes + bytes - kept })
        }
        Ended::So(mended) => Ok(mended),
        Ended::Full(error, _) => Err(error),
    }
}

/// What became of its first bytes.
enum Ended {
    So(MendedFile),
    /// There was no room; the last chunk begins there, unless it is the only one.
    Full(Error, Option<u64>),
}

fn mend_to(path: &Path, bytes: u64) -> Result<Ended, Error> {
    let file = File::open(path)?;
    if bytes < MAGIC.len() as u64 {
        return Ok(Ended::So(MendedFile::Empty)); // the power went before anything reached the disk
    }
    let mut mender = Mender {
        file: BufReader::new(file),
        bytes,
        summary: FileSummary::default(),
        last: None,
        end: MAGIC.len() as u64,
    };
    if mender.walk()? {
        return Ok(Ended::So(MendedFile::Whole));
    }
    if mender.summary.chunks.is_empty() {
        return Ok(Ended::So(MendedFile::Empty));
    }
    let tail = mender.tail()?;
    let messages = mender.summary.counts.values().sum();
    let (end, lost_bytes) = (mender.end, bytes - mender.end);
    let mut file = OpenOptions::new().write(true).open(path)?;
    file.set_len(end)?;
    file.seek(SeekFrom::Start(end))?;
    match file.write_all(&tail).and_then(|()| file.sync_all()) {
        Ok(()) => Ok(Ended::So(MendedFile::Mended { messages, lost_bytes })),
        Err(error) if is_full(&error) => {
            let last = mender.summary.chunks.last().filter(|_| mender.summary.chunks.len() > 1);
            Ok(Ended::Full(error, last.map(|chunk| chunk.chunk_start_offset)))
        }
        Err(error) => Err(error),
    }
}

fn is_full(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge)
}

fn read(fault: PageFault) -> Error {
    match fault {
        PageFault::Unreadable(error) => error,
        PageFault::Wrong(error) => Error::new(ErrorKind::InvalidData, error.to_string()),
    }
}

impl Mender {
    /// Through the records; whether the file has its end.
    fn walk(&mut self) -> Result<bool, Error> {
        let content = |file: &mut BufReader<File>, begin, bytes| files::content(file, begin, bytes).map_err(read);
        if self.bytes < MAGIC.len() as u64 || content(&mut self.file, 0, MAGIC.len() as u64)? != MAGIC {
            return Err(Error::new(ErrorKind::InvalidData, "it is no MCAP file"));
        }
        let mut at = self.end;
        while at + HEAD_BYTES as u64 <= self.bytes {
            let head = content(&mut self.file, at, HEAD_BYTES as u64)?;
            let begin = at + HEAD_BYTES as u64;
            let Some((opcode, bytes)) = files::head(&head) else { break };
            let Some(end) = begin.checked_add(bytes).filter(|end| *end <= self.bytes) else { break };
            match opcode {
                // What follows is written again, unless all of it is there.
                op::DATA_END => return self.has_footer(end),
                op::HEADER => {}
                op::CHUNK => {
                    let Some(chunk) = self.chunk(at, [begin, end]) else { break };
                    self.last = Some((end, chunk));
                }
                op::MESSAGE_INDEX => {}
                op::ATTACHMENT => {
                    let head = content(&mut self.file, begin, bytes.min(ATTACHMENT_HEAD_BYTES))?;
                    let Some(index) = attachment(&head, at, end - at) else { break };
                    self.summary.attachments.push(index);
                }
                op::METADATA => {
                    let head = content(&mut self.file, begin, bytes.min(ATTACHMENT_HEAD_BYTES))?;
                    let Some((name, _)) = text(&head) else { break };
                    self.summary.metadata.push(MetadataIndex { offset: at, length: end - at, name });
                }
                _ => break,
            }
            if opcode != op::MESSAGE_INDEX {
                self.end = end;
            }
            at = end;
            self.index(opcode, [begin, end], bytes)?;
        }
        Ok(false)
    }

    /// A footer and the last bytes stand at the end, behind that byte.
    fn has_footer(&mut self, behind: u64) -> Result<bool, Error> {
        let footer = [&[op::FOOTER][..], &20u64.to_le_bytes()].concat();
        let whole = (footer.len() + 20 + MAGIC.len()) as u64;
        let Some(begin) = self.bytes.checked_sub(whole).filter(|begin| *begin >= behind) else { return Ok(false) };
        let end = files::content(&mut self.file, begin, whole).map_err(read)?;
        Ok(end.starts_with(&footer) && end.ends_with(MAGIC))
    }

    /// Takes note of an index behind its chunk.
    fn index(&mut self, opcode: u8, [begin, end]: [u64; 2], bytes: u64) -> Result<(), Error> {
        if let (op::MESSAGE_INDEX, Some(chunk)) = (opcode, self.summary.chunks.last_mut()) {
            let head = files::content(&mut self.file, begin, bytes.min(2)).map_err(read)?;
            if let Some(channel) = head.first_chunk() {
                chunk.message_index_offsets.insert(u16::from_le_bytes(*channel), begin - HEAD_BYTES as u64);
                chunk.message_index_length += end - begin + HEAD_BYTES as u64;
            }
        }
        Ok(())
    }

    /// What is in a chunk; `None` where it cannot be read.
    fn chunk(&mut self, start: u64, [begin, end]: [u64; 2]) -> Option<BTreeMap<u16, Vec<MessageIndexEntry>>> {
        let head = files::content(&mut self.file, begin, (end - begin).min(files::CHUNK_HEAD_BYTES as u64)).ok()?;
        let (header, _) = files::chunk_header(&head)?;
        let records = files::unpack(&mut self.file, &Chunk::parse(&head, [begin, end])?).ok()?;
        let mut index: BTreeMap<u16, Vec<MessageIndexEntry>> = BTreeMap::new();
        let mut rest = &records[..];
        while !rest.is_empty() {
            let offset = (records.len() - rest.len()) as u64;
            let (opcode, content, behind) = files::split(rest)?;
            match files::record(opcode, content)? {
                Record::Schema { header, data } => {
                    self.summary.schemas.insert(header.id, (header, data.into_owned()));
                }
                Record::Channel(channel) => drop(self.summary.channels.insert(channel.id, channel)),
                Record::Message { header, .. } => {
                    let entry = MessageIndexEntry { log_time: header.log_time, offset };
                    index.entry(header.channel_id).or_default().push(entry);
                }
                _ => {}
            }
            rest = behind;
        }
        for (channel, entries) in &index {
            *self.summary.counts.entry(*channel).or_default() += entries.len() as u64;
        }
        self.summary.chunks.push(ChunkIndex {
            message_start_time: header.message_start_time,
            message_end_time: header.message_end_time,
            chunk_start_offset: start,
            chunk_length: end - start,
            message_index_offsets: BTreeMap::new(),
            message_index_length: 0,
            compression: header.compression,
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        });
        Some(index)
    }

    /// What is to stand behind what is kept: the indexes of the last chunk, which may not have been written any more, and the end.
    fn tail(&mut self) -> Result<Vec<u8>, Error> {
        let mut tail = Vec::new();
        let last = self.last.take().filter(|(end, _)| *end == self.end);
        if let (Some((_, index)), Some(chunk)) = (last, self.summary.chunks.last_mut()) {
            chunk.message_index_offsets.clear();
            for (channel_id, records) in index {
                chunk.message_index_offsets.insert(channel_id, self.end + tail.len() as u64);
                tail.extend(message_index(&MessageIndex { channel_id, records })?);
            }
            chunk.message_index_length = tail.len() as u64;
        }
        let summary = self.summary.bytes(self.end + tail.len() as u64)?;
        tail.extend(summary);
        Ok(tail)
    }
}

/// A text with its length before it, and what comes behind.
fn text(bytes: &[u8]) -> Option<(String, &[u8])> {
    let (count, rest) = bytes.split_first_chunk()?;
    let (text, behind) = rest.split_at_checked(u32::from_le_bytes(*count) as usize)?;
    Some((std::str::from_utf8(text).ok()?.to_string(), behind))
}

fn attachment(head: &[u8], offset: u64, length: u64) -> Option<AttachmentIndex> {
    let (log_time, rest) = head.split_first_chunk()?;
    let (create_time, rest) = rest.split_first_chunk()?;
    let (name, rest) = text(rest)?;
    let (media_type, rest) = text(rest)?;
    let (log_time, create_time) = (u64::from_le_bytes(*log_time), u64::from_le_bytes(*create_time));
    let data_size = u64::from_le_bytes(*rest.first_chunk()?);
    Some(AttachmentIndex { offset, length, log_time, create_time, data_size, name, media_type })
}
