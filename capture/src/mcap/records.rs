//! The records of an MCAP file: bytes in, their fields out; `None` where the bytes end before the field does.
//!
//! A record is an opcode, the length of its content in eight bytes, and the content; numbers are little-endian, text is
//! behind its length in four bytes (MCAP format specification, version 0).

/// What an MCAP file begins (and, when it is whole, ends) with.
pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Bytes of a record before its content.
pub(super) const HEAD_BYTES: usize = 9;

/// The opcodes that are looked at.
pub(super) mod op {
    pub const NONE: u8 = 0x00;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const DATA_END: u8 = 0x0f;
}

/// Bytes of a message before its payload.
pub(super) const MESSAGE_BYTES: usize = 22;

/// Bytes in which the fields of a chunk before its records find room.
pub(super) const CHUNK_HEAD_BYTES: usize = 64;

/// What is left of some bytes.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a>(pub &'a [u8]);

impl<'a> Rest<'a> {
    pub fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn number<const BYTES: usize>(&mut self) -> Option<[u8; BYTES]> {
        self.take(BYTES)?.try_into().ok()
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.number().map(u8::from_le_bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.number().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.number().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.number().map(u64::from_le_bytes)
    }

    /// Bytes behind their count in four bytes.
    pub fn counted(&mut self) -> Option<&'a [u8]> {
        let count = self.u32()?;
        self.take(count as usize)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.counted()?).ok()
    }

    /// The next record of a chunk: its opcode and content.
    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let opcode = self.u8()?;
        let bytes = usize::try_from(self.u64()?).ok()?;
        Some((opcode, self.take(bytes)?))
    }
}

/// What the messages of some channels look like.
pub(super) struct Schema<'a> {
    pub id: u16,
    pub name: &'a str,
}

impl<'a> Schema<'a> {
    pub fn parse(content: &'a [u8]) -> Option<Schema<'a>> {
        let mut rest = Rest(content);
        Some(Schema { id: rest.u16()?, name: rest.text()? })
    }
}

/// A stream of messages.
pub(super) struct Channel<'a> {
    pub id: u16,
    pub schema: u16,
    pub topic: &'a str,
    /// Of the messages: `protobuf`, `json`, `cdr`, `ros1` and others.
    pub encoding: &'a str,
}

impl<'a> Channel<'a> {
    pub fn parse(content: &'a [u8]) -> Option<Channel<'a>> {
        let mut rest = Rest(content);
        Some(Channel { id: rest.u16()?, schema: rest.u16()?, topic: rest.text()?, encoding: rest.text()? })
    }
}

/// A message, or its first 22 bytes.
pub(super) struct Message<'a> {
    pub channel: u16,
    /// Nanoseconds.
    pub log_time: u64,
    pub payload: &'a [u8],
}

impl<'a> Message<'a> {
    pub fn parse(content: &'a [u8]) -> Option<Message<'a>> {
        let mut rest = Rest(content);
        let channel = rest.u16()?;
        rest.u32()?; // its number
        let log_time = rest.u64()?;
        rest.u64()?; // when it was published
        Some(Message { channel, log_time, payload: rest.0 })
    }
}

/// How the records of a chunk are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    Stored,
    Lz4,
    Zstd,
}

/// Where a chunk's records are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk {
    /// `None` where it is one that is not read.
    pub packing: Option<Packing>,
    /// The byte of the file where the packed records begin, and how many bytes they are.
    pub begin: u64,
    pub bytes: u64,
    /// Of the records when they are unpacked.
    pub unpacked_bytes: u64,
    /// CRC-32 of them; 0 where it is not known.
    pub checksum: u32,
}

impl Chunk {
    /// From the first bytes of its content, which begins at byte `at` of the file.
    pub fn parse(content: &[u8], at: u64) -> Option<Chunk> {
        let mut rest = Rest(content);
        rest.take(16)?; // first and last time
        let (unpacked_bytes, checksum) = (rest.u64()?, rest.u32()?);
        let packing = match rest.counted()? {
            b"" => Some(Packing::Stored),
            b"lz4" => Some(Packing::Lz4),
            b"zstd" => Some(Packing::Zstd),
            _ => None,
        };
        let bytes = rest.u64()?;
        Some(Chunk { packing, begin: at + (content.len() - rest.0.len()) as u64, bytes, unpacked_bytes, checksum })
    }
}
