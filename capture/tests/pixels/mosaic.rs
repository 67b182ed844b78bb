//! Demosaicing against its definition: for each colour the mean of the nearest pixels that have it.

use isophote_capture::{Colour, Encoding};

use crate::packing::{Picture, packed, plain};
use crate::{Numbers, differences};

fn mosaics() -> impl Iterator<Item = (Encoding, String, u32, [&'static str; 2])> {
    Encoding::all().filter(|encoding| encoding.is_bayer()).map(|encoding| {
        let code = String::from_utf8(encoding.fourcc().to_vec()).unwrap();
        let (bits, filters) = plain(&code).unwrap();
        (encoding, code, bits, filters.unwrap())
    })
}

/// Mean of a colour's nearest pixels within one pixel, halves rounded up; reflection at the edges.
fn filled(picture: &Picture, rows: [&str; 2], channel: usize) -> Vec<u16> {
    let ([width, height], mosaic) = (picture.size, picture.mosaic(rows));
    let inside = |at: isize, side: usize| {
        let (at, last) = (at.unsigned_abs(), side - 1);
        if at > last { 2 * last - at } else { at }
    };
    let value = |x: usize, y: usize| {
        let mut found: Vec<(isize, u32)> = Vec::new();
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let (x, y) = (inside(x as isize + dx, width), inside(y as isize + dy, height));
            if rows[y % 2].as_bytes()[x % 2] == b"RGB"[channel] {
                found.push((dx * dx + dy * dy, u32::from(mosaic[y * width + x])));
            }
        }
        let least = found.iter().map(|(distance, _)| *distance).min().unwrap();
        let nearest: Vec<u32> =
            found.iter().filter(|(distance, _)| *distance == least).map(|(_, pixel)| *pixel).collect();
        let (sum, n) = (nearest.iter().sum::<u32>(), nearest.len() as u32);
        ((2 * sum + n) / (2 * n)) as u16
    };
    (0..width * height).map(|i| value(i % width, i / width)).collect()
}

#[test]
fn gaps_are_means_of_the_nearest_pixels() {
    let mut numbers = Numbers(3);
    for (encoding, code, bits, rows) in mosaics() {
        for size in [[2, 2], [2, 5], [3, 3], [17, 2], [40, 31]] {
            let picture = Picture::new(&mut numbers, size, bits);
            let stride = size[0] * bits.div_ceil(8) as usize + 5;
            let bytes = packed(&picture, &code, stride, &mut numbers);
            let frame = encoding.frame(&bytes, size, stride, Colour::All).unwrap();
            assert_eq!((frame.size(), frame.planes().len(), encoding.planes(Colour::All)), (&size[..], 3, 3));
            for channel in 0..3 {
                assert_eq!(
                    differences(&frame, channel, &filled(&picture, rows, channel)),
                    [],
                    "{code} {size:?} {channel}"
                );
            }
        }
    }
}

/// A flat colour is reproduced exactly everywhere, a linear slope in the interior.
#[test]
fn flat_colours_and_slopes_are_exact() {
    let size = [24, 18];
    let each = || (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x as u16, y as u16)));
    for (encoding, code, bits, _) in mosaics() {
        let stride = size[0] * bits.div_ceil(8) as usize;
        for slope in [0, 1] {
            let colour =
                |base: u16, gain: u16| each().map(|(x, y)| base + slope * (gain * x + 2 * y)).collect::<Vec<u16>>();
            let picture = Picture { size, y: vec![], rgb: [colour(3, 1), colour(90, 4), colour(200, 0)] };
            let bytes = packed(&picture, &code, stride, &mut Numbers(4));
            let frame = encoding.frame(&bytes, size, stride, Colour::All).unwrap();
            for channel in 0..3 {
                let edge = |x: usize, y: usize| x == 0 || y == 0 || x == size[0] - 1 || y == size[1] - 1;
                let mut wrong = differences(&frame, channel, &picture.rgb[channel]);
                assert_eq!(wrong.is_empty(), slope == 0, "at the edges a slope is reflected");
                wrong.retain(|(x, y, ..)| !edge(*x, *y));
                assert_eq!(wrong, [], "{code} slope {slope} channel {channel}");
            }
        }
    }
}

/// The comparison detects another filter order.
#[test]
fn a_wrong_filter_order_is_detected() {
    let (mut numbers, size) = (Numbers(5), [12, 12]);
    let picture = Picture::new(&mut numbers, size, 8);
    let bytes = packed(&picture, "RGGB", 12, &mut numbers);
    let frame = Encoding::of(*b"GBRG").unwrap().frame(&bytes, size, 12, Colour::All).unwrap();
    assert!((0..3).all(|channel| differences(&frame, channel, &filled(&picture, ["RG", "GB"], channel)).len() > 50));
}
