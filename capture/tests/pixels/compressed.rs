//! Camera JPEG: stored luma for every chroma subsampling; missing Huffman tables; truncation.

use image::codecs::jpeg::JpegEncoder;
use isophote_capture::{Colour, Encoding, PixelsError};
use isophote_tracker::Frame;

use crate::blocks::{Component, jpeg};
use crate::{Numbers, differences};

fn read(bytes: &[u8], size: [usize; 2], colour: Colour) -> Result<Frame, PixelsError> {
    Encoding::of(*b"MJPG").unwrap().frame(bytes, size, 0, colour)
}

fn luma(column: usize, row: usize) -> u8 {
    (column * 37 + row * 91 + 5) as u8
}

/// A smooth colour picture as r, g, b bytes.
fn picture([width, height]: [usize; 2]) -> Vec<u8> {
    let each = (0..height).flat_map(|y| (0..width).map(move |x| (x as f64, y as f64)));
    each.flat_map(|(x, y)| {
        let spot = 150.0 * (-((x - 20.0).powi(2) + (y - 15.0).powi(2)) / 60.0).exp();
        [40.0 + spot, 60.0 + 0.5 * spot + x, 50.0 + y].map(|value| value as u8)
    })
    .collect()
}

fn encoded(size: [usize; 2]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
    encoder.encode(&picture(size), size[0] as u32, size[1] as u32, image::ExtendedColorType::Rgb8).unwrap();
    bytes
}

/// Removes the segments of one kind before the scan.
fn without(bytes: &[u8], marker: u8) -> Vec<u8> {
    let (mut kept, mut at) = (bytes[..2].to_vec(), 2);
    while bytes[at + 1] != 0xda {
        let end = at + 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
        if bytes[at + 1] != marker {
            kept.extend(&bytes[at..end]);
        }
        at = end;
    }
    [&kept, &bytes[at..]].concat()
}

#[test]
fn stored_luma_is_read_for_every_subsampling() {
    for sampling in [[1, 1], [2, 1], [1, 2], [2, 2], [4, 1]] {
        for (size, interval) in [[8, 8], [16, 16], [41, 35], [64, 48], [641, 481]].into_iter().zip([0, 0, 3, 1, 7]) {
            let chroma = |value| Component { sampling: [1, 1], value };
            let components = [
                Component { sampling, value: luma },
                chroma(|x, y| (x * 50 + y) as u8),
                chroma(|x, y| (x + y * 70) as u8),
            ];
            let bytes = jpeg(size, &components, &[1, 2, 3], interval);
            let frame = read(&bytes, size, Colour::All).unwrap();
            assert_eq!((frame.size(), frame.planes().len()), (&size[..], 1));
            let pixels: Vec<u16> =
                (0..size[0] * size[1]).map(|i| u16::from(luma(i % size[0] / 8, i / size[0] / 8))).collect();
            assert_eq!(differences(&frame, 0, &pixels).len(), 0, "{sampling:?} {size:?}");
            // The comparison detects a wrong expectation.
            assert_eq!(
                differences(&frame, 0, &pixels.iter().map(|pixel| pixel ^ 1).collect::<Vec<_>>()).len(),
                pixels.len()
            );
        }
    }
}

#[test]
fn grey_and_rgb_pictures_are_read() {
    let size = [20, 20];
    let block = |i: usize| u16::from(luma(i % 20 / 8, i / 20 / 8));
    let stored: Vec<u16> = (0..400).map(block).collect();
    let component = || Component { sampling: [1, 1], value: luma };
    let grey = jpeg(size, &[component()], &[1], 0);
    for colour in [Colour::All, Colour::Red, Colour::Green, Colour::Blue] {
        let frame = read(&grey, size, colour).unwrap();
        assert_eq!((frame.planes().len(), differences(&frame, 0, &stored).len()), (1, 0), "{colour:?}");
    }
    // Components named R, G and B: luma must be computed from them.
    let blue = Component { sampling: [1, 1], value: |_, _| 200 };
    let colours = jpeg(size, &[component(), Component { sampling: [1, 1], value: |_, _| 100 }, blue], b"RGB", 0);
    assert_eq!(differences(&read(&colours, size, Colour::Red).unwrap(), 0, &stored), []);
    assert_eq!(differences(&read(&colours, size, Colour::Blue).unwrap(), 0, &[200; 400]), []);
    let mixed = read(&colours, size, Colour::All).unwrap();
    for (i, red) in stored.iter().enumerate() {
        let apart = mixed.plane_view(0).pixel(i % 20, i / 20) - (0.299 * f64::from(*red) + 58.7 + 22.8);
        assert!(apart.abs() < 1e-4, "{apart}: luma is not rounded");
    }
}

/// A camera picture's luma equals that of its colours within rounding, and each colour equals that of `decode`.
#[test]
fn luma_and_colours_agree_with_the_file_decoder() {
    let size = [50, 37];
    let bytes = encoded(size);
    let rgb = isophote_capture::decode(&bytes).unwrap();
    let made = rgb.luma();
    let direct = read(&bytes, size, Colour::All).unwrap();
    for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
        let apart = (direct.plane_view(0).pixel(x, y) - made.plane_view(0).pixel(x, y)).abs();
        assert!(apart <= 2.0, "{apart} at {x}, {y}");
    }
    for (channel, colour) in [Colour::Red, Colour::Green, Colour::Blue].into_iter().enumerate() {
        let one = read(&bytes, size, colour).unwrap();
        let all = rgb.plane_view(channel);
        let pixels: Vec<u16> = (0..size[0] * size[1]).map(|i| all.pixel(i % size[0], i / size[0]) as u16).collect();
        assert_eq!(differences(&one, 0, &pixels), []);
    }
}

/// As webcams send it: without Huffman tables, and with padding after the end.
#[test]
fn missing_huffman_tables_are_the_standard_ones() {
    let size = [50, 37];
    let whole = encoded(size);
    let mut bare = without(&whole, 0xc4);
    assert!(bare.len() < whole.len() - 400);
    bare.extend([0; 33]);
    let [with, bare] = [&whole, &bare].map(|bytes| read(bytes, size, Colour::All).unwrap());
    assert_eq!(with.planes()[0].buffer.bytes(), bare.planes()[0].buffer.bytes());
    // Without quantization tables decoding fails.
    assert!(matches!(read(&without(&whole, 0xdb), size, Colour::All), Err(PixelsError::Damaged(_))));
}

/// Stray bytes before each marker of the headers, of a restart and of the end, as webcams leave them.
#[test]
fn bytes_between_markers_are_skipped() {
    let size = [50, 37];
    let chroma = || Component { sampling: [1, 1], value: luma };
    let restarts = jpeg(size, &[Component { sampling: [2, 1], value: luma }, chroma(), chroma()], &[1, 2, 3], 3);
    for whole in [encoded(size), without(&encoded(size), 0xc4), restarts] {
        let sound = read(&whole, size, Colour::All).unwrap();
        let (mut places, mut at) = (Vec::new(), 2);
        while whole[at + 1] != 0xda {
            places.push(at);
            at += 2 + usize::from(u16::from_be_bytes([whole[at + 2], whole[at + 3]]));
        }
        places.push(at);
        let is_marker = |at: &usize| whole[*at] == 0xff && matches!(whole[at + 1], 0xd0..=0xd7 | 0xd9);
        places.extend((at..whole.len() - 1).filter(is_marker));
        for (number, place) in places.iter().enumerate() {
            for extra in [&[0][..], &[0; 40], &[0x12, 0x34, 0x00], &[0xff], &[0xff, 0, 7]] {
                let bytes = [&whole[..*place], extra, &whole[*place..]].concat();
                let found = read(&bytes, size, Colour::All);
                let found = found.unwrap_or_else(|error| panic!("{extra:?} before marker {number}: {error}"));
                assert_eq!(found.planes()[0].buffer.bytes(), sound.planes()[0].buffer.bytes(), "{number} {extra:?}");
                // As files and pushed frames.
                let file =
                    isophote_capture::decode(&bytes).unwrap_or_else(|error| panic!("{extra:?} {number}: {error}"));
                let expected = isophote_capture::decode(&whole).unwrap();
                assert_eq!(file.planes()[0].buffer.bytes(), expected.planes()[0].buffer.bytes());
            }
        }
    }
}

/// A truncated picture, with or without an end marker, is rejected: no pixel is made up.
#[test]
fn truncated_pictures_are_rejected() {
    let size = [50, 37];
    let chroma = || Component { sampling: [1, 1], value: luma };
    let blocks =
        |interval| jpeg(size, &[Component { sampling: [2, 1], value: luma }, chroma(), chroma()], &[1, 2, 3], interval);
    for whole in [encoded(size), without(&encoded(size), 0xc4), blocks(0), blocks(1), blocks(5)] {
        let sound = read(&whole, size, Colour::All).unwrap();
        for end in 0..whole.len() - 2 {
            assert!(matches!(read(&whole[..end], size, Colour::All), Err(PixelsError::Damaged(_))), "{end}");
            let ended = [&whole[..end], &[0xff, 0xd9]].concat();
            // The last byte may hold only padding.
            if let Ok(frame) = read(&ended, size, Colour::All) {
                let same = frame.planes()[0].buffer.bytes() == sound.planes()[0].buffer.bytes();
                assert!(same && end + 3 >= whole.len(), "{end} of {}", whole.len());
            }
        }
    }
}

#[test]
fn a_different_size_is_rejected() {
    let bytes = encoded([50, 37]);
    for size in [[37, 50], [50, 36], [51, 37]] {
        let error = read(&bytes, size, Colour::All).unwrap_err();
        assert!(matches!(error, PixelsError::OtherSize { got: [50, 37], expected } if expected == size), "{error}");
    }
}

/// Damaged bytes yield an error or a picture, never a panic.
#[test]
fn damaged_bytes_never_panic() {
    let size = [50, 37];
    let whole = encoded(size);
    let sampled = {
        let chroma = || Component { sampling: [1, 1], value: luma };
        jpeg(size, &[Component { sampling: [2, 2], value: luma }, chroma(), chroma()], &[1, 2, 3], 4)
    };
    let mut numbers = Numbers(6);
    let mut pictures = 0;
    for round in 0..6000 {
        let mut bytes = [&whole, &sampled][round % 2].clone();
        for _ in 0..=numbers.to(3) {
            // Mostly in the headers.
            let reach = [bytes.len() as u64 - 1, 700.min(bytes.len() as u64 - 1)][numbers.to(1) as usize];
            bytes[numbers.to(reach) as usize] = numbers.to(255) as u8;
        }
        let colour = [Colour::All, Colour::Green][numbers.to(1) as usize];
        pictures += usize::from(read(&bytes, size, colour).is_ok());
    }
    assert!(pictures > 0);
}
