//! Converts a message's raw pixels to a picture.

use std::borrow::Cow;

use isophote_jit::PixelFormat;

use crate::picture::{DecodeError, StoredPicture, check_size};
use crate::pixels::{Colour, Encoding};

use super::message::Raw;

/// Pixel formats that cameras share, with their four-character codes. As in OpenCV, 8UC3 has blue first.
const CAMERA: [(&str, &[u8; 4]); 20] = [
    ("mono8", b"GREY"),
    ("8UC1", b"GREY"),
    ("mono16", b"Y16 "),
    ("16UC1", b"Y16 "),
    ("rgb8", b"RGB3"),
    ("bgr8", b"BGR3"),
    ("8UC3", b"BGR3"),
    ("yuyv", b"YUYV"),
    ("yuv422_yuy2", b"YUYV"),
    ("uyvy", b"UYVY"),
    ("yuv422", b"UYVY"),
    ("bayer_rggb8", b"RGGB"),
    ("bayer_grbg8", b"GRBG"),
    ("bayer_gbrg8", b"GBRG"),
    ("bayer_bggr8", b"BA81"),
    ("bayer_rggb16", b"RG16"),
    ("bayer_grbg16", b"GR16"),
    ("bayer_gbrg16", b"GB16"),
    ("bayer_bggr16", b"BYR2"),
    ("nv12", b"NV12"),
];

/// Other pixel formats: channels per pixel, number format, and whether blue is first.
const OTHERS: [(&str, usize, PixelFormat, bool); 9] = [
    ("32FC1", 1, PixelFormat::F32, false),
    ("rgba8", 4, PixelFormat::U8, false),
    ("bgra8", 4, PixelFormat::U8, true),
    ("8UC4", 4, PixelFormat::U8, true),
    ("rgb16", 3, PixelFormat::U16, false),
    ("bgr16", 3, PixelFormat::U16, true),
    ("16UC3", 3, PixelFormat::U16, true),
    ("rgba16", 4, PixelFormat::U16, false),
    ("bgra16", 4, PixelFormat::U16, true),
];

/// Width and height, checked against the limits of a frame.
pub(super) fn size(raw: &Raw) -> Result<[usize; 2], DecodeError> {
    check_size(raw.width, raw.height)?;
    Ok([raw.width as usize, raw.height as usize])
}

/// Packs rows, reorders channels to r, g, b and converts the byte order.
pub(super) fn picture(raw: &Raw) -> Result<StoredPicture, DecodeError> {
    let size = size(raw)?;
    if let Some((_, fourcc)) = CAMERA.iter().find(|(name, _)| *name == raw.encoding) {
        return camera(raw, size, Encoding::of(**fourcc).ok_or_else(|| unknown(&raw.encoding))?);
    }
    let known = OTHERS.iter().find(|(name, ..)| *name == raw.encoding);
    let (_, stored, format, is_reversed) = known.copied().ok_or_else(|| unknown(&raw.encoding))?;
    let (row, number) = (size[0] * stored * format.bytes_per_pixel(), format.bytes_per_pixel());
    let step = raw.step as usize;
    check_rows(raw, row, size[1].checked_sub(1).map_or(0, |above| step * above + row))?;
    let mut bytes = Vec::with_capacity(row * size[1]);
    raw.bytes.chunks(step).take(size[1]).for_each(|line| bytes.extend_from_slice(&line[..row]));
    if is_reversed {
        for pixel in bytes.chunks_exact_mut(stored * number) {
            (0..number).for_each(|i| pixel.swap(i, 2 * number + i));
        }
    }
    if raw.is_big_endian != cfg!(target_endian = "big") {
        bytes.chunks_exact_mut(number).for_each(<[u8]>::reverse);
    }
    Ok(StoredPicture { size, format, stored, used: stored.min(3), bytes })
}

/// Decodes the pixels as those of a camera.
fn camera(raw: &Raw, size: [usize; 2], encoding: Encoding) -> Result<StoredPicture, DecodeError> {
    let step = raw.step as usize;
    check_rows(raw, encoding.row_bytes(size[0]), encoding.bytes_min(size, step))?;
    let mut bytes = Cow::Borrowed(&raw.bytes[..]);
    if raw.is_big_endian && encoding.format() == PixelFormat::U16 {
        bytes.to_mut().chunks_exact_mut(2).for_each(<[u8]>::reverse);
    }
    let frame = encoding.frame(&bytes, size, step, Colour::All);
    let frame = frame.map_err(|error| DecodeError::Damaged(error.to_string()))?;
    let (planes, number) = (frame.planes(), encoding.format().bytes_per_pixel());
    let mut bytes = Vec::with_capacity(size[0] * size[1] * planes.len() * number);
    for y in 0..size[1] {
        match planes {
            [plane] if plane.pixel_stride == number => {
                bytes.extend_from_slice(
                    &plane.buffer.bytes()[plane.offset + y * plane.row_stride..][..size[0] * number],
                );
            }
            _ => {
                for (x, plane) in (0..size[0]).flat_map(|x| planes.iter().map(move |plane| (x, plane))) {
                    let at = plane.offset + y * plane.row_stride + x * plane.pixel_stride;
                    bytes.extend_from_slice(&plane.buffer.bytes()[at..at + number]);
                }
            }
        }
    }
    Ok(StoredPicture { size, format: encoding.format(), stored: planes.len(), used: planes.len(), bytes })
}

/// Requires `row` bytes per row and `least` bytes in total.
fn check_rows(raw: &Raw, row: usize, least: usize) -> Result<(), DecodeError> {
    if row > 0 && raw.height > 0 && raw.step as usize >= row && raw.bytes.len() >= least {
        return Ok(());
    }
    Err(DecodeError::Damaged(format!(
        "an image of {}×{} px of {} has {} bytes in steps of {}; a row needs {row}",
        raw.width,
        raw.height,
        raw.encoding,
        raw.bytes.len(),
        raw.step
    )))
}

fn unknown(encoding: &str) -> DecodeError {
    let shown: String = encoding.chars().filter(|c| !c.is_control()).take(40).collect();
    DecodeError::Unsupported(format!(
        "its pixels are {shown}; mono8, mono16, 8UC1, 8UC3, 8UC4, 16UC1, 16UC3, 32FC1, rgb, bgr, rgba, bgra and bayer mosaics of \
         8 and 16 bits, yuyv, uyvy and nv12 are read"
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
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

    /// Rows of two pixels with padding.
    #[test]
    fn rows_channels_and_bytes_are_reordered() {
        let bytes: Vec<u8> = (0..40).collect();
        for (encoding, stored, used, expected) in [
            ("mono8", 1, 1, &[0, 1, 20, 21][..]),
            ("8UC1", 1, 1, &[0, 1, 20, 21]),
            ("mono16", 1, 1, &[0, 1, 2, 3, 20, 21, 22, 23]),
            ("32FC1", 1, 1, &[0, 1, 2, 3, 4, 5, 6, 7, 20, 21, 22, 23, 24, 25, 26, 27]),
            ("rgb8", 3, 3, &[0, 1, 2, 3, 4, 5, 20, 21, 22, 23, 24, 25]),
            ("bgr8", 3, 3, &[2, 1, 0, 5, 4, 3, 22, 21, 20, 25, 24, 23]),
            ("8UC3", 3, 3, &[2, 1, 0, 5, 4, 3, 22, 21, 20, 25, 24, 23]),
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

    /// The gaps of a mosaic are interpolated: 2 × 2 pixels with green on a diagonal, in 8 bit and in both byte orders of 16
    /// bit.
    #[test]
    fn mosaics_have_three_colours() {
        let red_first = picture(&raw("bayer_rggb8", 2, 3, &[10, 20, 0, 40, 80])).unwrap();
        assert_eq!((red_first.stored, red_first.used), (3, 3));
        assert_eq!(red_first.bytes, [10, 30, 80, 10, 20, 80, 10, 40, 80, 10, 30, 80]);
        let blue_first = picture(&raw("bayer_bggr8", 2, 2, &[80, 20, 40, 10])).unwrap();
        assert_eq!(blue_first.bytes, red_first.bytes);
        let deep = raw("bayer_grbg16", 2, 4, &[20, 1, 10, 2, 80, 3, 40, 1]);
        let swapped = Raw { is_big_endian: true, ..raw("bayer_grbg16", 2, 4, &[1, 20, 2, 10, 3, 80, 1, 40]) };
        let [deep, swapped] = [deep, swapped].map(|raw| picture(&raw).unwrap());
        assert_eq!((deep.format, &deep.bytes[..6]), (PixelFormat::U16, &[10, 2, 20, 1, 80, 3][..]));
        assert_eq!(deep.bytes, swapped.bytes);
    }

    #[test]
    fn impossible_images_are_rejected() {
        for (raw, words) in [
            (raw("mono8", 2, 0, &[0; 40]), "in steps of 0; a row needs 2"),
            (raw("mono8", 2, 4, &[0; 5]), "2×2 px of mono8 has 5 bytes in steps of 4"),
            (raw("mono8", 0, 4, &[0; 9]), "0×2 px"),
            (raw("bayer_rggb8", 1, 2, &[0; 4]), "at least 2 px on each side"),
            (raw("nv12", 2, 2, &[0; 4]), "2×2 px of nv12 has 4 bytes"),
            (raw("nv21", 2, 2, &[0; 6]), "its pixels are nv21; mono8"),
            (raw("mono8", 1 << 31, 2, &[0; 4]), "a side may have"),
        ] {
            let error = picture(&raw).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
