//! Converts complete pictures to planes; most planes are views into one copy of the bytes.

use isophote_frame::{Buffer, Frame, Plane};
use isophote_jit::PixelFormat;

use super::colour::Colour;
use super::error::PixelsError;
use super::layout::PixelLayout;
use super::{jpeg, mosaic};

/// `whole` holds exactly the picture's bytes.
pub(super) fn frame(
    layout: PixelLayout,
    format: PixelFormat,
    whole: &[u8],
    size: [usize; 2],
    stride: usize,
    colour: Colour,
) -> Result<Frame, PixelsError> {
    let [width, height] = size;
    let one = |bytes: &[u8], row_stride, pixel_stride, offset| {
        vec![Plane { format, row_stride, pixel_stride, offset, buffer: Buffer::Owned(bytes.into()) }]
    };
    let pixel = format.bytes_per_pixel();
    let planes = match layout {
        PixelLayout::Grey => one(whole, stride, pixel, 0),
        PixelLayout::Packed { luma } => one(whole, stride, 2, luma),
        PixelLayout::Planar { .. } => one(&whole[..stride * (height - 1) + width], stride, 1, 0),
        PixelLayout::Rgb { red } => rgb(&Buffer::Owned(whole.into()), stride, red, colour),
        PixelLayout::Mosaic { red } => match place(red, colour) {
            Some([x, y]) => {
                let planes = one(whole, 2 * stride, 2 * pixel, y * stride + x * pixel);
                return Ok(Frame::new(&[width / 2, height / 2], planes)?);
            }
            None => mosaic::planes(whole, size, stride, format, red),
        },
        PixelLayout::Jpeg => return jpeg::frame(whole, size, colour),
    };
    Ok(Frame::new(&size, planes)?)
}

/// Column and row of a colour in the 2 × 2 mosaic cell.
fn place([x, y]: [usize; 2], colour: Colour) -> Option<[usize; 2]> {
    match colour {
        Colour::All => None,
        Colour::Red => Some([x, y]),
        Colour::Green => Some([1 - x, y]),
        Colour::Blue => Some([1 - x, 1 - y]),
    }
}

/// The planes r, g, b of interleaved bytes, or one of them; red is byte 0 or 2 of each pixel, blue the other.
pub(super) fn rgb(buffer: &Buffer, row_stride: usize, red: usize, colour: Colour) -> Vec<Plane> {
    let offsets = [red, 1, 2 - red];
    let wanted = colour.channel().map_or(0..3, |channel| channel..channel + 1);
    let plane = |offset: &usize| Plane {
        format: PixelFormat::U8,
        row_stride,
        pixel_stride: 3,
        offset: *offset,
        buffer: buffer.clone(),
    };
    offsets[wanted].iter().map(plane).collect()
}
