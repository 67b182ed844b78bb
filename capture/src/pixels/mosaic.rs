//! The gaps of a colour mosaic, filled in: each pixel gets of each colour the mean of the nearest pixels that have it.

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_tracker::{Buffer, Plane};

/// Three rows of the mosaic around the one that is filled in; each has one reflected pixel more at both ends.
type Rows = [Vec<u16>; 3];

/// The planes r, g, b in the mosaic's own depth, half values rounded up. Sides are at least 2 px, `whole` has every byte.
pub(super) fn planes(
    whole: &[u8],
    size: [usize; 2],
    stride: usize,
    format: PixelFormat,
    red: [usize; 2],
) -> Vec<Plane> {
    let [width, height] = size;
    let mut rows: Rows = std::array::from_fn(|_| vec![0; width + 2]);
    let fill = |row: &mut [u16], y: usize| {
        read(row, &whole[y * stride..], format);
        (row[0], row[width + 1]) = (row[2], row[width - 1]);
    };
    let mut filled: [Vec<u8>; 3] =
        std::array::from_fn(|_| Vec::with_capacity(width * height * format.bytes_per_pixel()));
    fill(&mut rows[1], 0);
    fill(&mut rows[2], 1);
    rows[0] = rows[2].clone(); // row −1 is the reflection of row 1
    for y in 0..height {
        if y > 0 {
            rows.rotate_left(1);
            // Row `height` is the reflection of row `height − 2`.
            fill(&mut rows[2], if y + 1 < height { y + 1 } else { height - 2 });
        }
        for x in 0..width {
            let colours = colours(&rows, x, [x % 2 == red[0], y % 2 == red[1]]);
            for (plane, value) in filled.iter_mut().zip(colours) {
                match format {
                    PixelFormat::U8 => plane.push(value as u8),
                    _ => plane.extend((value as u16).to_le_bytes()),
                }
            }
        }
    }
    let plane = |bytes: Vec<u8>| Plane {
        format,
        row_stride: width * format.bytes_per_pixel(),
        pixel_stride: format.bytes_per_pixel(),
        offset: 0,
        buffer: Buffer::Owned(Arc::from(bytes)),
    };
    filled.into_iter().map(plane).collect()
}

/// The pixels of one row into all but the ends of `row`.
fn read(row: &mut [u16], bytes: &[u8], format: PixelFormat) {
    let inner = row.len() - 1;
    let pixels = &mut row[1..inner];
    match format {
        PixelFormat::U8 => pixels.iter_mut().zip(bytes).for_each(|(pixel, byte)| *pixel = u16::from(*byte)),
        _ => {
            let pairs = bytes.chunks_exact(2);
            pixels.iter_mut().zip(pairs).for_each(|(pixel, pair)| *pixel = u16::from_le_bytes([pair[0], pair[1]]));
        }
    }
}

/// Red, green and blue at column `x` of the middle row; whether red has this column, and this row.
fn colours(rows: &Rows, x: usize, has_red: [bool; 2]) -> [u32; 3] {
    let [up, middle, down] = rows;
    let (left, here, right) = (x, x + 1, x + 2); // rows begin with a reflected pixel
    let at = |row: &[u16], x: usize| u32::from(row[x]);
    let own = at(middle, here);
    let beside = || (at(middle, left) + at(middle, right)).div_ceil(2);
    let above_below = || (at(up, here) + at(down, here)).div_ceil(2);
    let cross = || (at(middle, left) + at(middle, right) + at(up, here) + at(down, here) + 2) / 4;
    let corners = || (at(up, left) + at(up, right) + at(down, left) + at(down, right) + 2) / 4;
    match has_red {
        [true, true] => [own, cross(), corners()],
        [false, false] => [corners(), cross(), own],
        [false, true] => [beside(), own, above_below()],
        [true, false] => [above_below(), own, beside()],
    }
}
