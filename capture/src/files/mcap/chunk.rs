//! Decompresses the records of a chunk. Their size is checked before memory is allocated, their checksum afterwards.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use crate::files::PageFault;
use crate::limits::LIMITS;
use crate::picture::DecodeError;

use super::records;

/// Compression of a chunk's records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Packing {
    Stored,
    Lz4,
    Zstd,
}

/// Location of a chunk's records.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chunk {
    /// `None` for an unsupported compression.
    packing: Option<Packing>,
    /// Offset of the compressed records in the file; `bytes` is their length.
    begin: u64,
    bytes: u64,
    /// Size of the decompressed records.
    unpacked_bytes: u64,
    /// CRC-32 of the decompressed records; 0 if unknown.
    checksum: u32,
}

impl Chunk {
    /// Parses the chunk header; `begin` and `end` bound the chunk's content in the file. `None` if it is invalid.
    pub fn parse(head: &[u8], [begin, end]: [u64; 2]) -> Option<Chunk> {
        let (header, head_bytes) = records::chunk_header(head)?;
        let packing = match header.compression.as_str() {
            "" => Some(Packing::Stored),
            "lz4" => Some(Packing::Lz4),
            "zstd" => Some(Packing::Zstd),
            _ => None,
        };
        let (begin, bytes) = (begin + head_bytes, header.compressed_size);
        let (unpacked_bytes, checksum) = (header.uncompressed_size, header.uncompressed_crc);
        (bytes <= end.saturating_sub(begin)).then_some(Chunk { packing, begin, bytes, unpacked_bytes, checksum })
    }
}

/// Decompresses the records of a chunk.
pub(crate) fn unpack(file: &mut BufReader<File>, chunk: &Chunk) -> Result<Vec<u8>, PageFault> {
    let Some(packing) = chunk.packing else {
        return Err(DecodeError::Unsupported("a chunk is compressed by neither lz4 nor zstd".into()).into());
    };
    if chunk.unpacked_bytes > LIMITS.file_bytes {
        let reason = format!("a chunk of {} bytes; at most {} are read", chunk.unpacked_bytes, LIMITS.file_bytes);
        return Err(DecodeError::TooLarge(reason).into());
    }
    file.seek(SeekFrom::Start(chunk.begin))?;
    let packed = file.take(chunk.bytes);
    // One byte beyond the stated size is enough to detect an excess.
    let most = chunk.unpacked_bytes + 1;
    let mut records = Vec::new();
    let outcome = match packing {
        Packing::Stored => packed.take(most).read_to_end(&mut records).map_err(|error| error.to_string()),
        Packing::Lz4 => {
            let decoder = lz4_flex::frame::FrameDecoder::new(packed);
            decoder.take(most).read_to_end(&mut records).map_err(|error| error.to_string())
        }
        Packing::Zstd => ruzstd::decoding::StreamingDecoder::new(packed)
            .map_err(|error| error.to_string())
            .and_then(|decoder| decoder.take(most).read_to_end(&mut records).map_err(|error| error.to_string())),
    };
    outcome.map_err(|reason| DecodeError::Damaged(format!("a chunk cannot be unpacked: {reason}")))?;
    if records.len() as u64 != chunk.unpacked_bytes {
        let found = records.len();
        let reason = format!("a chunk unpacks to {found} bytes or more, not to {}", chunk.unpacked_bytes);
        return Err(DecodeError::Damaged(reason).into());
    }
    if chunk.checksum != 0 && crc32fast::hash(&records) != chunk.checksum {
        return Err(DecodeError::Damaged("the checksum of a chunk is wrong".into()).into());
    }
    Ok(records)
}
