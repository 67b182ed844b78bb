//! `mend`: completes a recording that a killed process left truncated.
//!
//! It keeps all complete chunks, cuts off the rest and appends an index and a footer. Kept bytes are neither moved nor
//! rewritten, so this takes no disk space for a copy.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, Error, ErrorKind, Seek, SeekFrom, Write};
use std::path::Path;

use mcap::records::{AttachmentIndex, ChunkIndex, MessageIndex, MessageIndexEntry, MetadataIndex, Record, op};

use super::summary::{FileSummary, message_index};
use crate::files::PageFault;
use crate::files::mcap::{self as files, Chunk, HEAD_BYTES, MAGIC};

/// Most bytes of an attachment's fields before its content.
const ATTACHMENT_HEAD_BYTES: u64 = 4096;

/// Most chunks dropped to free space for the footer on a full disk.
const CHUNKS_GIVEN: usize = 8;

/// Result of mending a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MendedFile {
    /// Completed.
    Mended {
        /// Messages in all kept chunks.
        messages: u64,
        /// Bytes cut off.
        lost_bytes: u64,
    },
    /// No chunk is complete: nothing was recorded.
    Empty,
    /// The file was already complete.
    Whole,
}

/// State of mending one file.
struct Repair {
    file: BufReader<File>,
    bytes: u64,
    summary: FileSummary,
    /// End and messages of the last chunk.
    last: Option<(u64, BTreeMap<u16, Vec<MessageIndexEntry>>)>,
    /// End of the last kept record.
    end: u64,
}

/// Completes a file, which nobody else may be writing. If the disk is too full even for the footer, the last chunks are
/// dropped.
///
/// # Errors
/// The file cannot be read or written, or is not an MCAP file; its complete chunks remain readable.
pub fn mend(path: &Path) -> Result<MendedFile, Error> {
    let bytes = std::fs::metadata(path)?.len();
    let (mut kept, mut result) = (bytes, mend_to(path, bytes)?);
    for _ in 0..CHUNKS_GIVEN {
        let RepairResult::DiskFull(error, last) = result else { break };
        // The first chunk holds the channels, so it is never dropped.
        kept = last.filter(|last| *last < kept).ok_or(error)?;
        result = mend_to(path, kept)?;
    }
    match result {
        RepairResult::Done(MendedFile::Mended { messages, lost_bytes }) => {
            Ok(MendedFile::Mended { messages, lost_bytes: lost_bytes + bytes - kept })
        }
        RepairResult::Done(mended) => Ok(mended),
        RepairResult::DiskFull(error, _) => Err(error),
    }
}

/// Result of mending a prefix of the file.
enum RepairResult {
    Done(MendedFile),
    /// Disk full; the offset of the last chunk, unless it is the only one.
    DiskFull(Error, Option<u64>),
}

fn mend_to(path: &Path, bytes: u64) -> Result<RepairResult, Error> {
    let file = File::open(path)?;
    if bytes < MAGIC.len() as u64 {
        return Ok(RepairResult::Done(MendedFile::Empty)); // power was lost before anything was written
    }
    let mut mender = Repair {
        file: BufReader::new(file),
        bytes,
        summary: FileSummary::default(),
        last: None,
        end: MAGIC.len() as u64,
    };
    if mender.walk()? {
        return Ok(RepairResult::Done(MendedFile::Whole));
    }
    if mender.summary.chunks.is_empty() {
        return Ok(RepairResult::Done(MendedFile::Empty));
    }
    let tail = mender.tail()?;
    let messages = mender.summary.counts.values().sum();
    let (end, lost_bytes) = (mender.end, bytes - mender.end);
    let mut file = OpenOptions::new().write(true).open(path)?;
    file.set_len(end)?;
    file.seek(SeekFrom::Start(end))?;
    match file.write_all(&tail).and_then(|()| file.sync_all()) {
        Ok(()) => Ok(RepairResult::Done(MendedFile::Mended { messages, lost_bytes })),
        Err(error) if is_full(&error) => {
            let last = mender.summary.chunks.last().filter(|_| mender.summary.chunks.len() > 1);
            Ok(RepairResult::DiskFull(error, last.map(|chunk| chunk.chunk_start_offset)))
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

impl Repair {
    /// Reads the records; true if the file is already complete.
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
                // The records that follow are rewritten, unless the footer is present.
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

    /// Whether footer and closing magic are at the end of the file, after offset `behind`.
    fn has_footer(&mut self, behind: u64) -> Result<bool, Error> {
        let footer = [&[op::FOOTER][..], &20u64.to_le_bytes()].concat();
        let whole = (footer.len() + 20 + MAGIC.len()) as u64;
        let Some(begin) = self.bytes.checked_sub(whole).filter(|begin| *begin >= behind) else { return Ok(false) };
        let end = files::content(&mut self.file, begin, whole).map_err(read)?;
        Ok(end.starts_with(&footer) && end.ends_with(MAGIC))
    }

    /// Records a message index in the chunk before it.
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

    /// Reads a chunk; `None` if it is damaged.
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

    /// The bytes to append: the last chunk's message indexes, which may be incomplete, the summary and the footer.
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

/// A string with a length prefix, and the rest.
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
