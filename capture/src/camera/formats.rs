//! Formats, sizes and rates of a camera, and the choice of the best for a document.

use serde::{Deserialize, Serialize};

use super::error::CameraError;
use super::ioctl::{Choice, DeviceNode, Interval};
use crate::pixels::{Colour, Encoding};

/// Default size, px, if a document names none.
const SIZE: [u32; 2] = [640, 480];
/// Default rate that a format should reach, Hz, if a document names none.
const RATE_HZ: f64 = 30.0;
/// Relative tolerance on rates: 29.97 counts as 30.
const ALIKE: f64 = 0.01;

/// A pixel format of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FormatInfo {
    /// Four-character code without trailing blanks.
    pub format: String,
    /// True if this program can read it.
    pub is_read: bool,
    /// Frame sizes, in the driver's order.
    pub sizes: Vec<SizeInfo>,
}

/// A frame size, or a range of sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SizeInfo {
    /// Width, px; of a range, the largest.
    pub width: u32,
    /// Height, px; of a range, the largest.
    pub height: u32,
    /// Of a range: the smallest width and height, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub from: Option<[u32; 2]>,
    /// Of a range: the steps of width and height, px.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub step: Option<[u32; 2]>,
    /// Frame rates, Hz; of a continuous range, the highest and the lowest.
    pub rates_hz: Vec<f64>,
}

/// All formats of a device.
pub(super) fn offered(node: &DeviceNode) -> Vec<FormatInfo> {
    let of = |fourcc: [u8; 4]| FormatInfo {
        format: name(fourcc),
        is_read: Encoding::of(fourcc).is_some(),
        sizes: node.sizes(fourcc).into_iter().map(|size| size_info(node, fourcc, size)).collect(),
    };
    node.formats().into_iter().map(of).collect()
}

fn size_info(node: &DeviceNode, fourcc: [u8; 4], size: Choice<[u32; 2]>) -> SizeInfo {
    let ([width, height], from, step) = match size {
        Choice::One(size) => (size, None, None),
        Choice::Range { least, most, step } => (most, Some(least), Some(step)),
    };
    SizeInfo { width, height, from, step, rates_hz: rates(node, fourcc, [width, height]) }
}

/// Frame rates, Hz; of a range the highest and the lowest.
fn rates(node: &DeviceNode, fourcc: [u8; 4], size: [u32; 2]) -> Vec<f64> {
    let of = |interval: Choice<Interval>| match interval {
        Choice::One(interval) => vec![interval],
        Choice::Range { least, most, .. } => vec![least, most],
    };
    let intervals = node.intervals(fourcc, size).into_iter().flat_map(of);
    intervals.filter_map(Interval::seconds).map(|seconds| (1000.0 / seconds).round() / 1000.0).collect()
}

/// Printable format code; a set highest bit marks big-endian byte order.
pub(super) fn name(fourcc: [u8; 4]) -> String {
    let big_endian = if fourcc[3] & 0x80 != 0 { "-BE" } else { "" };
    let plain = fourcc.map(|byte| byte & 0x7f);
    format!("{}{big_endian}", String::from_utf8_lossy(&plain).trim_end())
}

/// Format requested by a document.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormatWanted {
    /// Its code; the best format if absent.
    pub format: Option<String>,
    /// Width and height, px.
    pub size: Option<[u32; 2]>,
    /// Minimum frame rate, Hz.
    pub rate_hz: Option<f64>,
}

/// Settings for the driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FormatPlan {
    pub encoding: Encoding,
    pub size: [u32; 2],
    /// `None`: the driver's default.
    pub interval: Option<Interval>,
}

/// Chooses the best format that a device offers.
pub(super) fn choose(
    node: &DeviceNode,
    device: &str,
    wanted: &FormatWanted,
    colour: Colour,
) -> Result<FormatPlan, CameraError> {
    let mut codes = node.formats();
    let now = node.format().ok();
    // A device that lists no formats has only its current one.
    codes.extend(now.filter(|_| codes.is_empty()).map(|format| format.fourcc));
    let candidates: Vec<Offer> = Encoding::all()
        .filter(|encoding| codes.contains(&encoding.fourcc()))
        .filter(|encoding| wanted.format.is_some() || encoding.has(colour))
        .map(|encoding| Offer { encoding, sizes: node.sizes(encoding.fourcc()) })
        .collect();
    let intervals = |encoding: Encoding, size| node.intervals(encoding.fourcc(), size);
    best(&candidates, wanted, now.map(|format| format.size), intervals).map_err(|fault| match fault {
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
        // A driver that lists no sizes is probed by setting one.
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

/// Among the formats with the wanted size, picks the first in the order of [`Encoding::all`] that reaches the rate, else the
/// fastest.
fn best(
    candidates: &[Offer],
    wanted: &FormatWanted,
    now: Option<[u32; 2]>,
    intervals: impl Fn(Encoding, [u32; 2]) -> Vec<Choice<Interval>>,
) -> Result<FormatPlan, Fault> {
    let is_meant =
        |offer: &&Offer| wanted.format.as_ref().is_none_or(|format| offer.encoding.name() == format.trim_end());
    let meant: Vec<&Offer> = candidates.iter().filter(is_meant).collect();
    if meant.is_empty() {
        return Err(Fault::Format);
    }
    let size = wanted.size.unwrap_or_else(|| usual_size(&meant, now));
    let wanted_hz = wanted.rate_hz.unwrap_or(RATE_HZ);
    let mut best: Option<(f64, FormatPlan)> = None;
    for offer in meant.iter().filter(|offer| offer.has(size)) {
        let interval = nearest(&intervals(offer.encoding, size), wanted_hz);
        let plan = FormatPlan { encoding: offer.encoding, size, interval };
        let Some(seconds) = interval.and_then(Interval::seconds) else { return Ok(plan) };
        if 1.0 / seconds >= wanted_hz * (1.0 - ALIKE) {
            return Ok(plan);
        }
        if best.as_ref().is_none_or(|(fastest, _)| 1.0 / seconds > *fastest) {
            best = Some((1.0 / seconds, plan));
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

/// Default size: 640 × 480 if offered, else the current size, else the first listed.
fn usual_size(offers: &[&Offer], now: Option<[u32; 2]>) -> [u32; 2] {
    let is_listed = |size: [u32; 2]| offers.iter().any(|offer| !offer.sizes.is_empty() && offer.has(size));
    let first = || {
        offers.iter().flat_map(|offer| &offer.sizes).next().map(|size| match size {
            Choice::One(size) => *size,
            Choice::Range { most, .. } => *most,
        })
    };
    if is_listed(SIZE) {
        return SIZE;
    }
    let is_any = offers.iter().all(|offer| offer.sizes.is_empty());
    now.filter(|now| is_any || is_listed(*now)).or_else(first).unwrap_or(SIZE)
}

/// The longest offered interval that reaches a rate, else the shortest.
fn nearest(offered: &[Choice<Interval>], wanted_hz: f64) -> Option<Interval> {
    let longest = 1.0 / (wanted_hz * (1.0 - ALIKE));
    let reaches = |interval: &Interval| interval.seconds().is_some_and(|seconds| seconds <= longest);
    let by_time = |a: &Interval, b: &Interval| a.seconds().unwrap_or(0.0).total_cmp(&b.seconds().unwrap_or(0.0));
    let candidates = offered.iter().flat_map(|offer| match offer {
        Choice::One(interval) => vec![*interval],
        Choice::Range { least, most, .. } => {
            // Any time in between is possible.
            let wanted = Interval { numerator: 1000, denominator: (1000.0 * wanted_hz).round().max(1.0) as u32 };
            let is_inside = by_time(least, &wanted).is_le() && by_time(&wanted, most).is_le();
            let inside = is_inside.then_some(wanted);
            [Some(*least), inside, Some(*most)].into_iter().flatten().collect()
        }
    });
    let candidates: Vec<Interval> = candidates.filter(|interval| interval.seconds().is_some()).collect();
    let slowest = candidates.iter().copied().filter(reaches).max_by(by_time);
    slowest.or_else(|| candidates.iter().copied().min_by(by_time))
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

    fn rate(numerator: u32, denominator: u32) -> Choice<Interval> {
        Choice::One(Interval { numerator, denominator })
    }

    /// YUYV is slow, MJPG is not.
    fn intervals(encoding: Encoding, size: [u32; 2]) -> Vec<Choice<Interval>> {
        match (encoding.is_compressed(), size) {
            (true, _) => vec![rate(1, 60), rate(1, 30)],
            (false, [640, 480]) => vec![rate(1001, 30000), rate(1, 15)],
            _ => vec![rate(1, 5)],
        }
    }

    fn chosen(wanted: FormatWanted) -> Result<(String, [u32; 2], f64), Fault> {
        let plan = best(&offers(&[b"YUYV", b"MJPG"]), &wanted, Some([1280, 720]), intervals)?;
        let rate = 1.0 / plan.interval.and_then(Interval::seconds).unwrap();
        Ok((plan.encoding.name(), plan.size, (rate * 100.0).round() / 100.0))
    }

    #[test]
    fn picks_the_slowest_sufficient_rate_also_within_ranges() {
        let hz = |offered: &[Choice<Interval>], wanted| {
            nearest(offered, wanted).and_then(Interval::seconds).map(|s| (100.0 / s).round() / 100.0)
        };
        let interval = |numerator, denominator| Interval { numerator, denominator };
        let range = Choice::Range { least: interval(1, 60), most: interval(1, 1), step: interval(1, 1000) };
        assert_eq!(hz(&[range], 30.0), Some(30.0));
        assert_eq!(hz(&[range], 0.2), Some(1.0));
        assert_eq!(hz(&[range], 500.0), Some(60.0));
        let odd = Choice::Range { least: interval(0, 1), most: interval(1, 0), step: interval(0, 1) };
        assert_eq!(hz(&[odd], 30.0), None);
        assert_eq!(hz(&[odd, rate(1, 25), rate(0, 0)], 30.0), Some(25.0));
        assert_eq!(nearest(&[rate(1, 30), rate(1, 60)], 30.0), Some(interval(1, 30)), "as the driver has it");
        assert_eq!(nearest(&[], 30.0), None);
    }

    #[test]
    fn the_default_size_is_an_offered_one() {
        let encoding = Encoding::of(*b"GREY").unwrap();
        let offer = |sizes: Vec<Choice<[u32; 2]>>| Offer { encoding, sizes };
        let of = |sizes: Vec<Choice<[u32; 2]>>, now| usual_size(&[&offer(sizes)], now);
        let one = |width, height| Choice::One([width, height]);
        assert_eq!(of(vec![one(1280, 720), one(640, 480)], Some([1280, 720])), [640, 480]);
        assert_eq!(of(vec![one(1280, 720), one(320, 240)], Some([320, 240])), [320, 240]);
        assert_eq!(of(vec![one(1280, 720)], Some([320, 240])), [1280, 720], "what is set belongs to another format");
        assert_eq!(of(vec![], Some([1600, 1200])), [1600, 1200]);
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
    fn size_ranges_respect_their_steps() {
        let range = Choice::Range { least: [16, 16], most: [640, 480], step: [16, 1] };
        let offer = Offer { encoding: Encoding::of(*b"GREY").unwrap(), sizes: vec![range] };
        assert!(offer.has([640, 480]) && offer.has([32, 17]));
        assert!(!offer.has([33, 17]) && !offer.has([656, 480]) && !offer.has([0, 0]));
    }
}
