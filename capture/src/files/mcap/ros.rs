//! Reads the sequential fields of CDR (ROS 2, DDS) and ROS 1 messages.

/// Read position in a message.
#[derive(Clone, Copy)]
pub(super) struct Ros<'a> {
    bytes: &'a [u8],
    at: usize,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Numbers are aligned to their size; strings end with a zero byte.
    CdrLittleEndian,
    CdrBigEndian,
    /// Little-endian, unaligned.
    Ros1,
}

impl<'a> Ros<'a> {
    /// Reads the CDR kind from the first four bytes; `None` for encodings with members in arbitrary order.
    pub fn cdr(payload: &'a [u8]) -> Option<Ros<'a>> {
        let (head, bytes) = payload.split_at_checked(4)?;
        // Plain CDR, versions 1 and 2: they differ only in 8-byte numbers, which images lack.
        let kind = match head[..2] {
            [0, 0] | [0, 6] => Kind::CdrBigEndian,
            [0, 1] | [0, 7] => Kind::CdrLittleEndian,
            _ => return None,
        };
        Some(Ros { bytes, at: 0, kind })
    }

    pub fn ros1(payload: &'a [u8]) -> Ros<'a> {
        Ros { bytes: payload, at: 0, kind: Kind::Ros1 }
    }

    /// ROS 1 headers have a sequence number before the time.
    pub fn has_header_number(&self) -> bool {
        self.kind == Kind::Ros1
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let taken = self.bytes.get(self.at..self.at.checked_add(count)?)?;
        self.at += count;
        Some(taken)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.take(1).map(|bytes| bytes[0])
    }

    pub fn u32(&mut self) -> Option<u32> {
        if self.kind != Kind::Ros1 {
            self.at = self.at.checked_next_multiple_of(4)?;
        }
        let bytes = self.take(4)?.try_into().ok()?;
        Some(if self.kind == Kind::CdrBigEndian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    /// Bytes with a length prefix.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let count = self.u32()?;
        self.take(count as usize)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        let bytes = self.bytes()?;
        let bytes = if self.kind == Kind::Ros1 { bytes } else { bytes.strip_suffix(&[0]).unwrap_or(bytes) };
        std::str::from_utf8(bytes).ok()
    }
}
