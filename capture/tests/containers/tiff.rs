//! TIFF: pixel formats in both byte orders; which directories are pictures; stacks with one directory.

use isophote_capture::{FrameSource, Recording};
use isophote_jit::PixelFormat;

use crate::{frames, refusal};

const SHORT: u16 = 3;
const LONG: u16 = 4;

/// Tags that override those of a gray 8-bit picture of 3 × 2 pixels.
type Tags<'a> = &'a [(u16, &'a [u32])];

#[derive(Clone, Copy, PartialEq)]
enum Order {
    Little,
    Big,
}

impl Order {
    fn number(self, value: u32, bytes: usize) -> Vec<u8> {
        match self {
            Order::Little => value.to_le_bytes()[..bytes].to_vec(),
            Order::Big => value.to_be_bytes()[4 - bytes..].to_vec(),
        }
    }
}

/// A directory followed by its description and pixels, as ImageJ and tifffile write them; `next`: whether another follows.
fn directory(order: Order, start: usize, tags: Tags, text: &str, pixels: &[u8], next: bool) -> Vec<u8> {
    let mut all: Vec<(u16, Vec<u32>)> = [(256, 3), (257, 2), (258, 8), (259, 1), (262, 1), (277, 1), (278, 2)]
        .map(|(tag, value)| (tag, vec![value]))
        .to_vec();
    for (tag, values) in tags {
        all.retain(|(known, _)| known != tag);
        all.push((*tag, values.to_vec()));
    }
    let has_text = !text.is_empty();
    let entries = all.len() + 2 + usize::from(has_text);
    let heap = start + 2 + 12 * entries + 4;
    let numbers: usize = all.iter().filter(|(_, values)| values.len() > 2).map(|(_, values)| 2 * values.len()).sum();
    let text_at = heap + numbers;
    let pixels_at = (text_at + text.len() + 1).next_multiple_of(2);
    all.extend([(273, vec![pixels_at as u32]), (279, vec![pixels.len() as u32])]);
    if has_text {
        all.push((270, vec![text_at as u32]));
    }
    all.sort();
    let (mut bytes, mut values_behind) = (order.number(entries as u32, 2), Vec::new());
    for (tag, values) in &all {
        let kind = if [273, 279].contains(tag) { LONG } else { SHORT };
        bytes.extend(order.number(u32::from(*tag), 2));
        if *tag == 270 {
            bytes.extend(
                [order.number(2, 2), order.number(text.len() as u32 + 1, 4), order.number(values[0], 4)].concat(),
            );
            continue;
        }
        bytes.extend([order.number(u32::from(kind), 2), order.number(values.len() as u32, 4)].concat());
        let mut value: Vec<u8> =
            values.iter().flat_map(|v| order.number(*v, if kind == SHORT { 2 } else { 4 })).collect();
        if value.len() > 4 {
            bytes.extend(order.number((heap + values_behind.len()) as u32, 4));
            values_behind.extend(value);
            continue;
        }
        value.resize(4, 0);
        bytes.extend(value);
    }
    let end = (pixels_at + pixels.len()).next_multiple_of(2);
    bytes.extend(order.number(if next { end as u32 } else { 0 }, 4));
    bytes.extend(values_behind);
    bytes.extend([text.as_bytes(), &[0]].concat());
    bytes.resize(pixels_at - start, 0);
    bytes.extend(pixels);
    bytes.resize(end - start, 0);
    bytes
}

fn tiff(order: Order, pages: &[(Tags, &[u8])], text: &str) -> Vec<u8> {
    let mut bytes = [if order == Order::Little { b"II" } else { b"MM" }, &order.number(42, 2)[..]].concat();
    bytes.extend(order.number(8, 4));
    for (number, (tags, pixels)) in pages.iter().enumerate() {
        let page = directory(order, bytes.len(), tags, text, pixels, number + 1 < pages.len());
        bytes.extend(page);
    }
    bytes
}

/// Six numbers as stored.
fn stored(order: Order, bits: u32, format: u32, values: [f64; 6]) -> Vec<u8> {
    let half = |value: f64| (f64::from(value as f32).to_bits() >> 42 & 0x3ff) as u32;
    let one = |value: f64| match (format, bits) {
        (1, _) => order.number(value as u32, bits as usize / 8),
        (2, _) => match order {
            Order::Little => (value as i32).to_le_bytes()[..bits as usize / 8].to_vec(),
            Order::Big => (value as i32).to_be_bytes()[4 - bits as usize / 8..].to_vec(),
        },
        // 1 ≤ |value| < 2.
        (_, 16) => order.number(if value < 0.0 { 0xbc00 } else { 0x3c00 } | half(value.abs()), 2),
        (_, 32) => order.number((value as f32).to_bits(), 4),
        _ if order == Order::Little => value.to_le_bytes().to_vec(),
        _ => value.to_be_bytes().to_vec(),
    };
    values.into_iter().flat_map(one).collect()
}

#[test]
fn stored_values_are_kept_at_every_depth_and_photometric() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.tif");
    let cases = [
        (8, 1, [0.0, 1.0, 40.0, 127.0, 128.0, 255.0], PixelFormat::U8),
        (16, 1, [0.0, 1.0, 4095.0, 32768.0, 65534.0, 65535.0], PixelFormat::U16),
        (32, 1, [0.0, 1.0, 16_777_217.0, 2_147_483_647.0, 2_147_483_648.0, 4_294_967_295.0], PixelFormat::F64),
        (8, 2, [-128.0, -1.0, 0.0, 1.0, 40.0, 127.0], PixelFormat::F32),
        (16, 2, [-32768.0, -1.0, 0.0, 1.0, 4095.0, 32767.0], PixelFormat::F32),
        (32, 2, [-2_147_483_648.0, -16_777_217.0, -1.0, 0.0, 1.0, 2_147_483_647.0], PixelFormat::F64),
        (16, 3, [1.0, 1.25, 1.5, 1.9990234375, -1.0, -1.75], PixelFormat::F32),
        (32, 3, [40.0, 0.1f32.into(), -3.5, 180.0, 1e-30f32.into(), 3e38f32.into()], PixelFormat::F32),
        (64, 3, [40.0, 0.1, -3.5, 180.0, 1e-300, 1e300], PixelFormat::F64),
    ];
    for (bits, format, values, expected) in cases {
        for (order, photometric) in [(Order::Little, 0), (Order::Little, 1), (Order::Big, 0), (Order::Big, 1)] {
            let tags: Tags = &[(258, &[bits]), (262, &[photometric]), (339, &[format])];
            let pixels = stored(order, bits, format, values);
            std::fs::write(&path, tiff(order, &[(tags, &pixels)], "")).unwrap();
            let mut recording = Recording::open(&path).unwrap();
            let frame = recording.next().unwrap().unwrap().frame;
            assert_eq!(frame.planes()[0].format, expected, "{bits} {format}");
            let plane = frame.plane_view(0);
            let found: Vec<f64> = (0..6).map(|i| plane.pixel(i % 3, i / 3)).collect();
            assert_eq!(found, values, "{bits} bits, format {format}, photometric {photometric}");
        }
    }
}

#[test]
fn reversed_bit_order_is_corrected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reversed.tif");
    let reversed = |bytes: &[u8]| bytes.iter().map(|byte| byte.reverse_bits()).collect::<Vec<u8>>();
    let bytes: [u8; 6] = [40, 1, 2, 128, 219, 255];
    std::fs::write(&path, tiff(Order::Little, &[(&[(266, &[2])], &reversed(&bytes))], "")).unwrap();
    assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].2, bytes.map(f64::from));
    let words = [40.0, 1.0, 256.0, 4095.0, 43981.0, 65535.0];
    for order in [Order::Little, Order::Big] {
        let pixels = reversed(&stored(order, 16, 1, words));
        // White is 0 as well, and the second picture has the usual bit order.
        let pages: [(Tags, &[u8]); 2] =
            [(&[(258, &[16]), (266, &[2]), (262, &[0])], &pixels), (&[(258, &[16])], &stored(order, 16, 1, words))];
        std::fs::write(&path, tiff(order, &pages, "")).unwrap();
        let found = frames(&mut Recording::open(&path).unwrap());
        assert_eq!([&found[0].2[..], &found[1].2[..]], [words, words]);
    }
}

#[test]
fn reduced_copies_and_masks_are_not_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("copies.tif");
    let main: (Tags, &[u8]) = (&[], &[1, 2, 3, 4, 5, 6]);
    let part: (Tags, &[u8]) = (&[(254, &[2])], &[7; 6]);
    let copy: (Tags, &[u8]) = (&[(254, &[1]), (256, &[1]), (257, &[1])], &[9]);
    let old_copy: (Tags, &[u8]) = (&[(255, &[2]), (256, &[1]), (257, &[1])], &[9]);
    let mask: (Tags, &[u8]) = (&[(254, &[4]), (258, &[1]), (262, &[4])], &[0, 0]);
    for (pages, expected) in [
        (vec![copy, main], vec!["copies.tif"]),
        (vec![main, copy], vec!["copies.tif"]),
        (vec![main, old_copy, mask, part, copy], vec!["copies.tif#0", "copies.tif#1"]),
    ] {
        std::fs::write(&path, tiff(Order::Big, &pages, "")).unwrap();
        let found = frames(&mut Recording::open(&path).unwrap());
        assert_eq!(found.iter().map(|(name, ..)| name.as_str()).collect::<Vec<_>>(), expected);
        assert_eq!(found[0].2, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }
    std::fs::write(&path, tiff(Order::Little, &[copy, mask], "")).unwrap();
    assert!(refusal(&path).contains("all its pages are smaller copies or masks"), "{}", refusal(&path));
}

#[test]
fn stacks_of_one_directory_yield_all_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stack.tif");
    let numbers = |frame: usize| [0, 1, 2, 3, 4, 5].map(|i| (10 * frame + i) as f64);
    for (bits, format) in [(8, 1), (16, 1), (32, 3), (16, 2)] {
        for order in [Order::Little, Order::Big] {
            let frames_of = |count: usize| -> Vec<u8> {
                (0..count).flat_map(|frame| stored(order, bits, format, numbers(frame))).collect()
            };
            let tags: Tags = &[(258, &[bits]), (339, &[format]), (262, &[0])];
            for text in [
                "ImageJ=1.54f\nimages=5\nslices=5\nunit=\u{b5}m\nloop=false\n",
                "{\"shape\": [5, 2, 3], \"truncated\": true}",
            ] {
                let whole = tiff(order, &[(tags, &frames_of(5))], text);
                std::fs::write(&path, &whole).unwrap();
                let found = frames(&mut Recording::open(&path).unwrap());
                assert_eq!(found.len(), 5);
                for (frame, (name, size, pixels)) in found.iter().enumerate() {
                    assert_eq!(
                        (name, &size[..], &pixels[..]),
                        (&format!("stack.tif#{frame}"), &[3, 2][..], &numbers(frame)[..])
                    );
                }
                assert_eq!(Recording::of_dimensions(&path, 3).unwrap().size(), Some(vec![3, 2, 5]));
                // Three of five are present: they are read, and the fourth is an error.
                std::fs::write(&path, tiff(order, &[(tags, &frames_of(3))], text)).unwrap();
                let mut short = Recording::open(&path).unwrap();
                for frame in 0..3 {
                    assert_eq!(short.next().unwrap().unwrap().frame.plane_view(0).pixel(0, 0), (10 * frame) as f64);
                }
                let message = short.next().unwrap_err().to_string();
                assert!(message.contains("5 pictures behind one directory, but picture 3 is cut off"), "{message}");
            }
        }
    }
    // BitsPerSample of three colours is outside the directory entry.
    let colours: Tags = &[(262, &[2]), (277, &[3]), (258, &[8, 8, 8])];
    let pixels: Vec<u8> = (0..36).collect();
    std::fs::write(&path, tiff(Order::Big, &[(colours, &pixels)], "ImageJ=1.54f\nimages=2\n")).unwrap();
    let mut recording = Recording::open(&path).unwrap();
    for frame in 0..2 {
        let found = recording.next().unwrap().unwrap().frame;
        assert_eq!([0, 1, 2].map(|c| found.plane_view(c).pixel(2, 1)), [15, 16, 17].map(|n| f64::from(18 * frame + n)));
    }
    let packed: Tags = &[(259, &[8])];
    std::fs::write(&path, tiff(Order::Little, &[(packed, &[0; 30])], "ImageJ=1.54f\nimages=5\n")).unwrap();
    let message = refusal(&path);
    assert!(
        message.contains("says that there are 5 pictures, but it has one directory") && message.contains("compressed"),
        "{message}"
    );
}

#[test]
fn descriptions_do_not_add_pictures_to_complete_directories() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stack.tif");
    let page = |value: u8| [value; 6];
    for text in ["ImageJ=1.54f\nimages=2\n", "ImageJ=1.54f\nimages=1\n", "{\"shape\": [2, 2, 3]}", "a laser, images=7"]
    {
        std::fs::write(&path, tiff(Order::Little, &[(&[], &page(1)), (&[], &page(2))], text)).unwrap();
        assert_eq!(Recording::open(&path).unwrap().len(), 2, "{text}");
    }
    for text in ["ImageJ=1.54f\nmin=0\n", "{\"shape\": [2, 3]}", "{\"shape\": [7]}", "{}", "images=7"] {
        std::fs::write(&path, tiff(Order::Little, &[(&[], &page(1))], text)).unwrap();
        assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].0, "stack.tif", "{text}");
    }
}

#[test]
fn planar_colours_and_gray_with_alpha_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("colours.tif");
    let planes: Vec<u8> = (0..18).collect();
    // One strip per plane, in the order of the planes.
    let mut whole = tiff(Order::Little, &[(&[(262, &[2]), (277, &[3]), (258, &[8, 8, 8]), (284, &[2])], &planes)], "");
    let entry = |bytes: &[u8], tag: u16| {
        bytes.windows(4).position(|four| four == [tag.to_le_bytes(), LONG.to_le_bytes()].concat())
    };
    let start = u32::from_le_bytes(*whole[entry(&whole, 273).unwrap() + 8..].first_chunk().unwrap());
    for (tag, values) in [(273, [start, start + 6, start + 12]), (279, [6; 3])] {
        let (at, heap) = (entry(&whole, tag).unwrap(), whole.len() as u32);
        whole[at + 4..at + 12].copy_from_slice(&[3u32.to_le_bytes(), heap.to_le_bytes()].concat());
        whole.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    std::fs::write(&path, &whole).unwrap();
    let frame = Recording::open(&path).unwrap().next().unwrap().unwrap().frame;
    let found: Vec<f64> = (0..3)
        .flat_map(|c| (0..6).map(move |i| (c, i)))
        .map(|(c, i)| frame.plane_view(c).pixel(i % 3, i / 3))
        .collect();
    assert_eq!(found, planes.iter().map(|byte| f64::from(*byte)).collect::<Vec<_>>());

    // Separate planes in tiles are rejected.
    let tiles: Tags = &[(262, &[2]), (277, &[3]), (258, &[8, 8, 8]), (284, &[2]), (322, &[16]), (323, &[16])];
    let mut whole = tiff(Order::Little, &[(tiles, &[0; 768])], "");
    for (strips, tiles, values) in [(273u16, 324u16, [8, 264, 520]), (279, 325, [256; 3])] {
        let (at, heap) = (entry(&whole, strips).unwrap(), whole.len() as u32);
        whole[at..at + 2].copy_from_slice(&tiles.to_le_bytes());
        whole[at + 4..at + 12].copy_from_slice(&[3u32.to_le_bytes(), heap.to_le_bytes()].concat());
        whole.extend(values.iter().flat_map(|value: &u32| value.to_le_bytes()));
    }
    std::fs::write(&path, &whole).unwrap();
    assert!(refusal(&path).contains("plane by plane, in tiles; save it in strips"), "{}", refusal(&path));

    let with_alpha: Vec<u8> = (1..=6).flat_map(|value| [value, 200]).collect();
    for photometric in [0, 1] {
        let tags: Tags = &[(277, &[2]), (258, &[8, 8]), (338, &[2]), (262, &[photometric])];
        std::fs::write(&path, tiff(Order::Big, &[(tags, &with_alpha)], "")).unwrap();
        let found = frames(&mut Recording::open(&path).unwrap());
        assert_eq!(found[0].2, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }
}

#[test]
fn unsupported_kinds_are_rejected_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.tif");
    let cases: [(Tags, &str); 12] = [
        (&[(258, &[12])], "its pixels have 12 bits, packed; save it with 16 bits"),
        (&[(258, &[10])], "its pixels have 10 bits, packed; save it with 16 bits"),
        (&[(258, &[4])], "its pixels have 4 bits, packed; save it with 8 bits"),
        (&[(258, &[64])], "its pixels are 64-bit integers"),
        (&[(258, &[24]), (339, &[3])], "its pixels are 24-bit float; save it as 32-bit float"),
        (&[(258, &[64]), (339, &[6])], "its pixels are complex numbers"),
        (&[(262, &[3])], "its colours are those of a palette; save it as gray or as r, g, b"),
        (&[(262, &[5]), (277, &[4])], "its colours are CMYK; save it as gray"),
        (&[(277, &[2])], "its pixels have 2 samples, and it does not say which of them are colours"),
        (&[(259, &[7])], "it is compressed with JPEG (7); save it uncompressed, or with LZW, Deflate or PackBits"),
        (&[(259, &[50000])], "it is compressed with Zstandard (50000)"),
        (&[(259, &[4]), (258, &[1])], "it is compressed with CCITT fax (4)"),
    ];
    for (tags, words) in cases {
        std::fs::write(&path, tiff(Order::Little, &[(tags, &[0; 96])], "")).unwrap();
        let message = refusal(&path);
        assert!(message.contains("other.tif") && message.contains(words), "{message}");
    }
}
