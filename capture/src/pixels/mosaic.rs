//! Bilinear demosaicing: each pixel gets, for each colour, the mean of the nearest pixels that have it.

use std::sync::Arc;

use isophote_frame::{Buffer, Plane};
use isophote_jit::PixelFormat;

/// Three mosaic rows around the current one, each padded by one reflected pixel at both ends.
type Rows = [Vec<u16>; 3];

/// The planes r, g, b in the mosaic's depth, halves rounded up. Sides are at least 2 px; `whole` is complete.
pub(super) fn planes(
    whole: &[u8],
    size: [usize; 2],
    stride: usize,
    format: PixelFormat,
    red: [usize; 2],
) -> Vec<Plane> {
    let [width, height] = size;
    let row_bytes = width * format.bytes_per_pixel();
    let mut rows: Rows = std::array::from_fn(|_| vec![0; width + 2]);
    let fill = |row: &mut [u16], y: usize| {
        read(&mut row[1..=width], &whole[y * stride..], format);
        (row[0], row[width + 1]) = (row[2], row[width - 1]);
    };
    let mut filled: [Vec<u16>; 3] = std::array::from_fn(|_| vec![0; width]);
    // Planes are contiguous, in memory that is shared without a copy.
    let plane_bytes = row_bytes * height;
    let mut shared: Arc<[u8]> = std::iter::repeat_n(0, 3 * plane_bytes).collect();
    let bytes = Arc::get_mut(&mut shared).expect("nobody else has it yet");
    fill(&mut rows[1], 0);
    fill(&mut rows[2], 1);
    rows[0] = rows[2].clone(); // row −1 is the reflection of row 1
    for y in 0..height {
        if y > 0 {
            rows.rotate_left(1);
            // Row `height` is the reflection of row `height − 2`.
            fill(&mut rows[2], if y + 1 < height { y + 1 } else { height - 2 });
        }
        let has_red = y % 2 == red[1];
        let [r, g, b] = &mut filled;
        // Blue takes the columns that red does not.
        let (first, others) = if has_red { (red[0], [r, g, b]) } else { (1 - red[0], [b, g, r]) };
        fill_row(&rows, first, others);
        for (plane, row) in bytes.chunks_exact_mut(plane_bytes).zip(&filled) {
            write(&mut plane[y * row_bytes..][..row_bytes], row, format);
        }
    }
    let buffer = Buffer::Owned(shared);
    let plane = |channel: usize| Plane {
        format,
        row_stride: row_bytes,
        pixel_stride: format.bytes_per_pixel(),
        offset: channel * plane_bytes,
        buffer: buffer.clone(),
    };
    (0..3).map(plane).collect()
}

/// Interpolates the middle row: the colour at columns `first`, `first + 2`, …, green at the other columns, and the colour
/// absent from the row.
fn fill_row(rows: &Rows, first: usize, [own, green, absent]: [&mut Vec<u16>; 3]) {
    let width = own.len();
    // Rows begin with a reflected pixel: column x is at x + 1. Equal slice lengths and no branches allow vectorization.
    let shifted = |row: usize, by: usize| &rows[row][by..by + width];
    let (left, here, right) = (shifted(1, 0), shifted(1, 1), shifted(1, 2));
    let (up_left, up, up_right) = (shifted(0, 0), shifted(0, 1), shifted(0, 2));
    let (down_left, down, down_right) = (shifted(2, 0), shifted(2, 1), shifted(2, 2));
    let (own, green, absent) = (&mut own[..width], &mut green[..width], &mut absent[..width]);
    let sum = |a: u16, b: u16| u32::from(a) + u32::from(b);
    for x in 0..width {
        let has_own = x % 2 == first;
        let (precedence, above_below) = (sum(left[x], right[x]), sum(up[x], down[x]));
        let corners = sum(up_left[x], up_right[x]) + sum(down_left[x], down_right[x]);
        own[x] = if has_own { here[x] } else { precedence.div_ceil(2) as u16 };
        green[x] = if has_own { ((precedence + above_below + 2) / 4) as u16 } else { here[x] };
        absent[x] = (if has_own { (corners + 2) / 4 } else { above_below.div_ceil(2) }) as u16;
    }
}

/// Reads the pixels of one row from bytes.
fn read(row: &mut [u16], bytes: &[u8], format: PixelFormat) {
    match format {
        PixelFormat::U8 => row.iter_mut().zip(bytes).for_each(|(pixel, byte)| *pixel = u16::from(*byte)),
        _ => row.iter_mut().zip(bytes.as_chunks().0).for_each(|(pixel, bytes)| *pixel = u16::from_le_bytes(*bytes)),
    }
}

/// Writes the pixels of one row to bytes.
fn write(bytes: &mut [u8], row: &[u16], format: PixelFormat) {
    match format {
        PixelFormat::U8 => bytes.iter_mut().zip(row).for_each(|(byte, pixel)| *byte = *pixel as u8),
        _ => bytes.as_chunks_mut().0.iter_mut().zip(row).for_each(|(bytes, pixel)| *bytes = pixel.to_le_bytes()),
    }
}
