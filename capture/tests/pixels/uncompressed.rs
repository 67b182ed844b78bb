//! Every pixel of every uncompressed format except mosaic gaps, at odd sizes and with padded rows.

use isophote_capture::{Colour, Encoding};
use isophote_jit::PixelFormat;

use crate::packing::{Picture, packed, plain};
use crate::{Numbers, differences};

const SIZES: [[usize; 2]; 6] = [[2, 2], [3, 5], [16, 9], [33, 32], [127, 3], [641, 481]];
const COLOURS: [Colour; 3] = [Colour::Red, Colour::Green, Colour::Blue];

fn code(encoding: Encoding) -> String {
    String::from_utf8(encoding.fourcc().to_vec()).unwrap()
}

/// Bytes of a pixel of the first plane.
fn pixel_bytes(code: &str) -> usize {
    match (code, plain(code)) {
        (_, Some((bits, _))) => bits.div_ceil(8) as usize,
        ("YUYV" | "UYVY", _) => 2,
        ("RGB3" | "BGR3", _) => 3,
        _ => 1,
    }
}

fn uncompressed() -> impl Iterator<Item = Encoding> {
    Encoding::all().filter(|encoding| !encoding.is_compressed())
}

#[test]
fn every_packed_pixel_is_read_back() {
    let mut numbers = Numbers(1);
    for (encoding, size) in uncompressed().flat_map(|encoding| SIZES.map(|size| (encoding, size))) {
        let code = code(encoding);
        let bits = plain(&code).map_or(8, |(bits, _)| bits);
        for padding in [0, 1, 7, 64] {
            let picture = Picture::new(&mut numbers, size, bits);
            let stride = size[0] * pixel_bytes(&code) + padding;
            let bytes = packed(&picture, &code, stride, &mut numbers);
            let what = format!("{code} {size:?} stride {stride}");
            let filters = plain(&code).and_then(|(_, filters)| filters);
            if !encoding.is_bayer() {
                let frame = encoding.frame(&bytes, size, stride, Colour::All).unwrap();
                assert_eq!(frame.size(), size, "{what}");
                let planes: Vec<&[u16]> = match code.as_str() {
                    "RGB3" | "BGR3" => picture.rgb.iter().map(Vec::as_slice).collect(),
                    _ => vec![&picture.y],
                };
                assert_eq!(
                    (frame.planes().len(), encoding.planes(Colour::All)),
                    (planes.len(), planes.len()),
                    "{what}"
                );
                for (plane, pixels) in planes.iter().enumerate() {
                    assert_eq!(frame.planes()[plane].format, encoding.format(), "{what}");
                    assert_eq!(differences(&frame, plane, pixels), [], "{what} plane {plane}");
                }
            }
            for (channel, colour) in COLOURS.into_iter().enumerate().filter(|(_, colour)| encoding.has(*colour)) {
                let frame = encoding.frame(&bytes, size, stride, colour).unwrap();
                assert_eq!(frame.size(), encoding.size(size, colour), "{what}");
                assert_eq!((frame.planes().len(), encoding.planes(colour)), (1, 1), "{what}");
                let pixels = match filters {
                    None => picture.rgb[channel].clone(),
                    Some(rows) => of_mosaic(&picture, rows, channel),
                };
                assert_eq!(differences(&frame, 0, &pixels), [], "{what} {colour:?}");
            }
        }
    }
}

/// The pixels with one colour's filter; of green those in red's rows.
fn of_mosaic(picture: &Picture, rows: [&str; 2], channel: usize) -> Vec<u16> {
    let ([width, height], mosaic) = (picture.size, picture.mosaic(rows));
    let row = |y: usize| rows[y % 2].as_bytes();
    let has = |x: usize, y: usize| {
        let filter = row(y)[x % 2];
        filter == b"RGB"[channel] && (filter != b'G' || row(y).contains(&b'R'))
    };
    let whole = (0..height / 2 * 2).flat_map(|y| (0..width / 2 * 2).map(move |x| (x, y)));
    whole.filter(|(x, y)| has(*x, *y)).map(|(x, y)| mosaic[y * width + x]).collect()
}

/// The comparison detects a swapped byte order, a shifted pixel and a single bit.
#[test]
fn the_comparison_detects_faults() {
    let (mut numbers, size) = (Numbers(2), [16, 8]);
    let picture = Picture::new(&mut numbers, size, 8);
    let mut bytes = packed(&picture, "YUYV", 32, &mut numbers);
    let read = |code: &[u8; 4], bytes: &[u8]| {
        differences(&Encoding::of(*code).unwrap().frame(bytes, size, 32, Colour::All).unwrap(), 0, &picture.y).len()
    };
    assert_eq!(read(b"YUYV", &bytes), 0);
    assert!(read(b"UYVY", &bytes) > 100);
    assert!(read(b"GREY", &bytes) > 100);
    bytes[32 * 5 + 2 * 3] ^= 1;
    assert_eq!(read(b"YUYV", &bytes), 1);
}

#[test]
fn the_format_table_matches_the_definitions() {
    let all: Vec<Encoding> = Encoding::all().collect();
    assert_eq!(all.len(), 28);
    for encoding in &all {
        assert_eq!(Encoding::of(encoding.fourcc()), Some(*encoding));
        let bits = plain(&code(*encoding)).map_or(8, |(bits, _)| bits);
        assert_eq!(encoding.saturation(), f64::from(bits).exp2() - 1.0, "{encoding:?}");
        let wide = encoding.format() == PixelFormat::U16;
        assert!(wide == (bits > 8) && (wide || encoding.format() == PixelFormat::U8), "{encoding:?}");
        assert!(all.iter().filter(|other| other.fourcc() == encoding.fourcc()).count() == 1);
    }
    assert_eq!(Encoding::of(*b"H264"), None);
    assert_eq!(Encoding::of(*b"Y10 ").unwrap().name(), "Y10");
    // Grey counts first, deeper ones before; then formats that need conversion to luma; JPEG last.
    let place = |code: &[u8; 4]| all.iter().position(|one| one.fourcc() == *code).unwrap();
    for [better, worse] in [
        [b"Y16 ", b"GREY"],
        [b"GREY", b"YUYV"],
        [b"YU12", b"RGB3"],
        [b"BGR3", b"RG16"],
        [b"RG10", b"RGGB"],
        [b"BA81", b"MJPG"],
    ] {
        assert!(place(better) < place(worse), "{better:?} {worse:?}");
    }
}

/// All planes share one buffer, no longer than the picture.
#[test]
fn copies_are_no_larger_than_the_picture() {
    let bytes = vec![9; 100_000];
    for (code, planes, copied) in
        [(b"YUYV", 1, 64 * 47 + 40), (b"NV12", 1, 64 * 47 + 20), (b"GREY", 1, 64 * 47 + 20), (b"RGB3", 3, 64 * 47 + 60)]
    {
        let frame = Encoding::of(*code).unwrap().frame(&bytes, [20, 48], 64, Colour::All).unwrap();
        assert_eq!(frame.planes().len(), planes);
        let first = frame.planes()[0].buffer.bytes();
        assert_eq!(first.len(), copied);
        assert!(frame.planes().iter().all(|plane| std::ptr::eq(plane.buffer.bytes(), first)));
    }
}
