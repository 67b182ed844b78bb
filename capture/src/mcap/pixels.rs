//! Raw pixels as a message has them in, a picture out.

use isophote_jit::PixelFormat;

use crate::decode::{DecodeError, Picture, check_size};

use super::message::Raw;

/// How the bytes of a pixel become channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// As they are stored.
    Stored,
    /// Blue first.
    Reversed,
    /// Luma and chroma in turn, luma first or second; luma is taken.
    Luma(usize),
}

/// The names of formats, the channels of a pixel (stored, used), their format and order.
const ENCODINGS: [(&str, usize, usize, PixelFormat, Order); 17] = [
    ("mono8", 1, 1, PixelFormat::U8, Order::Stored),
    ("8UC1", 1, 1, PixelFormat::U8, Order::Stored),
    ("mono16", 1, 1, PixelFormat::U16, Order::Stored),
    ("16UC1", 1, 1, PixelFormat::U16, Order::Stored),
    ("32FC1", 1, 1, PixelFormat::F32, Order::Stored),
    ("rgb8", 3, 3, PixelFormat::U8, Order::Stored),
    ("bgr8", 3, 3, PixelFormat::U8, Order::Reversed),
    ("rgba8", 4, 3, PixelFormat::U8, Order::Stored),
    ("bgra8", 4, 3, PixelFormat::U8, Order::Reversed),
    ("rgb16", 3, 3, PixelFormat::U16, Order::Stored),
    ("bgr16", 3, 3, PixelFormat::U16, Order::Reversed),
    ("rgba16", 4, 3, PixelFormat::U16, Order::Stored),
    ("bgra16", 4, 3, PixelFormat::U16, Order::Reversed),
    ("yuyv", 2, 1, PixelFormat::U8, Order::Luma(0)),
    ("yuv422_yuy2", 2, 1, PixelFormat::U8, Order::Luma(0)),
    ("uyvy", 2, 1, PixelFormat::U8, Order::Luma(1)),
    ("yuv422", 2, 1, PixelFormat::U8, Order::Luma(1)),
];

/// Width and height, which are those of a frame.
pub(super) fn size(raw: &Raw) -> Result<[usize; 2], DecodeError> {
    check_size(raw.width, raw.height)?;
    Ok([raw.width as usize, raw.height as usize])
}

/// Packs rows, puts channels in order and bytes into the machine's.
pub(super) fn picture(raw: &Raw) -> Result<Picture, DecodeError> {
    let [width, height] = size(raw)?;
    let known = ENCODINGS.iter().find(|(name, ..)| *name == raw.encoding);
    let (_, stored, used, format, order) = known.copied().ok_or_else(|| unknown(&raw.encoding))?;
    let (row, step) = (width * stored * format.bytes_per_pixel(), raw.step as usize);
    let least = height.checked_sub(1).map_or(0, |above| step * above + row);
    if row == 0 || step < row || raw.bytes.len() < least {
        return Err(DecodeError::Damaged(format!(
            "an image of {width}×{height} px of {} has {} bytes in steps of {step}; a row needs {row}",
            raw.encoding,
            raw.bytes.len()
        )));
    }
    let mut bytes = Vec::with_capacity(row * height);
    for line in raw.bytes.chunks(step).take(height) {
        match order {
            Order::Luma(first) => bytes.extend(line[..row].iter().skip(first).step_by(2)),
            _ => bytes.extend_from_slice(&line[..row]),
        }
    }
    let number = format.bytes_per_pixel();
    if order == Order::Reversed {
        for pixel in bytes.chunks_exact_mut(stored * number) {
            (0..number).for_each(|i| pixel.swap(i, 2 * number + i));
        }
    }
    if raw.is_big_endian != cfg!(target_endian = "big") {
        bytes.chunks_exact_mut(number).for_each(<[u8]>::reverse);
    }
    let stored = if matches!(order, Order::Luma(_)) { 1 } else { stored };
    Ok(Picture { size: [width, height], format, stored, used, bytes })
}

fn unknown(encoding: &str) -> DecodeError {
    let shown: String = encoding.chars().filter(|c| !c.is_control()).take(40).collect();
    DecodeError::Unsupported(match encoding.starts_with("bayer_") {
        true => format!(
            "its pixels are {shown}, a mosaic in which each shows one colour; record the debayered image (image_proc), or mono8"
        ),
        false => format!(
            "its pixels are {shown}; mono8, mono16, 8UC1, 16UC1, 32FC1, rgb, bgr, rgba and bgra of 8 and 16 bits, yuyv and uyvy \
             are read"
        ),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::borrow::Cow;

    use super::*;

    fn raw<'a>(encoding: &'a str, width: u32, step: u32, bytes: &'a [u8]) -> Raw<'a> {
        Raw {
            width,
            height: 2,
            encoding: Cow::Borrowed(encoding),
            step,
            is_big_endian: false,
            bytes: Cow::Borrowed(bytes),
        }
    }

    /// Rows of two pixels with a gap between them.
    #[test]
    fn each_encoding_is_put_in_order() {
        let bytes: Vec<u8> = (0..40).collect();
        for (encoding, stored, used, expected) in [
            ("mono8", 1, 1, &[0, 1, 20, 21][..]),
            ("8UC1", 1, 1, &[0, 1, 20, 21]),
            ("mono16", 1, 1, &[0, 1, 2, 3, 20, 21, 22, 23]),
            ("32FC1", 1, 1, &[0, 1, 2, 3, 4, 5, 6, 7, 20, 21, 22, 23, 24, 25, 26, 27]),
            ("rgb8", 3, 3, &[0, 1, 2, 3, 4, 5, 20, 21, 22, 23, 24, 25]),
            ("bgr8", 3, 3, &[2, 1, 0, 5, 4, 3, 22, 21, 20, 25, 24, 23]),
            ("bgra8", 4, 3, &[2, 1, 0, 3, 6, 5, 4, 7, 22, 21, 20, 23, 26, 25, 24, 27]),
            ("bgr16", 3, 3, &[4, 5, 2, 3, 0, 1, 10, 11, 8, 9, 6, 7, 24, 25, 22, 23, 20, 21, 30, 31, 28, 29, 26, 27]),
            ("yuv422_yuy2", 1, 1, &[0, 2, 20, 22]),
            ("uyvy", 1, 1, &[1, 3, 21, 23]),
        ] {
            let picture = picture(&raw(encoding, 2, 20, &bytes)).unwrap();
            assert_eq!((picture.stored, picture.used, &picture.bytes[..]), (stored, used, expected), "{encoding}");
        }
        let picture = picture(&Raw { is_big_endian: true, ..raw("16UC1", 1, 2, &[1, 2, 3, 4]) }).unwrap();
        assert_eq!(picture.bytes, [[2, 1], [4, 3]].concat());
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for (raw, words) in [
            (raw("mono8", 2, 0, &[0; 40]), "in steps of 0; a row needs 2"),
            (raw("mono8", 2, 4, &[0; 5]), "2×2 px of mono8 has 5 bytes in steps of 4"),
            (raw("mono8", 0, 4, &[0; 9]), "0×2 px"),
            (raw("bayer_rggb8", 2, 2, &[0; 4]), "bayer_rggb8, a mosaic"),
            (raw("nv12", 2, 2, &[0; 4]), "its pixels are nv12; mono8"),
            (raw("mono8", 1 << 31, 2, &[0; 4]), "a side may have"),
        ] {
            let error = picture(&raw).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
