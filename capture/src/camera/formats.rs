//! Formats, sizes and rates: what a camera offers, and which of it is best for what a document wants.

use serde::{Deserialize, Serialize};

use super::CameraError;
use super::ioctl::{Choice, Node};
use crate::pixels::{Colour, Encoding};

/// Where a document leaves the size open.
const SIZE: [u32; 2] = [640, 480];
/// Where it leaves the rate open: what a format should reach, frames a second.
const RATE_HZ: f64 = 30.0;
/// Rates are alike to this share: 29.97 is 30.
const ALIKE: f64 = 0.01;

/// A format of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FormatInfo {
    /// The four-character code, blanks at its end cut.
    pub format: String,
    /// Whether this program reads it.
    pub is_read: bool,
    /// In the driver's order.
    pub sizes: Vec<SizeInfo>,
}

/// A size, or a range of sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SizeInfo {
    /// px; of a range the largest.
    pub width: u32,
    /// px; of a range the largest.
    pub height: u32,
    /// Of a range: the smallest width and height, and their steps, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub from: Option<[u32; 2]>,
    /// Of a range.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub step: Option<[u32; 2]>,
    /// Frames a second; where any rate in between is possible, the highest and the lowest.
    pub rates_hz: Vec<f64>,
}

/// All formats of a device.
pub(super) fn offered(node: &Node) -> Vec<FormatInfo> {
    let of = |fourcc: [u8; 4]| FormatInfo {
        format: name(fourcc),
        is_read: Encoding::of(fourcc).is_some(),
        sizes: node.sizes(fourcc).into_iter().map(|size| size_info(node, fourcc, size)).collect(),
    };
    node.formats().into_iter().map(of).collect()
}

fn size_info(node: &Node, fourcc: [u8; 4], size: Choice<[u32; 2]>) -> SizeInfo {
    let ([width, height], from, step) = match size {
        Choice::One(size) => (size, None, None),
        Choice::Range { least, most, step } => (most, Some(least), Some(step)),
    };
    SizeInfo { width, height, from, step, rates_hz: rates(node, fourcc, [width, height]) }
}

fn rates(node: &Node, fourcc: [u8; 4], size: [u32; 2]) -> Vec<f64> {
    let of = |interval: Choice<f64>| match interval {
        Choice::One(interval) => vec![1.0 / interval],
        Choice::Range { least, most, .. } => vec![1.0 / least, 1.0 / most],
    };
    let rates = node.intervals(fourcc, size).into_iter().flat_map(of);
    rates.filter(|rate| rate.is_finite()).map(|rate| (rate * 1000.0).round() / 1000.0).collect()
}

/// The code as people write it; a set highest bit says that the format's bytes are the other way round.
pub(super) fn name(fourcc: [u8; 4]) -> String {
    let big_endian = if fourcc[3] & 0x80 != 0 { "-BE" } else { "" };
    let plain = fourcc.map(|byte| byte & 0x7f);
    format!("{}{big_endian}", String::from_utf8_lossy(&plain).trim_end())
}

/// What a document wants of a format.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormatWanted {
    /// Its code; the best one when absent.
    pub format: Option<String>,
    /// Width and height, px.
    pub size: Option<[u32; 2]>,
    /// Frames a second, at least.
    pub rate_hz: Option<f64>,
}

/// What to set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plan {
    pub encoding: Encoding,
    pub size: [u32; 2],
    /// s; `None`: as the driver likes.
    pub interval: Option<f64>,
}

/// The best that a device offers.
pub(super) fn choose(node: &Node, device: &str, wanted: &FormatWanted, colour: Colour) -> Result<Plan, CameraError> {
    let mut codes = node.formats();
    let now = node.format().ok();
    // A device that lists nothing has the format that is set.
    codes.extend(now.filter(|_| codes.is_empty()).map(|format| format.fourcc));
    let candidates: Vec<Offer> = Encoding::all()
        .filter(|encoding| codes.contains(&encoding.fourcc()))
        .filter(|encoding| wanted.format.is_some() || encoding.has(colour))
        .map(|encoding| Offer { encoding, sizes: node.sizes(encoding.fourcc()) })
        .collect();
    let rates = |encoding: Encoding, size| rates(node, encoding.fourcc(), size);
    best(&candidates, wanted, now.map(|format| format.size), rates).map_err(|fault| match fault {
        Fault::Format => CameraError::Format {
            device: device.into(),
            wanted: wanted.format.clone().unwrap_or_else(|| "a format that is read".into()),
            offered: candidates.iter().map(|offer| offer.encoding.name()).collect(),
        },
        Fault::Size { wanted: [width, height], offered } => {
            CameraError::Size { device: device.into(), wanted: format!("{width}×{height}"), offered }
        }
    })
}

struct Offer {
    encoding: Encoding,
    sizes: Vec<Choice<[u32; 2]>>,
}

impl Offer {
    fn has(&self, size: [u32; 2]) -> bool {
        // Who lists no sizes has to be asked by setting one.
        self.sizes.is_empty()
            || self.sizes.iter().any(|offer| match offer {
                Choice::One(one) => *one == size,
                Choice::Range { least, most, step } => (0..2).all(|axis| {
                    (least[axis]..=most[axis]).contains(&size[axis])
                        && (size[axis] - least[axis]).is_multiple_of(step[axis].max(1))
                }),
            })
    }
}

#[derive(Debug, PartialEq)]
enum Fault {
    Format,
    Size { wanted: [u32; 2], offered: Vec<String> },
}

/// Of those that have the size, the first that reaches the rate, in the order of [`Encoding::all`]; if none does, the fastest.
fn best(
    candidates: &[Offer],
    wanted: &FormatWanted,
    now: Option<[u32; 2]>,
    rates: impl Fn(Encoding, [u32; 2]) -> Vec<f64>,
) -> Result<Plan, Fault> {
    let is_meant =
        |offer: &&Offer| wanted.format.as_ref().is_none_or(|format| offer.encoding.name() == format.trim_end());
    let meant: Vec<&Offer> = candidates.iter().filter(is_meant).collect();
    if meant.is_empty() {
        return Err(Fault::Format);
    }
    let has = |size: [u32; 2]| meant.iter().any(|offer| offer.has(size));
    let size = wanted.size.unwrap_or_else(|| if has(SIZE) { SIZE } else { now.unwrap_or(SIZE) });
    let least_hz = wanted.rate_hz.unwrap_or(RATE_HZ) * (1.0 - ALIKE);
    let mut best: Option<(f64, Plan)> = None;
    for offer in meant.iter().filter(|offer| offer.has(size)) {
        let offered = rates(offer.encoding, size);
        let enough = offered.iter().copied().filter(|rate| *rate >= least_hz).min_by(f64::total_cmp);
        let rate = enough.or_else(|| offered.iter().copied().max_by(f64::total_cmp));
        let plan = Plan { encoding: offer.encoding, size, interval: rate.map(|rate| 1.0 / rate) };
        if enough.is_some() || rate.is_none() {
            return Ok(plan);
        }
        if best.as_ref().is_none_or(|(fastest, _)| rate > Some(*fastest)) {
            best = rate.map(|rate| (rate, plan));
        }
    }
    let sizes = meant.iter().flat_map(|offer| &offer.sizes).map(|size| match size {
        Choice::One([width, height]) => format!("{width}×{height}"),
        Choice::Range { least, most, .. } => format!("{}×{} to {}×{}", least[0], least[1], most[0], most[1]),
    });
    let mut offered: Vec<String> = sizes.collect();
    offered.dedup();
    best.map(|(_, plan)| plan).ok_or(Fault::Size { wanted: size, offered })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn offers(codes: &[&[u8; 4]]) -> Vec<Offer> {
        let offer = |code: &&[u8; 4]| Offer {
            encoding: Encoding::of(**code).unwrap(),
            sizes: vec![Choice::One([640, 480]), Choice::One([1280, 720])],
        };
        let mut offers: Vec<Offer> = codes.iter().map(offer).collect();
        offers.sort_by_key(|offer| Encoding::all().position(|encoding| encoding == offer.encoding));
        offers
    }

    /// YUYV is slow, MJPG is not.
    fn rates(encoding: Encoding, size: [u32; 2]) -> Vec<f64> {
        match (encoding.is_compressed(), size) {
            (true, _) => vec![60.0, 30.0],
            (false, [640, 480]) => vec![29.97, 15.0],
            _ => vec![5.0],
        }
    }

    fn chosen(wanted: FormatWanted) -> Result<(String, [u32; 2], f64), Fault> {
        let plan = best(&offers(&[b"YUYV", b"MJPG"]), &wanted, Some([1280, 720]), rates)?;
        Ok((plan.encoding.name(), plan.size, (1.0 / plan.interval.unwrap() * 100.0).round() / 100.0))
    }

    #[test]
    fn the_best_format_has_the_size_and_reaches_the_rate() {
        let size = |size| FormatWanted { size: Some(size), ..FormatWanted::default() };
        assert_eq!(chosen(FormatWanted::default()), Ok(("YUYV".into(), [640, 480], 29.97)));
        assert_eq!(chosen(size([1280, 720])), Ok(("MJPG".into(), [1280, 720], 30.0)));
        let fast = FormatWanted { rate_hz: Some(50.0), ..size([640, 480]) };
        assert_eq!(chosen(fast), Ok(("MJPG".into(), [640, 480], 60.0)));
        let slow = FormatWanted { rate_hz: Some(10.0), ..size([640, 480]) };
        assert_eq!(chosen(slow), Ok(("YUYV".into(), [640, 480], 15.0)));
        let impossible = FormatWanted { rate_hz: Some(500.0), ..size([1280, 720]) };
        assert_eq!(chosen(impossible), Ok(("MJPG".into(), [1280, 720], 60.0)), "the fastest there is");
        let named = FormatWanted { format: Some("YUYV".into()), ..size([1280, 720]) };
        assert_eq!(chosen(named), Ok(("YUYV".into(), [1280, 720], 5.0)));
        assert_eq!(chosen(FormatWanted { format: Some("H264".into()), ..size([640, 480]) }), Err(Fault::Format));
        let odd = chosen(size([641, 480])).unwrap_err();
        assert!(matches!(odd, Fault::Size { offered, .. } if offered.contains(&"640×480".to_string())));
    }

    #[test]
    fn ranges_of_sizes_have_steps() {
        let range = Choice::Range { least: [16, 16], most: [640, 480], step: [16, 1] };
        let offer = Offer { encoding: Encoding::of(*b"GREY").unwrap(), sizes: vec![range] };
        assert!(offer.has([640, 480]) && offer.has([32, 17]));
        assert!(!offer.has([33, 17]) && !offer.has([656, 480]) && !offer.has([0, 0]));
    }
}
