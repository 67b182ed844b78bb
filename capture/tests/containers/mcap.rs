//! MCAP: every kind of image message, complete and damaged files, topics.
//!
//! `reference-lz4.mcap` and `reference-zstd.mcap` were written by another library, the crate `mcap` 0.26: chunks of 300
//! bytes, messages of `/imu` among those of `/camera/image`, sensor_msgs/msg/Image of 4 × 3 pixels, mono8. Pixel i of image
//! n is 10 n + i, its log time 1000 n + 5; image 3 was written before image 2.

use isophote_capture::{FrameSource, Recording, encode_png};
use isophote_jit::PixelFormat;

use crate::{frames, mutated, refusal};

const REFERENCES: [(&str, &[u8]); 2] =
    [("lz4.mcap", include_bytes!("reference-lz4.mcap")), ("zstd.mcap", include_bytes!("reference-zstd.mcap"))];

/// Pixels of 3 × 2, and as in a message: with two padding bytes per row.
const PIXELS: [u8; 6] = [7, 8, 9, 20, 21, 255];
const ROWS: [u8; 10] = [7, 8, 9, 0, 0, 20, 21, 255, 0, 0];

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn counted(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

/// A schema and a channel with the same id.
fn channel(number: u16, topic: &str, schema: &str, encoding: &str) -> Vec<u8> {
    let number = number.to_le_bytes();
    let described = [&number[..], &counted(schema.as_bytes()), &counted(b"any"), &counted(b"")].concat();
    let channel =
        [&number[..], &number, &counted(topic.as_bytes()), &counted(encoding.as_bytes()), &counted(b"")].concat();
    [record(3, &described), record(4, &channel)].concat()
}

fn message(channel: u16, log_time: u64, payload: &[u8]) -> Vec<u8> {
    record(5, &[&channel.to_le_bytes()[..], &[0; 4], &log_time.to_le_bytes(), &[0; 8], payload].concat())
}

fn chunk(packing: &str, unpacked_bytes: u64, checksum: u32, packed: &[u8]) -> Vec<u8> {
    let head =
        [&[0; 16][..], &unpacked_bytes.to_le_bytes(), &checksum.to_le_bytes(), &counted(packing.as_bytes())].concat();
    record(6, &[&head[..], &(packed.len() as u64).to_le_bytes(), packed].concat())
}

/// A valid file from the crate's writer: channels by topic, schema and encoding; messages by channel and log time.
fn written(options: mcap::WriteOptions, channels: &[[&str; 3]], messages: &[(usize, u64, &[u8])]) -> Vec<u8> {
    let mut writer = options.compression(None).create(std::io::Cursor::new(Vec::new())).unwrap();
    let add = |[topic, schema, encoding]: &[&str; 3]| {
        let schema = writer.add_schema(schema, "any", b"").unwrap();
        writer.add_channel(schema, topic, encoding, &Default::default()).unwrap()
    };
    let numbers: Vec<u16> = channels.iter().map(add).collect();
    for (channel, log_time, payload) in messages {
        let (channel_id, log_time) = (numbers[*channel], *log_time);
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: 0 };
        writer.write_to_known_channel(&header, payload).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn message_index(channel: u16, entries: &[(u64, u64)]) -> Vec<u8> {
    let entries: Vec<u8> = entries.iter().flat_map(|(t, at)| [t.to_le_bytes(), at.to_le_bytes()].concat()).collect();
    record(7, &[&channel.to_le_bytes()[..], &counted(&entries)].concat())
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    let magic = b"\x89MCAP0\r\n";
    [&magic[..], &record(1, &[0; 8]), &records.concat(), &record(2, &[0; 20]), magic].concat()
}

/// Builds CDR fields (4-byte aligned, either byte order) or ROS 1 fields (unaligned).
struct Fields {
    bytes: Vec<u8>,
    kind: &'static str,
}

impl Fields {
    fn new(kind: &'static str) -> Fields {
        let bytes = [("ros1", &[][..]), ("cdr", &[0, 1, 0, 0]), ("big-endian cdr", &[0, 0, 0, 0])];
        Fields { bytes: bytes.iter().find(|(name, _)| *name == kind).unwrap().1.to_vec(), kind }
    }

    fn u32(mut self, value: u32) -> Fields {
        if self.kind != "ros1" {
            self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        }
        self.bytes.extend(if self.kind == "big-endian cdr" { value.to_be_bytes() } else { value.to_le_bytes() });
        self
    }

    fn u8(mut self, value: u8) -> Fields {
        self.bytes.push(value);
        self
    }

    fn data(self, data: &[u8]) -> Fields {
        let mut fields = self.u32(data.len() as u32);
        fields.bytes.extend_from_slice(data);
        fields
    }

    fn text(self, text: &str) -> Fields {
        let end = if self.kind == "ros1" { "" } else { "\0" };
        self.data(format!("{text}{end}").as_bytes())
    }

    fn time(self) -> Fields {
        self.u32(17).u32(99)
    }

    fn header(self) -> Fields {
        let fields = if self.kind == "ros1" { self.u32(3) } else { self };
        fields.time().text("cam0")
    }
}

fn protobuf(fields: &[(u8, &[u8])]) -> Vec<u8> {
    // Numbers are fixed32 (wire type 5), all else is length-delimited (2).
    let one = |(key, bytes): &(u8, &[u8])| {
        let count = if key & 7 == 2 { vec![(bytes.len() | 128) as u8, (bytes.len() >> 7) as u8] } else { Vec::new() };
        [&[*key][..], &count, bytes].concat()
    };
    fields.iter().flat_map(one).collect()
}

/// Encodes each three bytes as four characters.
fn base64(bytes: &[u8]) -> String {
    let letters: Vec<char> = ('A'..='Z').chain('a'..='z').chain('0'..='9').chain(['+', '/']).collect();
    let group = |three: &[u8]| {
        let bits = three.iter().chain(&[0; 2]).take(3).fold(0u32, |bits, byte| bits << 8 | u32::from(*byte));
        (0..4)
            .map(|i| if i > three.len() { '=' } else { letters[(bits >> (18 - 6 * i) & 63) as usize] })
            .collect::<String>()
    };
    bytes.chunks(3).map(group).collect()
}

/// A message of every supported schema and encoding, all with the same pixels.
fn kinds() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let png = encode_png(3, 2, PixelFormat::U8, &PIXELS).unwrap();
    let number = |value: u32| value.to_le_bytes();
    let mut kinds = vec![
        (
            "foxglove.RawImage",
            "protobuf",
            protobuf(&[
                (10, b"\x08\x05"),
                (0x15, &number(3)),
                (0x1d, &number(2)),
                (0x22, b"mono8"),
                (0x2d, &number(5)),
                (0x32, &ROWS),
                (0x3a, b"cam0"),
            ]),
        ),
        ("foxglove.CompressedImage", "protobuf", protobuf(&[(0x12, &png), (0x1a, b"png"), (0x22, b"cam0")])),
        (
            "foxglove.RawImage",
            "json",
            format!(
                r#"{{"timestamp":{{"sec":1,"nsec":2}},"frame_id":"","width":3,"height":2,"encoding":"8UC1","step":5,"data":"{}"}}"#,
                base64(&ROWS)
            )
            .into_bytes(),
        ),
        (
            "foxglove.CompressedImage",
            "json",
            format!(r#"{{"data":"{}","format":"png","frame_id":"a\"b"}}"#, base64(&png)).into_bytes(),
        ),
    ];
    for (kind, encoding, package) in [
        ("cdr", "cdr", "sensor_msgs/msg"),
        ("big-endian cdr", "cdr", "sensor_msgs/msg"),
        ("ros1", "ros1", "sensor_msgs"),
    ] {
        let raw = Fields::new(kind).header().u32(2).u32(3).text("mono8").u8(0).u32(5).data(&ROWS);
        let compressed = Fields::new(kind).header().text("mono8; png compressed ").data(&png);
        let [image, small] = if package == "sensor_msgs" {
            ["sensor_msgs/Image", "sensor_msgs/CompressedImage"]
        } else {
            ["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"]
        };
        kinds.extend([(image, encoding, raw.bytes), (small, encoding, compressed.bytes)]);
        let raw = Fields::new(kind).time().text("cam0").u32(3).u32(2).text("mono8").u32(5).data(&ROWS);
        let compressed = Fields::new(kind).time().text("cam0").data(&png).text("png");
        let [image, small] = if package == "sensor_msgs" {
            ["foxglove_msgs/RawImage", "foxglove_msgs/CompressedImage"]
        } else {
            ["foxglove_msgs/msg/RawImage", "foxglove_msgs/msg/CompressedImage"]
        };
        kinds.extend([(image, encoding, raw.bytes), (small, encoding, compressed.bytes)]);
    }
    kinds
}

#[test]
fn every_kind_of_message_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kinds.mcap");
    for (schema, encoding, payload) in kinds() {
        // Without chunks, in a chunk, and in a chunk without an index.
        let options = || mcap::WriteOptions::new();
        for options in [options().use_chunks(false), options(), options().emit_message_indexes(false)] {
            std::fs::write(&path, written(options, &[["/image", schema, encoding]], &[(0, 5, &payload)])).unwrap();
            let mut recording = Recording::open(&path).unwrap();
            assert_eq!((recording.len(), recording.size()), (1, Some(vec![3, 2])), "{schema} {encoding}");
            let found = frames(&mut recording);
            assert_eq!(
                found,
                [("kinds.mcap".into(), vec![3, 2], PIXELS.map(f64::from).to_vec())],
                "{schema} {encoding}"
            );
        }
        // A truncated message is an error, unless only unneeded fields are missing.
        let mut refused = 0;
        for end in (0..payload.len()).step_by(3) {
            let records = [channel(1, "/image", schema, encoding), message(1, 5, &payload[..end])];
            std::fs::write(&path, file(&records)).unwrap();
            match Recording::open(&path).unwrap().next() {
                Err(_) => refused += 1,
                Ok(captured) => assert_eq!(captured.unwrap().frame.plane_view(0).pixel(2, 1), 255.0, "{schema} {end}"),
            }
        }
        assert!(refused > payload.len() / 4, "{schema} {encoding}: {refused}");
    }
}

/// Files of another library: compressed chunks, a summary, another topic among the images, a log time out of order.
#[test]
fn files_of_another_library_are_read_in_time_order() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in REFERENCES {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let mut recording = Recording::open(&path).unwrap();
        assert_eq!((recording.len(), recording.size()), (7, Some(vec![4, 3])));
        assert!(recording.description().ends_with("(7 frames)"), "{}", recording.description());
        let found = frames(&mut recording);
        for (n, (file, size, pixels)) in found.iter().enumerate() {
            let expected: Vec<f64> = (0..12).map(|i| (10 * n + i) as f64).collect();
            assert_eq!((file, &size[..], pixels), (&format!("{name}#{n}"), &[4, 3][..], &expected));
        }
        recording.rewind();
        assert_eq!(frames(&mut recording), found);
        let mut stack = Recording::of_dimensions(&path, 3).unwrap();
        assert_eq!(stack.next().unwrap().unwrap().frame.plane_view(0).pixel_at([1, 2, 6, 0]), 69.0);

        // A recorder that crashed: the images before the cut are read.
        let (mut lengths, mut broken) = (Vec::new(), 0);
        for end in (8..bytes.len()).step_by(7) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            let Ok(mut recording) = Recording::open(&path) else {
                lengths.push(0);
                continue;
            };
            // The last item is the error, unless only the summary is missing.
            let mut pixels = Vec::new();
            let error = loop {
                match recording.next() {
                    Ok(Some(captured)) => pixels.push(captured.frame.planes()[0].buffer.bytes().to_vec()),
                    Ok(None) => break None,
                    Err(error) => break Some(error.to_string()),
                }
            };
            assert!(recording.next().unwrap().is_none());
            let known = |one: &Vec<u8>| {
                found.iter().any(|known| known.2 == one.iter().copied().map(f64::from).collect::<Vec<_>>())
            };
            assert!(pixels.iter().all(known), "{name} cut at {end}");
            lengths.push(pixels.len());
            match error {
                Some(error) => {
                    let words = format!("{name}: damaged: it breaks off behind picture {}", pixels.len());
                    assert!(error.contains(&words), "{error}");
                    broken += 1;
                }
                None => assert_eq!(pixels.len(), 7, "{name} cut at {end}"),
            }
        }
        assert!(lengths.is_sorted() && lengths[0] == 0 && lengths.ends_with(&[7]), "{lengths:?}");
        assert!(broken > 10 && broken < lengths.len(), "{broken} of {}", lengths.len());
        assert!((1..7).any(|length| lengths.contains(&length)), "{lengths:?}");
    }
}

/// A file is opened and indexed once, even if it is deleted meanwhile.
#[test]
fn a_file_is_opened_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("once.mcap");
    std::fs::write(&path, REFERENCES[0].1).unwrap();
    let mut recording = Recording::open(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(recording.size(), Some(vec![4, 3]));
    assert_eq!(frames(&mut recording).len(), 7);
    recording.rewind();
    assert_eq!(frames(&mut recording).len(), 7);
}

#[test]
fn the_path_selects_one_of_several_topics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.mcap");
    let image =
        |value: u8| Fields::new("cdr").header().u32(1).u32(2).text("mono8").u8(0).u32(2).data(&[value; 2]).bytes;
    let channels = [
        ["/left/image", "sensor_msgs/msg/Image", "cdr"],
        ["/right/image", "sensor_msgs/msg/Image", "cdr"],
        ["/imu", "sensor_msgs/msg/Imu", "cdr"],
        ["/empty", "sensor_msgs/msg/Image", "cdr"],
    ];
    let messages: [(usize, u64, &[u8]); 4] =
        [(0, 10, &image(1)), (1, 11, &image(2)), (2, 12, b"turned"), (0, 20, &image(3))];
    std::fs::write(&path, written(mcap::WriteOptions::new(), &channels, &messages)).unwrap();
    let message = refusal(&path);
    let words = "several topics, /left/image, /right/image; name one behind the file: FILE.mcap#/left/image";
    assert!(message.contains("two.mcap") && message.contains(words), "{message}");
    let of = |topic: &str| folder.path().join(format!("two.mcap#{topic}"));
    let mut left = Recording::open(of("/left/image")).unwrap();
    assert_eq!((left.len(), left.size()), (2, Some(vec![2, 1])));
    let found = frames(&mut left);
    assert_eq!((found[0].0.as_str(), found[1].2[0]), ("two.mcap#0", 3.0));
    assert_eq!(frames(&mut Recording::open(of("/right/image")).unwrap())[0].2, [2.0, 2.0]);
    assert_eq!(Recording::of_dimensions(of("/left/image"), 3).unwrap().size(), Some(vec![2, 1, 2]));
    let message = refusal(&of("/imu"));
    assert!(message.contains("no images stand on the topic /imu; they do on /left/image, /right/image"), "{message}");
    let missing = refusal(&folder.path().join("none.mcap#/left/image"));
    assert!(missing.ends_with("none.mcap: no such file or folder"), "{missing}");
}

/// Frame times are the log times, with their gaps.
#[test]
fn frame_times_are_log_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gap.mcap");
    let image = Fields::new("cdr").header().u32(1).u32(2).text("mono8").u8(0).u32(2).data(&[7; 2]).bytes;
    let begin = 1_700_000_000_123_456_789;
    let messages = [0, 20_000_000, 40_000_001, 3_040_000_001].map(|after| (0, begin + after, &image[..]));
    let channels = [["/i", "sensor_msgs/msg/Image", "cdr"]];
    std::fs::write(&path, written(mcap::WriteOptions::new(), &channels, &messages)).unwrap();
    let mut recording = Recording::open(&path).unwrap().at_rate(30.0);
    let mut times = || -> Vec<f64> {
        std::iter::from_fn(|| recording.next().unwrap()).map(|captured| captured.frame.time_s.unwrap()).collect()
    };
    assert_eq!(times(), [0.0, 0.02, 0.040000001, 3.040000001]);
}

/// Pictures outside chunks may be as large as any file; topic names are limited, and errors list some of them.
#[test]
fn records_topics_and_preallocated_space_have_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.mcap");
    let image = |width: u32, pixels: &[u8]| {
        Fields::new("cdr")
            .header()
            .u32(pixels.len() as u32 / width)
            .u32(width)
            .text("mono8")
            .u8(0)
            .u32(width)
            .data(pixels)
            .bytes
    };
    let head = channel(1, "/i", "sensor_msgs/msg/Image", "cdr");
    // A row stride of 70 MB is mostly padding.
    let mut long = Fields::new("cdr").header().u32(1).u32(2).text("mono8").u8(0).u32(70 << 20);
    let mut data = vec![0; 70 << 20];
    data[..2].fill(9);
    long = long.data(&data);
    std::fs::write(&path, file(&[head.clone(), message(1, 5, &long.bytes)])).unwrap();
    assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].2, [9.0, 9.0]);

    let small = message(1, 5, &image(2, &[4, 5]));
    // Preallocated space ends the records; anything after it is ignored.
    let whole = file(&[head.clone(), small.clone()]);
    let unfilled = [&whole[..whole.len() - 37], &[0; 900], &small].concat();
    std::fs::write(&path, unfilled).unwrap();
    let mut recording = Recording::open(&path).unwrap();
    assert_eq!((recording.len(), recording.next().unwrap().is_some()), (2, true));
    assert!(recording.next().unwrap_err().to_string().contains("it breaks off behind picture 1"));

    let topics: Vec<Vec<u8>> = (0..23u16)
        .flat_map(|n| {
            [channel(n, &format!("/t{n:02}"), "sensor_msgs/msg/Image", "cdr"), message(n, 5, &image(2, &[4, 5]))]
        })
        .collect();
    std::fs::write(&path, file(&topics)).unwrap();
    let message = refusal(&path);
    assert!(message.contains("/t18, /t19, and 3 more; name one") && !message.contains("/t20"), "{message}");
    std::fs::write(&path, file(&[channel(1, &"x".repeat(1025), "sensor_msgs/msg/Image", "cdr"), small])).unwrap();
    assert!(refusal(&path).contains("a topic's name of 1025 bytes; at most 1024"), "{}", refusal(&path));
}

#[test]
fn errors_name_the_file_and_the_fault() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.mcap");
    let ros = |encoding: &str, bytes: &[u8]| {
        Fields::new("cdr").header().u32(2).u32(2).text(encoding).u8(0).u32(2).data(bytes).bytes
    };
    let of = |payload: &[u8]| file(&[channel(1, "/i", "sensor_msgs/msg/Image", "cdr"), message(1, 5, payload)]);
    let good = [channel(1, "/i", "sensor_msgs/msg/Image", "cdr"), message(1, 5, &ros("mono8", &[1; 4]))].concat();
    let size = good.len() as u64;
    let head = good.len() - message(1, 5, &ros("mono8", &[1; 4])).len();
    // Cut inside its first chunk.
    let mut crashed = file(&[chunk("", size, 0, &good)]);
    crashed.truncate(25 + 80);
    let video = protobuf(&[(0x12, b"cam0"), (0x1a, &[0, 0, 0, 1, 0x67]), (0x22, b"h264")]);
    let video = |channel| message(channel, 5, &video);
    let webp = Fields::new("cdr").header().text("webp").data(b"RIFF....WEBP").bytes;
    let lying = |at: u64| {
        file(&[
            channel(1, "/i", "sensor_msgs/msg/Image", "cdr"),
            chunk("", size, 0, &good),
            message_index(1, &[(5, at)]),
        ])
    };
    for (bytes, words) in [
        (of(&ros("bayer_rgbw8", &[1; 4])), "bad.mcap: its pixels are bayer_rgbw8; mono8"),
        (of(&ros("mono8", &[1; 3])), "has 3 bytes in steps of 2; a row needs 2"),
        (of(b"\0\x01\0\0four"), "a message cannot be read: fields end early"),
        (of(b"\0\x03\0\0four"), "a message cannot be read"),
        (
            file(&[channel(1, "/i", "sensor_msgs/msg/CompressedImage", "cdr"), message(1, 5, &webp)]),
            "compressed as `webp`; png and jpeg",
        ),
        (
            file(&[channel(1, "/i", "foxglove.RawImage", "flatbuffer"), message(1, 5, b"..")]),
            "encoded as `flatbuffer`; protobuf, json",
        ),
        (file(&[channel(1, "/i", "foxglove.RawImage", "json"), message(1, 5, b"{\"width\":1}")]), "missing field"),
        (
            file(&[channel(1, "/i", "sensor_msgs/msg/Imu", "cdr"), message(1, 5, b"..")]),
            "there are no images in it (its messages are sensor_msgs/msg/Imu)",
        ),
        (file(&[channel(1, "/v", "foxglove.CompressedVideo", "protobuf"), video(1)]), "compressed as `h264`; png"),
        (
            crashed,
            "damaged: it breaks off: the record at byte 25 is not whole, and no image stands before it; mcap recover",
        ),
        (file(&[chunk("lzma", size, 0, &good)]), "compressed by neither lz4 nor zstd"),
        (file(&[chunk("", 1 << 40, 0, &good)]), "a chunk of 1099511627776 bytes; at most"),
        (file(&[chunk("", size + 1, 0, &good)]), "or more, not to"),
        (file(&[chunk("", size - 1, 0, &good)]), "or more, not to"),
        (file(&[chunk("", size, 77, &good)]), "the checksum of a chunk is wrong"),
        (file(&[chunk("zstd", size, 0, &good)]), "a chunk cannot be unpacked"),
        (file(&[chunk("lz4", size, 0, &good)]), "a chunk cannot be unpacked"),
        (lying(3), "message 0 is not where the file says"),
        (lying(u64::MAX), "message 0 is not where the file says"),
        (b"\x89MCAP1\r\n".to_vec(), "it is named .mcap but does not begin like one"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = refusal(&path);
        assert!(message.contains("bad.mcap") && message.contains(words), "{message}");
    }
    // Next to images, a video is ignored.
    let both = [good.clone(), channel(2, "/v", "foxglove.CompressedVideo", "protobuf"), video(2)].concat();
    std::fs::write(&path, file(&[both])).unwrap();
    assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].2, [1.0; 4]);
    std::fs::write(&path, lying(head as u64)).unwrap();
    assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].2, [1.0; 4]);
}

#[test]
fn hostile_files_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hostile.mcap");
    for (_, bytes) in REFERENCES {
        let [read, refused] = mutated(&path, bytes, 400);
        assert!(read > 50 && refused > 50, "{read} {refused}");
    }
    // Without checksums, so that corruption reaches the messages.
    for (schema, encoding, payload) in kinds() {
        let records = [channel(1, "/i", schema, encoding), message(1, 9, &payload), message(1, 5, &payload)];
        let second = (records[0].len() + records[1].len()) as u64;
        let index = message_index(1, &[(9, records[0].len() as u64), (5, second)]);
        let whole = records.concat();
        let [read, refused] = mutated(&path, &file(&[chunk("", whole.len() as u64, 0, &whole), index]), 80);
        assert!(read + refused == 80 && refused > 10, "{schema} {encoding}: {read} {refused}");
    }
}
