//! Foxglove message schemas used in recordings, as one table of fields and as the Protobuf `FileDescriptorSet` that each
//! recording embeds, so that readers need no other schema.

use super::protobuf::ProtobufMessage;

/// Type of a field, with Protobuf's type numbers.
#[derive(Clone, Copy)]
enum FieldType {
    Double,
    Int64,
    Int32,
    Fixed32,
    Text,
    Bytes,
    Message(&'static str),
    Enum(&'static str),
}

use FieldType::{Bytes, Double, Enum, Fixed32, Int32, Int64, Message, Text};

impl FieldType {
    fn number(self) -> u64 {
        match self {
            Double => 1,
            Int64 => 3,
            Int32 => 5,
            Fixed32 => 7,
            Text => 9,
            Message(_) => 11,
            Bytes => 12,
            Enum(_) => 14,
        }
    }
}

/// Field labels.
const ONCE: u64 = 1;
const REPEATED: u64 = 3;

struct Field(&'static str, u32, u64, FieldType);

const STAMP: FieldType = Message(".google.protobuf.Timestamp");

const TIMESTAMP: [(&str, &[Field]); 1] =
    [("Timestamp", &[Field("seconds", 1, ONCE, Int64), Field("nanos", 2, ONCE, Int32)])];

const FOXGLOVE: [(&str, &[Field]); 11] = [
    ("Point2", &[Field("x", 1, ONCE, Double), Field("y", 2, ONCE, Double)]),
    (
        "Color",
        &[
            Field("r", 1, ONCE, Double),
            Field("g", 2, ONCE, Double),
            Field("b", 3, ONCE, Double),
            Field("a", 4, ONCE, Double),
        ],
    ),
    ("Vector3", &[Field("x", 1, ONCE, Double), Field("y", 2, ONCE, Double), Field("z", 3, ONCE, Double)]),
    (
        "Quaternion",
        &[
            Field("x", 1, ONCE, Double),
            Field("y", 2, ONCE, Double),
            Field("z", 3, ONCE, Double),
            Field("w", 4, ONCE, Double),
        ],
    ),
    (
        "Pose",
        &[
            Field("position", 1, ONCE, Message(".foxglove.Vector3")),
            Field("orientation", 2, ONCE, Message(".foxglove.Quaternion")),
        ],
    ),
    (
        "RawImage",
        &[
            Field("timestamp", 1, ONCE, STAMP),
            Field("frame_id", 7, ONCE, Text),
            Field("width", 2, ONCE, Fixed32),
            Field("height", 3, ONCE, Fixed32),
            Field("encoding", 4, ONCE, Text),
            Field("step", 5, ONCE, Fixed32),
            Field("data", 6, ONCE, Bytes),
        ],
    ),
    (
        "CompressedImage",
        &[
            Field("timestamp", 1, ONCE, STAMP),
            Field("frame_id", 4, ONCE, Text),
            Field("data", 2, ONCE, Bytes),
            Field("format", 3, ONCE, Text),
        ],
    ),
    (
        "CameraCalibration",
        &[
            Field("timestamp", 1, ONCE, STAMP),
            Field("frame_id", 9, ONCE, Text),
            Field("width", 2, ONCE, Fixed32),
            Field("height", 3, ONCE, Fixed32),
            Field("distortion_model", 4, ONCE, Text),
            Field("D", 5, REPEATED, Double),
            Field("K", 6, REPEATED, Double),
            Field("R", 7, REPEATED, Double),
            Field("P", 8, REPEATED, Double),
        ],
    ),
    (
        "PointsAnnotation",
        &[
            Field("timestamp", 1, ONCE, STAMP),
            Field("type", 2, ONCE, Enum(".foxglove.PointsAnnotation.Type")),
            Field("points", 3, REPEATED, Message(".foxglove.Point2")),
            Field("outline_color", 4, ONCE, Message(".foxglove.Color")),
            Field("outline_colors", 5, REPEATED, Message(".foxglove.Color")),
            Field("fill_color", 6, ONCE, Message(".foxglove.Color")),
            Field("thickness", 7, ONCE, Double),
        ],
    ),
    ("ImageAnnotations", &[Field("points", 2, REPEATED, Message(".foxglove.PointsAnnotation"))]),
    (
        "Odometry",
        &[
            Field("timestamp", 1, ONCE, STAMP),
            Field("frame_id", 2, ONCE, Text),
            Field("body_frame_id", 3, ONCE, Text),
            Field("pose", 4, ONCE, Message(".foxglove.Pose")),
            Field("pose_covariance", 7, REPEATED, Double),
        ],
    ),
];

/// The only enum, of `PointsAnnotation`.
const TYPES: [&str; 5] = ["UNKNOWN", "POINTS", "LINE_LOOP", "LINE_STRIP", "LINE_LIST"];

fn message((name, fields): &(&str, &[Field])) -> ProtobufMessage {
    let mut message = ProtobufMessage::default().text(1, name);
    for Field(name, number, label, kind) in *fields {
        let field = ProtobufMessage::default().text(1, name).number(3, u64::from(*number));
        let field = field.number(4, *label).number(5, kind.number());
        message = message.message(
            2,
            match kind {
                Message(of) | Enum(of) => field.text(6, of),
                _ => field,
            },
        );
    }
    if *name == "PointsAnnotation" {
        let value = |(number, name): (usize, &&str)| ProtobufMessage::default().text(1, name).number(2, number as u64);
        let values = TYPES.iter().enumerate().map(value);
        let types = values.fold(ProtobufMessage::default().text(1, "Type"), |all, value| all.message(2, value));
        message = message.message(4, types);
    }
    message
}

fn file(name: &str, package: &str, needs: &[&str], messages: &[(&str, &[Field])]) -> ProtobufMessage {
    let file = ProtobufMessage::default().text(1, name).text(2, package);
    let file = needs.iter().fold(file, |file, needed| file.text(3, needed));
    messages.iter().fold(file, |file, one| file.message(4, message(one))).text(12, "proto3")
}

/// Descriptors of all messages and their dependencies.
pub(super) fn descriptors() -> Vec<u8> {
    let stamps = "google/protobuf/timestamp.proto";
    ProtobufMessage::default()
        .message(1, file(stamps, "google.protobuf", &[], &TIMESTAMP))
        .message(1, file("foxglove/recording.proto", "foxglove", &[stamps], &FOXGLOVE))
        .finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Field types are defined earlier in the table, and field numbers are unique.
    #[test]
    fn field_types_are_defined_before_use_and_numbers_are_unique() {
        for (at, (name, fields)) in FOXGLOVE.iter().enumerate() {
            for (place, Field(field, number, _, kind)) in fields.iter().enumerate() {
                assert!(fields[..place].iter().all(|Field(_, other, ..)| other != number), "{name}.{field}");
                if let Message(of) = kind {
                    let known = FOXGLOVE[..at].iter().any(|(other, _)| format!(".foxglove.{other}") == **of);
                    assert!(known || *of == ".google.protobuf.Timestamp", "{name}.{field}: {of}");
                }
            }
        }
        assert!(descriptors().windows(17).any(|bytes| bytes == b"foxglove/recordin"));
    }
}
