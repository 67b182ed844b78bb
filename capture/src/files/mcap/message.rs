//! Decodes the payload of a message into its still encoded picture.
//!
//! foxglove.CompressedImage and foxglove.RawImage as Protobuf, JSON, CDR and ROS 1; ROS sensor_msgs Image and
//! CompressedImage as CDR and ROS 1. Readers are total: invalid bytes are an error, never a panic.

use std::borrow::Cow;

use base64::Engine as _;
use serde::Deserialize;

use crate::picture::DecodeError;

use super::protobuf::{Fields, Value};
use super::ros::Ros;

/// A picture as recorded.
#[derive(Debug, PartialEq)]
pub(super) enum Image<'a> {
    Compressed { format: Cow<'a, str>, bytes: Cow<'a, [u8]> },
    Raw(Raw<'a>),
}

/// Uncompressed rows of pixels.
#[derive(Debug, PartialEq)]
pub(super) struct Raw<'a> {
    pub width: u32,
    pub height: u32,
    /// Name of the pixel format.
    pub encoding: Cow<'a, str>,
    /// Row stride, bytes.
    pub step: u32,
    pub is_big_endian: bool,
    pub bytes: Cow<'a, [u8]>,
}

/// Message type of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MessageFields {
    FoxgloveCompressed,
    FoxgloveRaw,
    /// Video, whose pictures depend on earlier ones; single pictures cannot be read.
    FoxgloveVideo,
    RosCompressed,
    RosRaw,
}

/// Schema names, as the various libraries write them.
const NAMES: [(&str, MessageFields); 16] = [
    ("foxglove.CompressedImage", MessageFields::FoxgloveCompressed),
    ("foxglove::CompressedImage", MessageFields::FoxgloveCompressed),
    ("foxglove_msgs/msg/CompressedImage", MessageFields::FoxgloveCompressed),
    ("foxglove_msgs/CompressedImage", MessageFields::FoxgloveCompressed),
    ("foxglove.RawImage", MessageFields::FoxgloveRaw),
    ("foxglove::RawImage", MessageFields::FoxgloveRaw),
    ("foxglove_msgs/msg/RawImage", MessageFields::FoxgloveRaw),
    ("foxglove_msgs/RawImage", MessageFields::FoxgloveRaw),
    ("foxglove.CompressedVideo", MessageFields::FoxgloveVideo),
    ("foxglove::CompressedVideo", MessageFields::FoxgloveVideo),
    ("foxglove_msgs/msg/CompressedVideo", MessageFields::FoxgloveVideo),
    ("foxglove_msgs/CompressedVideo", MessageFields::FoxgloveVideo),
    ("sensor_msgs/msg/CompressedImage", MessageFields::RosCompressed),
    ("sensor_msgs/CompressedImage", MessageFields::RosCompressed),
    ("sensor_msgs/msg/Image", MessageFields::RosRaw),
    ("sensor_msgs/Image", MessageFields::RosRaw),
];

impl MessageFields {
    /// By schema name; `None` for non-pictures.
    pub fn of(name: &str) -> Option<MessageFields> {
        NAMES.iter().find(|(known, _)| *known == name).map(|(_, layout)| *layout)
    }
}

/// Serialization of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum MessageEncoding {
    Protobuf,
    Json,
    Cdr,
    Ros1,
    /// An unsupported one.
    Other(String),
}

impl MessageEncoding {
    pub fn of(name: &str) -> MessageEncoding {
        match name {
            "protobuf" => MessageEncoding::Protobuf,
            "json" => MessageEncoding::Json,
            "cdr" => MessageEncoding::Cdr,
            "ros1" => MessageEncoding::Ros1,
            other => MessageEncoding::Other(other.chars().filter(|c| !c.is_control()).take(40).collect()),
        }
    }

    fn name(&self) -> &str {
        match self {
            MessageEncoding::Protobuf => "protobuf",
            MessageEncoding::Json => "json",
            MessageEncoding::Cdr => "cdr",
            MessageEncoding::Ros1 => "ros1",
            MessageEncoding::Other(name) => name,
        }
    }
}

/// Decodes a message.
pub(super) fn image<'a>(
    layout: MessageFields,
    encoding: &MessageEncoding,
    payload: &'a [u8],
) -> Result<Image<'a>, DecodeError> {
    let is_foxglove = !is_ros(layout);
    let image = match encoding {
        MessageEncoding::Protobuf if is_foxglove => protobuf(layout, payload),
        MessageEncoding::Json if is_foxglove => return json(layout, payload),
        MessageEncoding::Cdr => Ros::cdr(payload).and_then(|fields| ros(layout, fields)),
        MessageEncoding::Ros1 => ros(layout, Ros::ros1(payload)),
        other => {
            let known = if is_foxglove { "protobuf, json, cdr and ros1" } else { "cdr and ros1" };
            let reason = format!("its images are encoded as `{}`; {known} are read", other.name());
            return Err(DecodeError::Unsupported(reason));
        }
    };
    image.ok_or_else(|| damaged("fields end early, or are of other types than an image's"))
}

fn is_ros(layout: MessageFields) -> bool {
    matches!(layout, MessageFields::RosCompressed | MessageFields::RosRaw)
}

fn protobuf(layout: MessageFields, payload: &[u8]) -> Option<Image<'_>> {
    let (mut numbers, mut texts) = ([0u32; 6], [&[][..]; 7]);
    for field in Fields::of(payload) {
        match field? {
            (number @ 2..=5, Value::Number(value)) => numbers[number as usize] = u32::try_from(value).ok()?,
            (number @ 2..=6, Value::Bytes(bytes)) => texts[number as usize] = bytes,
            _ => {}
        }
    }
    let text = |number: usize| std::str::from_utf8(texts[number]).ok().map(Cow::Borrowed);
    Some(match layout {
        MessageFields::FoxgloveCompressed => Image::Compressed { format: text(3)?, bytes: Cow::Borrowed(texts[2]) },
        MessageFields::FoxgloveVideo => Image::Compressed { format: text(4)?, bytes: Cow::Borrowed(texts[3]) },
        _ => Image::Raw(Raw {
            width: numbers[2],
            height: numbers[3],
            encoding: text(4)?,
            step: numbers[5],
            is_big_endian: false,
            bytes: Cow::Borrowed(texts[6]),
        }),
    })
}

fn ros(layout: MessageFields, mut fields: Ros<'_>) -> Option<Image<'_>> {
    if is_ros(layout) && fields.has_header_number() {
        fields.u32()?;
    }
    fields.u32()?; // timestamp, seconds
    fields.u32()?; // timestamp, nanoseconds
    fields.text()?; // frame id
    Some(match layout {
        MessageFields::FoxgloveCompressed | MessageFields::FoxgloveVideo => {
            let bytes = Cow::Borrowed(fields.bytes()?);
            Image::Compressed { format: Cow::Borrowed(fields.text()?), bytes }
        }
        MessageFields::RosCompressed => {
            let format = Cow::Borrowed(fields.text()?);
            Image::Compressed { format, bytes: Cow::Borrowed(fields.bytes()?) }
        }
        MessageFields::FoxgloveRaw => Image::Raw(Raw {
            width: fields.u32()?,
            height: fields.u32()?,
            encoding: Cow::Borrowed(fields.text()?),
            step: fields.u32()?,
            is_big_endian: false,
            bytes: Cow::Borrowed(fields.bytes()?),
        }),
        MessageFields::RosRaw => {
            let (height, width) = (fields.u32()?, fields.u32()?);
            let (encoding, is_big_endian) = (Cow::Borrowed(fields.text()?), fields.u8()? != 0);
            let step = fields.u32()?;
            Image::Raw(Raw { width, height, encoding, step, is_big_endian, bytes: Cow::Borrowed(fields.bytes()?) })
        }
    })
}

#[derive(Deserialize)]
struct CompressedDocument<'a> {
    #[serde(borrow)]
    format: Cow<'a, str>,
    #[serde(borrow)]
    data: Cow<'a, str>,
}

#[derive(Deserialize)]
struct RawDocument<'a> {
    width: u32,
    height: u32,
    #[serde(borrow)]
    encoding: Cow<'a, str>,
    step: u32,
    #[serde(borrow)]
    data: Cow<'a, str>,
}

fn json(layout: MessageFields, payload: &[u8]) -> Result<Image<'_>, DecodeError> {
    let wrong = |error: serde_json::Error| damaged(&error.to_string());
    let bytes = |text: &str| {
        let bytes = base64::engine::general_purpose::STANDARD.decode(text);
        bytes.map(Cow::Owned).map_err(|error| damaged(&format!("its data are not base64: {error}")))
    };
    Ok(match layout {
        MessageFields::FoxgloveCompressed | MessageFields::FoxgloveVideo => {
            let CompressedDocument { format, data } = serde_json::from_slice(payload).map_err(wrong)?;
            Image::Compressed { format, bytes: bytes(&data)? }
        }
        _ => {
            let RawDocument { width, height, encoding, step, data } = serde_json::from_slice(payload).map_err(wrong)?;
            Image::Raw(Raw { width, height, encoding, step, is_big_endian: false, bytes: bytes(&data)? })
        }
    })
}

fn damaged(reason: &str) -> DecodeError {
    DecodeError::Damaged(format!("a message cannot be read: {reason}"))
}
