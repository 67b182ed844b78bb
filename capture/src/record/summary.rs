//! The data end, summary section and footer of an MCAP file.

use std::collections::BTreeMap;
use std::io::{Cursor, Error};

use binrw::BinWrite;
use mcap::records::{
    AttachmentIndex, Channel, ChunkIndex, DataEnd, MessageIndex, MetadataIndex, SchemaHeader, Statistics, op,
};

/// Summary of all records of a file.
#[derive(Default)]
pub(super) struct FileSummary {
    pub schemas: BTreeMap<u16, (SchemaHeader, Vec<u8>)>,
    pub channels: BTreeMap<u16, Channel>,
    pub chunks: Vec<ChunkIndex>,
    pub attachments: Vec<AttachmentIndex>,
    pub metadata: Vec<MetadataIndex>,
    /// Message counts by channel.
    pub counts: BTreeMap<u16, u64>,
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn written<T>(opcode: u8, value: &T) -> Result<Vec<u8>, Error>
where
    T: for<'a> BinWrite<Args<'a> = ()>,
{
    let mut content = Cursor::new(Vec::new());
    value.write_le(&mut content).map_err(Error::other)?;
    Ok(record(opcode, content.get_ref()))
}

/// Encodes a channel's message index of a chunk.
pub(super) fn message_index(index: &MessageIndex) -> Result<Vec<u8>, Error> {
    written(op::MESSAGE_INDEX, index)
}

impl FileSummary {
    /// Everything after the last chunk, which ends at offset `begin`.
    pub fn bytes(&self, begin: u64) -> Result<Vec<u8>, Error> {
        let mut bytes = written(op::DATA_END, &DataEnd { data_section_crc: 0 })?;
        let start = bytes.len();
        for (header, document) in self.schemas.values() {
            let mut content = Cursor::new(Vec::new());
            header.write_le(&mut content).map_err(Error::other)?;
            let mut content = content.into_inner();
            content.extend((document.len() as u32).to_le_bytes());
            content.extend(document);
            bytes.extend(record(op::SCHEMA, &content));
        }
        for channel in self.channels.values() {
            bytes.extend(written(op::CHANNEL, channel)?);
        }
        bytes.extend(written(op::STATISTICS, &self.statistics())?);
        for chunk in &self.chunks {
            bytes.extend(written(op::CHUNK_INDEX, chunk)?);
        }
        for attachment in &self.attachments {
            bytes.extend(written(op::ATTACHMENT_INDEX, attachment)?);
        }
        for metadata in &self.metadata {
            bytes.extend(written(op::METADATA_INDEX, metadata)?);
        }
        // The checksum covers the summary, and the footer up to itself.
        let mut footer = record(op::FOOTER, &[0; 20]);
        footer[9..17].copy_from_slice(&(begin + start as u64).to_le_bytes());
        let end = footer.len() - 4;
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&bytes[start..]);
        checksum.update(&footer[..end]);
        footer[end..].copy_from_slice(&checksum.finalize().to_le_bytes());
        bytes.extend(footer);
        bytes.extend(mcap::MAGIC);
        Ok(bytes)
    }

    fn statistics(&self) -> Statistics {
        Statistics {
            message_count: self.counts.values().sum(),
            schema_count: self.schemas.len() as u16,
            channel_count: self.channels.len() as u32,
            attachment_count: self.attachments.len() as u32,
            metadata_count: self.metadata.len() as u32,
            chunk_count: self.chunks.len() as u32,
            message_start_time: self.chunks.iter().map(|chunk| chunk.message_start_time).min().unwrap_or(0),
            message_end_time: self.chunks.iter().map(|chunk| chunk.message_end_time).max().unwrap_or(0),
            channel_message_counts: self.counts.clone(),
        }
    }
}
