//! `LogWriter`: writes messages to the chunks of an MCAP file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Error;

use mcap::records::MessageHeader;
use mcap::{Attachment, McapError, WriteOptions, Writer};

use super::schemas::descriptors;

/// Schema of a channel's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LogSchema {
    /// A Foxglove schema, as Protobuf: `foxglove.RawImage`.
    Foxglove(&'static str),
    /// An isophote schema, as JSON: `isophote.Estimate`.
    Json(&'static str),
}

/// A channel of an open file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogChannel(u16);

/// Bytes of a message besides its payload: record header and message index entry.
const MESSAGE_BYTES: u64 = 31 + 16;
/// Bound on the fixed part of the summary and footer, bytes.
const END_BYTES: u64 = 64 << 10;
/// Bound on the summary per chunk, and per channel and chunk, bytes.
const CHUNK_END_BYTES: u64 = 96;
const CHANNEL_END_BYTES: u64 = 48;

/// Writes an MCAP file. Every [`LogWriter::flush`] ends a chunk: earlier messages then survive a crash of the process, and
/// after [`LogWriter::sync`] a crash of the machine.
pub struct LogWriter {
    writer: Writer<File>,
    file: File,
    counts: BTreeMap<u16, u32>,
    waiting_bytes: u64,
    chunks: u64,
}

fn io(error: McapError) -> Error {
    match error {
        McapError::Io(error) => error,
        other => Error::other(other),
    }
}

impl LogWriter {
    /// Begins an empty file.
    pub fn begin(file: File, library: &str) -> Result<LogWriter, Error> {
        // Chunks are written whole: one whose size is filled in later is lost if the process dies first.
        let options = WriteOptions::new().compression(None).chunk_size(None).disable_seeking(true).library(library);
        let writer = options.create(file.try_clone()?).map_err(io)?;
        Ok(LogWriter { writer, file, counts: BTreeMap::new(), waiting_bytes: 0, chunks: 0 })
    }

    /// Adds a channel. All channels must precede the first message, so that readers find them in the first chunk.
    pub fn channel(&mut self, topic: &str, schema: LogSchema) -> Result<LogChannel, Error> {
        let (schema, encoding) = match schema {
            LogSchema::Foxglove(name) => (self.writer.add_schema(name, "protobuf", &descriptors()), "protobuf"),
            LogSchema::Json(name) => {
                let document = format!("{{\"title\":\"{name}\",\"type\":\"object\"}}");
                (self.writer.add_schema(name, "jsonschema", document.as_bytes()), "json")
            }
        };
        let channel = schema.and_then(|schema| self.writer.add_channel(schema, topic, encoding, &BTreeMap::new()));
        channel.map(LogChannel).map_err(io)
    }

    /// Writes a message. `log_time`, also used as the publish time, is ns since 1970.
    pub fn write(&mut self, LogChannel(id): LogChannel, log_time: u64, payload: &[u8]) -> Result<(), Error> {
        let sequence = self.counts.entry(id).or_default();
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id: id, sequence: *sequence, log_time, publish_time: log_time };
        // Includes the message's entry in the index after the chunk.
        self.waiting_bytes += payload.len() as u64 + MESSAGE_BYTES;
        self.writer.write_to_known_channel(&header, payload).map_err(io)
    }

    /// Adds an attachment.
    pub fn attach(&mut self, name: &str, media_type: &str, time: u64, bytes: &[u8]) -> Result<(), Error> {
        let (name, media_type) = (name.to_string(), media_type.to_string());
        let attachment = Attachment { log_time: time, create_time: time, name, media_type, data: bytes.into() };
        self.writer.attach(&attachment).map_err(io)
    }

    /// Bytes of the unfinished chunk.
    pub fn waiting_bytes(&self) -> u64 {
        self.waiting_bytes
    }

    /// Upper bound on the bytes of the summary and footer, including the next chunk's.
    pub fn end_bytes(&self) -> u64 {
        END_BYTES + (self.chunks + 1) * (CHUNK_END_BYTES + CHANNEL_END_BYTES * self.counts.len() as u64)
    }

    /// Ends the chunk; returns the file's size.
    pub fn flush(&mut self) -> Result<u64, Error> {
        self.writer.flush().map_err(io)?;
        (self.waiting_bytes, self.chunks) = (0, self.chunks + 1);
        self.bytes()
    }

    fn bytes(&self) -> Result<u64, Error> {
        Ok(self.file.metadata()?.len())
    }

    /// Waits until flushed data is on the disk.
    pub fn sync(&self) -> Result<(), Error> {
        self.file.sync_data()
    }

    /// Ends the file with its index; returns its size.
    pub fn finish(mut self) -> Result<u64, Error> {
        self.writer.finish().map_err(io)?;
        self.file.sync_data()?;
        self.bytes()
    }
}
