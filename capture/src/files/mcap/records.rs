//! Parses MCAP records with the crate `mcap`; `None` if the bytes are not such a record.
//!
//! The crate allocates a string's claimed length, up to 4 GiB, before checking that the bytes exist. [`claims_hold`]
//! therefore checks all claimed lengths first. Attachments are never passed to it: it panics on short ones.

use std::io::Cursor;

use binrw::BinRead;
pub(crate) use mcap::MAGIC;
pub(super) use mcap::records::{ChunkHeader, Record, op};

/// Bytes of a record's header: an opcode and the length of the content.
pub(crate) const HEAD_BYTES: usize = 9;

/// Opcode in preallocated space that a recorder never filled.
pub(super) const NONE: u8 = 0;

/// Bytes of a message before its payload.
pub(super) const MESSAGE_BYTES: usize = 22;

/// Bytes that suffice for a chunk's fields before its records.
pub(crate) const CHUNK_HEAD_BYTES: usize = 64;

/// Opcode and content length from a record's first bytes.
pub(crate) fn head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (opcode, rest) = bytes.split_first()?;
    Some((*opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// Splits off the first record: its opcode, its content and the rest.
pub(crate) fn split(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (opcode, bytes) = head(records)?;
    let (content, rest) = records.get(HEAD_BYTES..)?.split_at_checked(usize::try_from(bytes).ok()?)?;
    Some((opcode, content, rest))
}

/// Parses a schema, channel, message or message index.
pub(crate) fn record(opcode: u8, content: &[u8]) -> Option<Record<'_>> {
    let is_known = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::MESSAGE_INDEX);
    (is_known && claims_hold(opcode, content)).then(|| mcap::parse_record(opcode, content).ok())?
}

/// Parses a chunk's fields before its records; also returns their length.
pub(crate) fn chunk_header(content: &[u8]) -> Option<(ChunkHeader, u64)> {
    if !claims_hold(op::CHUNK, content) {
        return None;
    }
    let mut content = Cursor::new(content);
    let header = ChunkHeader::read_le(&mut content).ok()?;
    Some((header, content.position()))
}

/// Whether the strings and maps of a record are as long as it claims.
fn claims_hold(opcode: u8, content: &[u8]) -> bool {
    // Bytes before the strings, number of strings, and whether a map of strings follows.
    let (begin, texts, map) = match opcode {
        op::SCHEMA => (2, 2, 0),
        op::CHANNEL => (4, 2, 1),
        op::CHUNK => (28, 1, 0),
        _ => return true,
    };
    let Some(mut rest) = content.get(begin..) else { return false };
    let mut maps = &[][..];
    for number in 0..texts + map {
        let Some((text, behind)) = counted(rest) else { return false };
        (maps, rest) = (if number < texts { maps } else { text }, behind);
    }
    while !maps.is_empty() {
        let Some((_, behind)) = counted(maps) else { return false };
        maps = behind;
    }
    true
}

/// Splits off bytes with a 4-byte length prefix.
fn counted(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (count, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(u32::from_le_bytes(*count) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(claimed: u32, text: &str) -> Vec<u8> {
        [&claimed.to_le_bytes()[..], text.as_bytes()].concat()
    }

    /// Each length of each record, once correct and once 4 GiB.
    #[test]
    fn false_string_lengths_are_rejected_before_allocation() {
        let lie = u32::MAX;
        for liar in 0..6 {
            let count = |number: usize, honest: u32| if number == liar { lie } else { honest };
            let map = [text(count(3, 1), "k"), text(count(4, 1), "v")].concat();
            let channel = [
                vec![1, 0, 1, 0],
                text(count(1, 2), "/i"),
                text(count(2, 3), "cdr"),
                text(count(5, map.len() as u32), ""),
                map,
            ];
            assert_eq!(record(op::CHANNEL, &channel.concat()).is_some(), liar == 0, "channel, {liar}");
        }
        for liar in 0..4 {
            let count = |number: usize, honest: u32| if number == liar { lie } else { honest };
            let schema = [vec![1, 0], text(count(1, 2), "ab"), text(count(2, 1), "c"), text(count(3, 0), "")];
            assert_eq!(record(op::SCHEMA, &schema.concat()).is_some(), liar == 0, "schema, {liar}");
        }
        for claimed in [3, lie] {
            let chunk = [vec![0; 28], text(claimed, "lz4"), vec![7, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1]].concat();
            let found = chunk_header(&chunk).map(|(header, bytes)| (header.compression, header.compressed_size, bytes));
            assert_eq!(found, (claimed == 3).then(|| ("lz4".to_string(), 7, 43)));
        }
        assert!(record(op::ATTACHMENT, &[0; 3]).is_none());
    }
}
