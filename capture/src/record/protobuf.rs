//! Protobuf writer. Zero and empty fields are written as well: readers accept both.

/// A message being written.
#[derive(Clone, Debug, Default)]
pub(super) struct ProtobufMessage(Vec<u8>);

const VARINT: u32 = 0;
const FIXED64: u32 = 1;
const COUNTED: u32 = 2;
const FIXED32: u32 = 5;

impl ProtobufMessage {
    /// An empty message with capacity for `bytes`.
    pub fn with_capacity(bytes: usize) -> ProtobufMessage {
        ProtobufMessage(Vec::with_capacity(bytes))
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn tag(&mut self, number: u32, kind: u32) {
        self.varint(u64::from(number << 3 | kind));
    }

    /// `int32`, `uint32`, `int64` or an enum; all values here are non-negative.
    pub fn number(mut self, number: u32, value: u64) -> ProtobufMessage {
        self.tag(number, VARINT);
        self.varint(value);
        self
    }

    /// `fixed32`
    pub fn fixed32(mut self, number: u32, value: u32) -> ProtobufMessage {
        self.tag(number, FIXED32);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// `double`
    pub fn double(mut self, number: u32, value: f64) -> ProtobufMessage {
        self.tag(number, FIXED64);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// `repeated double`
    pub fn doubles(mut self, number: u32, values: &[f64]) -> ProtobufMessage {
        self.tag(number, COUNTED);
        self.varint(8 * values.len() as u64);
        values.iter().for_each(|value| self.0.extend(value.to_le_bytes()));
        self
    }

    /// `string`
    pub fn text(self, number: u32, text: &str) -> ProtobufMessage {
        self.bytes(number, text.as_bytes())
    }

    /// `bytes`
    pub fn bytes(mut self, number: u32, bytes: &[u8]) -> ProtobufMessage {
        self.tag(number, COUNTED);
        self.varint(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    /// `bytes` of `length`, which `write` appends.
    pub fn counted(mut self, number: u32, length: usize, write: impl FnOnce(&mut Vec<u8>)) -> ProtobufMessage {
        self.tag(number, COUNTED);
        self.varint(length as u64);
        let begin = self.0.len();
        write(&mut self.0);
        debug_assert_eq!(self.0.len() - begin, length);
        self
    }

    /// A nested message.
    pub fn message(self, number: u32, message: ProtobufMessage) -> ProtobufMessage {
        self.bytes(number, &message.0)
    }

    /// The encoded message.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Examples of Protobuf's encoding documentation.
    #[test]
    fn encoding_matches_the_documented_examples() {
        assert_eq!(ProtobufMessage::default().number(1, 150).finish(), [0x08, 0x96, 0x01]);
        assert_eq!(ProtobufMessage::default().text(2, "testing").finish(), *b"\x12\x07testing");
        let inner = ProtobufMessage::default().number(1, 150);
        assert_eq!(ProtobufMessage::default().message(3, inner).finish(), [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(ProtobufMessage::default().fixed32(5, 1).finish(), [0x2d, 1, 0, 0, 0]);
        let doubles = ProtobufMessage::default().doubles(4, &[1.0]).double(6, 1.0).finish();
        let one = 1f64.to_le_bytes();
        assert_eq!(doubles, [&[0x22, 8][..], &one, &[0x31], &one].concat());
    }
}
