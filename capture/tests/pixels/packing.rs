//! Packs pictures pixel by pixel as the formats are defined (linux/videodev2.h and its documentation): the reference for the
//! reader.

use crate::Numbers;

/// Full planes of everything that a format may hold.
pub struct Picture {
    pub size: [usize; 2],
    /// Grey or luma.
    pub y: Vec<u16>,
    /// Red, green, blue.
    pub rgb: [Vec<u16>; 3],
}

impl Picture {
    pub fn new(numbers: &mut Numbers, size: [usize; 2], bits: u32) -> Picture {
        let most = (1 << bits) - 1;
        Picture { size, y: numbers.pixels(size, most), rgb: std::array::from_fn(|_| numbers.pixels(size, most)) }
    }

    /// The picture through colour filters; `rows` are the filters of even and odd rows, e.g. `["BG", "GR"]`.
    pub fn mosaic(&self, rows: [&str; 2]) -> Vec<u16> {
        let [width, height] = self.size;
        let seen = |(x, y): (usize, usize)| {
            let filter = rows[y % 2].as_bytes()[x % 2];
            self.rgb["RGB".bytes().position(|one| one == filter).unwrap()][y * width + x]
        };
        (0..width * height).map(|i| seen((i % width, i / width))).collect()
    }
}

/// Bits per pixel, and the filters of a mosaic, for every format without chroma or packed colours.
pub fn plain(code: &str) -> Option<(u32, Option<[&'static str; 2]>)> {
    let filters = |order: &str| match order {
        "RGGB" => ["RG", "GB"],
        "GRBG" => ["GR", "BG"],
        "GBRG" => ["GB", "RG"],
        _ => ["BG", "GR"],
    };
    Some(match code {
        "GREY" => (8, None),
        "Y10 " => (10, None),
        "Y12 " => (12, None),
        "Y16 " => (16, None),
        "BA81" => (8, Some(filters("BGGR"))),
        "GBRG" | "GRBG" | "RGGB" => (8, Some(filters(code))),
        "BG10" => (10, Some(filters("BGGR"))),
        "GB10" => (10, Some(filters("GBRG"))),
        "BA10" => (10, Some(filters("GRBG"))),
        "RG10" => (10, Some(filters("RGGB"))),
        "BG12" => (12, Some(filters("BGGR"))),
        "GB12" => (12, Some(filters("GBRG"))),
        "BA12" => (12, Some(filters("GRBG"))),
        "RG12" => (12, Some(filters("RGGB"))),
        "BYR2" => (16, Some(filters("BGGR"))),
        "GB16" => (16, Some(filters("GBRG"))),
        "GR16" => (16, Some(filters("GRBG"))),
        "RG16" => (16, Some(filters("RGGB"))),
        _ => return None,
    })
}

/// The bytes of `picture` in the format `code` with row stride `stride` (chroma's follows from it). Padding and chroma are
/// random, as drivers leave them.
pub fn packed(picture: &Picture, code: &str, stride: usize, numbers: &mut Numbers) -> Vec<u8> {
    let [width, height] = picture.size;
    let mut random = |n: usize| (0..n).map(|_| numbers.to(255) as u8).collect::<Vec<u8>>();
    let mut bytes = random(stride * height);
    let each = (0..height).flat_map(|y| (0..width).map(move |x| (x, y, y * width + x)));
    match (code, plain(code)) {
        (_, Some((bits, filters))) => {
            let pixels = filters.map_or_else(|| picture.y.clone(), |rows| picture.mosaic(rows));
            for (x, y, i) in each {
                if bits == 8 {
                    bytes[y * stride + x] = pixels[i] as u8;
                } else {
                    // Low byte first.
                    bytes[y * stride + 2 * x] = (pixels[i] % 256) as u8;
                    bytes[y * stride + 2 * x + 1] = (pixels[i] / 256) as u8;
                }
            }
        }
        ("YUYV", _) => each.for_each(|(x, y, i)| bytes[y * stride + 2 * x] = picture.y[i] as u8),
        ("UYVY", _) => each.for_each(|(x, y, i)| bytes[y * stride + 2 * x + 1] = picture.y[i] as u8),
        ("NV12" | "YU12", _) => {
            each.for_each(|(x, y, i)| bytes[y * stride + x] = picture.y[i] as u8);
            // One value of U and of V per 2 × 2 pixels: interleaved, or in two planes.
            bytes.extend(random(2 * height.div_ceil(2) * stride.div_ceil(2)));
        }
        ("RGB3" | "BGR3", _) => {
            for (x, y, i) in each {
                let pixel = [0, 1, 2].map(|c| picture.rgb[c][i] as u8);
                let pixel = if code == "RGB3" { pixel } else { [pixel[2], pixel[1], pixel[0]] };
                bytes[y * stride + 3 * x..][..3].copy_from_slice(&pixel);
            }
        }
        _ => unreachable!("{code} has no definition here"),
    }
    bytes
}
