//! Finds a camera's clipping level from the pixels of a window: many cameras clip below the largest value of their format,
//! at 253 or at 4095 of 65535.
//!
//! All light beyond the limit has one value, so the largest value present is a spike in the histogram. With noise a flat
//! bright top is no spike, as noise spreads it. Without noise every even area is a spike, so then one at the top proves
//! nothing.

use isophote_jit::{PixelFormat, PlaneView, Window};

/// Fewest pixels of a spike.
const PIXELS_MIN: u32 = 12;
/// Smallest ratio of a spike's count to its neighbours' mean count.
const HIGHER: f64 = 5.0;
/// Neighbours: number of occurring values, below a spike at the top, on both sides of any other.
const NEIGHBOURS: usize = 4;
/// Largest values of converters in formats of 16 bit.
const CONVERTERS: [u32; 3] = [0x3ff, 0xfff, 0x3fff];

/// The value at which the pixels of a window are clipped; `None` when they do not show it, or when they are fractions of
/// unknown maximum `most` (∞). The maximum of the luma of integer colours is known.
pub(crate) fn clipping(plane: &PlaneView, window: Window, most: f64) -> Option<f64> {
    let largest = match plane.format() {
        PixelFormat::U8 => u32::from(u8::MAX),
        PixelFormat::U16 => u32::from(u16::MAX),
        PixelFormat::F32 | PixelFormat::F64 if (1.0..=f64::from(u16::MAX)).contains(&most) => most as u32,
        PixelFormat::F32 | PixelFormat::F64 => return None,
    };
    let (mut top, mut pixels) = (0, 0);
    each(plane, window, |value| top = top.max(value.min(largest)));
    if !is_plausible(top, largest) {
        return None;
    }
    each(plane, window, |value| pixels += u32::from(value.min(largest) == top));
    if pixels < PIXELS_MIN {
        return None; // most pictures; what is counted so far takes a tenth of the table's time
    }
    let mut counts = vec![0; largest as usize + 1];
    each(plane, window, |value| counts[value.min(largest) as usize] += 1);
    let present = (0..).zip(counts).filter(|(_, count)| *count > 0);
    spike(&present.collect::<Vec<_>>(), largest).map(f64::from)
}

fn each(plane: &PlaneView, window: Window, mut see: impl FnMut(u32)) {
    let [x, y, z, w] = window.first();
    let [width, height, depth, length] = window.size();
    for row in 0..height * depth * length {
        let place = [x, y + row % height, z + row / height % depth, w + row / height / depth];
        let (bytes, words) = (plane.bytes_of_row(place, width), plane.words_of_row(place, width));
        match (bytes, words, plane.spaced_bytes_of_row(place, width)) {
            (Some(bytes), ..) => bytes.iter().for_each(|byte| see(u32::from(*byte))),
            (_, Some(words), _) => {
                words.chunks_exact(2).for_each(|word| see(u32::from(u16::from_ne_bytes([word[0], word[1]]))));
            }
            (.., Some((bytes, 2))) => every::<2>(bytes, &mut see),
            (.., Some((bytes, 3))) => every::<3>(bytes, &mut see),
            (.., Some((bytes, 4))) => every::<4>(bytes, &mut see),
            _ => (x..x + width).for_each(|x| see(plane.pixel_at([x, place[1], place[2], place[3]]).round() as u32)),
        }
    }
}

/// Visits the first of each `N` bytes. A constant `N` takes a third of the time.
fn every<const N: usize>(bytes: &[u8], see: &mut impl FnMut(u32)) {
    bytes.chunks(N).for_each(|chunk| see(u32::from(chunk[0])));
}

/// Whether a limit is in the upper half of the format's range, or the largest value of a narrower converter.
fn is_plausible(top: u32, largest: u32) -> bool {
    top > largest / 2 || CONVERTERS.contains(&top)
}

/// The largest value, if it is the only spike. `present`: occurring values, ascending, with their counts.
fn spike(present: &[(u32, u32)], largest: u32) -> Option<u32> {
    let (&(top, pixels), below) = present.split_last()?;
    let beside = below.get(below.len().checked_sub(NEIGHBOURS)?..)?;
    let is_spike = |pixels: u32, beside: &mut dyn Iterator<Item = &(u32, u32)>| {
        let (mut sum, mut number) = (0.0, 0.0);
        beside.for_each(|(_, count)| (sum, number) = (sum + f64::from(*count), number + 1.0));
        pixels >= PIXELS_MIN && f64::from(pixels) * number >= HIGHER * sum
    };
    if !is_plausible(top, largest) || !is_spike(pixels, &mut beside.iter()) {
        return None;
    }
    let is_even = |i: usize| {
        let (before, after) = (&below[i.saturating_sub(NEIGHBOURS / 2)..i], &below[i + 1..]);
        is_spike(below[i].1, &mut before.iter().chain(after.iter().take(NEIGHBOURS / 2)))
    };
    (!(0..below.len()).any(is_even)).then_some(top)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::picture::{Falloff, Spot, TestPicture};
    use isophote_frame::{Frame, Plane};

    fn found(picture: &TestPicture) -> Option<f64> {
        let frame = picture.frame();
        clipping(&frame.plane_view(0), Window::whole(picture.width, picture.height), f64::INFINITY)
    }

    /// Noise of 1.2 on a ground of 20.
    fn picture(amplitude: f64, profile: Falloff, limit: f64) -> TestPicture {
        let spot = Spot { profile, ..Spot::at(48.3, 47.6, 20.0, amplitude) };
        TestPicture { noise: 1.2, saturation: limit, ..TestPicture::new(96, 96, vec![spot]) }
    }
    const CUBIC: Falloff = Falloff::Cubic(-0.5, -0.3);

    #[test]
    fn the_limit_of_clipped_frames_is_found() {
        for limit in [253.0, 255.0, 235.0, 200.0] {
            for amplitude in [300.0, 450.0, 2000.0] {
                assert_eq!(found(&picture(amplitude, CUBIC, limit)), Some(limit), "{amplitude}");
            }
        }
        assert_eq!(found(&picture(300.0, Falloff::Disc, 253.0)), Some(253.0));
    }

    #[test]
    fn luma_clips_where_its_colours_do() {
        for (amplitude, limit) in [(120.0, 255.0), (450.0, 253.0)] {
            let frame = picture(amplitude, CUBIC, limit).frame();
            let luma = Frame::new(frame.size(), vec![frame.planes()[0].clone(); 3]).unwrap().luma();
            let view = luma.plane_view(0);
            let known = |most| clipping(&view, Window::whole(96, 96), most);
            assert_eq!(known(luma.largest.unwrap()), found(&picture(amplitude, CUBIC, limit)));
            assert_eq!(known(f64::INFINITY), None);
        }
    }

    /// Interleaved pixels of either format, over a part of the picture.
    #[test]
    fn interleaved_planes_equal_packed_ones() {
        for (amplitude, limit) in [(120.0, 255.0), (450.0, 253.0)] {
            let frame = picture(amplitude, CUBIC, limit).frame();
            let packed = frame.plane_view(0);
            let window = Window { x: 7, y: 5, width: 80, height: 84, ..Window::whole(96, 96) };
            let pixels: Vec<u8> = (0..96 * 96).map(|i| packed.pixel(i % 96, i / 96) as u8).collect();
            let among: Vec<u8> = pixels.iter().flat_map(|pixel| [255, *pixel, 0]).collect();
            let among = PlaneView::new(PixelFormat::U8, &among[1..], 96, 96, 3 * 96, 3).unwrap();
            assert_eq!(clipping(&among, window, f64::INFINITY), clipping(&packed, window, f64::INFINITY));
            let wide: Vec<u8> = pixels.iter().flat_map(|pixel| (u16::from(*pixel) << 8).to_ne_bytes()).collect();
            let wide = PlaneView::new(PixelFormat::U16, &wide, 96, 96, 2 * 96, 2).unwrap();
            let twice: Vec<u8> =
                pixels.iter().flat_map(|pixel| [u16::from(*pixel) << 8, 9].map(u16::to_ne_bytes)).flatten().collect();
            let twice = PlaneView::new(PixelFormat::U16, &twice, 96, 96, 4 * 96, 4).unwrap();
            assert_eq!(clipping(&twice, window, f64::INFINITY), clipping(&wide, window, f64::INFINITY));
        }
    }

    #[test]
    fn frames_without_clipping_have_no_limit() {
        for amplitude in [0.0, 60.0, 150.0, 220.0] {
            assert_eq!(found(&picture(amplitude, CUBIC, 255.0)), None, "{amplitude}");
        }
        for amplitude in [120.0, 180.0, 215.0] {
            assert_eq!(found(&picture(amplitude, Falloff::Disc, 255.0)), None, "an even top of {amplitude} with noise");
            let silent = TestPicture { noise: 0.0, samples: 4, ..picture(amplitude, Falloff::Disc, 255.0) };
            assert_eq!(found(&silent), None, "an even top of {amplitude} without noise");
            let bright = TestPicture { ground: 220.0, ..silent };
            assert_eq!(
                found(&TestPicture { spots: vec![Spot { amplitude: -100.0, ..bright.spots[0] }], ..bright }),
                None
            );
        }
        assert_eq!(found(&picture(300.0, CUBIC, 100.0)), None, "below half of the range");
    }

    #[test]
    fn sixteen_bits_and_interleaved_channels() {
        let pixels = TestPicture { ground: 300.0, noise: 20.0, ..picture(6000.0, CUBIC, 1e9) }.pixels();
        let frame = |limit: u16, shift: u32| {
            let value = |pixel: &f64| (pixel.max(0.0) as u16).min(limit) << shift;
            let bytes = pixels.iter().flat_map(|pixel| value(pixel).to_ne_bytes()).collect();
            Frame::new(&[96, 96], vec![Plane::owned(PixelFormat::U16, bytes, 96)]).unwrap()
        };
        let found = |frame: &Frame| clipping(&frame.plane_view(0), Window::whole(96, 96), f64::INFINITY);
        assert_eq!(found(&frame(4095, 0)), Some(4095.0));
        assert_eq!(found(&frame(4095, 4)), Some(65520.0));
        assert_eq!(found(&frame(4000, 0)), None, "not the largest value of any converter");
        assert_eq!(found(&frame(u16::MAX, 0)), None);

        let red = picture(450.0, CUBIC, 253.0).pixels();
        let bytes: Vec<u8> = red.iter().flat_map(|pixel| [pixel.clamp(0.0, 253.0) as u8, 7]).collect();
        let buffer = isophote_frame::Buffer::Owned(bytes.into());
        let planes = (0..2).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, 96, 2, channel)).collect();
        let frame = Frame::new(&[96, 96], planes).unwrap();
        let window = Window { x: 20, y: 10, width: 70, height: 80, ..Window::whole(96, 96) };
        assert_eq!(clipping(&frame.plane_view(0), window, f64::INFINITY), Some(253.0));
        assert_eq!(clipping(&frame.plane_view(1), window, f64::INFINITY), None);
    }
}
