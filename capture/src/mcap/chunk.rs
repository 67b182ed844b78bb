//! A chunk's packed records in, the records out. Their size is checked before memory is taken, their checksum after.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use crate::decode::DecodeError;
use crate::limits::LIMITS;
use crate::pages::PageFault;

use super::records::{Chunk, Packing};

/// The records of a chunk.
pub(super) fn unpack(file: &mut BufReader<File>, chunk: &Chunk) -> Result<Vec<u8>, PageFault> {
    let Some(packing) = chunk.packing else {
        return Err(DecodeError::Unsupported("a chunk is compressed by neither lz4 nor zstd".into()).into());
    };
    if chunk.unpacked_bytes > LIMITS.file_bytes {
        let reason = format!("a chunk of {} bytes; at most {} are read", chunk.unpacked_bytes, LIMITS.file_bytes);
        return Err(DecodeError::TooLarge(reason).into());
    }
    file.seek(SeekFrom::Start(chunk.begin))?;
    let packed = file.take(chunk.bytes);
    // One byte more than there should be is enough to know.
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
