//! The header of a preview message: its pixels and the drawing over them.

use isophote_tracker as tracker;
pub use isophote_tracker::PreviewPart;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::WindowDocument;
use crate::estimate::EstimateView;

/// Encoding of the pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PreviewFormat {
    /// One byte per pixel, row by row without gaps. Colours are sent as luma, here and in `raw16`.
    #[default]
    Raw8,
    /// Two bytes per pixel, little-endian.
    Raw16,
    /// A JFIF file, in colour if the frames are.
    Jpeg,
}

/// The JSON header of a preview message. Unknown fields are absent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewHeader {
    /// Format of the pixels that follow.
    #[serde(flatten)]
    pub pixels: PreviewPixels,
    /// The frame and the drawing over it.
    #[serde(flatten)]
    pub drawing: PreviewDrawing,
}

/// Format of the pixels of a preview message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewPixels {
    /// Part or quantity shown.
    #[schema(inline)]
    pub part: PreviewPart,
    /// Encoding of the pixels.
    #[schema(inline)]
    pub format: PreviewFormat,
    /// Width of the picture as sent, px.
    pub width: usize,
    /// Height of the picture as sent, px.
    pub height: usize,
    /// Position [x, y] of the first pixel's centre in the frame, px.
    pub origin: [f64; 2],
    /// Distance from one sent pixel to the next, in pixels of the frame; each is the mean of a block.
    pub step: usize,
    /// Values represented by the smallest and the largest number.
    pub levels: PreviewLevels,
}

/// Values represented by 0 and by the largest number, linear in between: pixel values, or multiples of σ for residuals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewLevels {
    /// Value represented by 0.
    pub low: f64,
    /// Value represented by 255, or by 65535 for `raw16`.
    pub high: f64,
}

/// A frame, its estimates, and the drawing over it, in pixels of the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewDrawing {
    /// Name of the session.
    pub session: String,
    /// Epoch of the session, see [`EstimateView::epoch`].
    pub epoch: u64,
    /// The source's frame number.
    pub frame: u64,
    /// Width and height of the frame, or of a slice of a stack, px.
    pub frame_size: [usize; 2],
    /// Stack: the slice shown, [z] or [z, w]: the one through the first target's centre, else the middle one.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub slice: Vec<usize>,
    /// Window of the fit; for several targets, one around all of them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub window: Option<WindowDocument>,
    /// Estimate of the first target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub estimate: Option<EstimateView>,
    /// Estimates of all targets, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub estimates: Vec<EstimateView>,
    /// Outlines of the targets, [x, y] in px: the edge of the formula's domain, else its half maximum. Closed outlines end where
    /// they begin.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub contour: Vec<Vec<[f64; 2]>>,
    /// Outlines s = 1 of the targets, for models with the roles `centre` and `shape`; each ends where it begins.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub outline: Vec<Vec<[f64; 2]>>,
    /// The row of pixels through the first target's centre.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub section: Option<SectionView>,
    /// Runs of saturated pixels: [row, first pixel, last pixel].
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub saturated: Vec<[usize; 3]>,
    /// Whether `saturated` is truncated.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub saturated_cut: bool,
    /// Axes of the targets' poses.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub axes: Vec<AxisView>,
}

/// A row of pixels with the model's prediction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SectionView {
    /// Row, px.
    pub y: usize,
    /// Columns of the pixels, px.
    pub x: Vec<usize>,
    /// Observed values; null for pixels without a value.
    pub observed: Vec<Option<f32>>,
    /// Intensity of the model; null outside of the formula's domain.
    pub model: Vec<Option<f32>>,
    /// Standard deviation of each pixel; null outside of the domain.
    pub sigma: Vec<Option<f32>>,
    /// Value from which pixels are clipped.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub saturation: Option<f64>,
}

/// An axis of a target, projected into the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisView {
    /// `x`, `y` or `z`.
    pub axis: String,
    /// The target's origin, px.
    pub from: [f64; 2],
    /// The end of the axis, px.
    pub to: [f64; 2],
}

impl PreviewDrawing {
    /// Converts the tracker's overlay of a frame. Coordinates are rounded to hundredths of a pixel.
    pub fn new(
        session: &str,
        epoch: u64,
        frame: u64,
        frame_size: [usize; 2],
        overlay: tracker::PreviewOverlay,
    ) -> PreviewDrawing {
        let tracker::PreviewOverlay { slice, window, contours, outlines, section, saturated, saturated_cut, axes } =
            overlay;
        let lines = |lines: Vec<Vec<[f64; 2]>>| {
            let line = |line: Vec<[f64; 2]>| line.into_iter().map(|point| point.map(rounded)).collect();
            lines.into_iter().map(line).collect()
        };
        let axis = |one: tracker::PoseAxis| AxisView {
            axis: one.axis.to_string(),
            from: one.from.map(rounded),
            to: one.to.map(rounded),
        };
        PreviewDrawing {
            session: session.to_string(),
            epoch,
            frame,
            frame_size,
            slice,
            window: window.map(rectangle),
            estimate: None,
            estimates: Vec::new(),
            contour: lines(contours),
            outline: lines(outlines),
            section: section.map(SectionView::from),
            saturated: saturated.into_iter().map(|run| [run.y, run.first, run.last]).collect(),
            saturated_cut,
            axes: axes.into_iter().map(axis).collect(),
        }
    }
}

/// Drops the slices: the preview shows a single one.
fn rectangle(window: isophote_jit::Window) -> WindowDocument {
    let isophote_jit::Window { x, y, width, height, .. } = window;
    WindowDocument { x, y, width, height, z: None, depth: None, w: None, length: None }
}

fn rounded(px: f64) -> f64 {
    (px * 100.0).round() / 100.0
}

impl From<tracker::CrossSection> for SectionView {
    fn from(section: tracker::CrossSection) -> SectionView {
        let known = |values: Vec<f32>| values.into_iter().map(|value| Some(value).filter(|v| v.is_finite())).collect();
        SectionView {
            y: section.y,
            x: (section.x..section.x + section.observed.len()).collect(),
            observed: known(section.observed.into_iter().map(|value| value as f32).collect()),
            model: known(section.model),
            sigma: known(section.sigma),
            saturation: Some(section.saturation).filter(|limit| limit.is_finite()),
        }
    }
}

impl PreviewHeader {
    /// Encodes a message: the length of the JSON as four bytes (little-endian), the JSON, the pixels. `drawing` is a
    /// [`PreviewDrawing`] as JSON, shared by many messages.
    pub fn message(pixels: &PreviewPixels, drawing: &str, bytes: &[u8]) -> Vec<u8> {
        let head = serde_json::to_string(pixels).unwrap_or_default();
        let head = head.strip_suffix('}').unwrap_or_default();
        let rest = drawing.strip_prefix('{').unwrap_or_default();
        let length = head.len() + 1 + rest.len();
        let mut message = Vec::with_capacity(4 + length + bytes.len());
        message.extend((length as u32).to_le_bytes());
        message.extend_from_slice(head.as_bytes());
        message.push(b',');
        message.extend_from_slice(rest.as_bytes());
        message.extend_from_slice(bytes);
        message
    }

    /// Splits a message into header and pixels; `None` if malformed.
    pub fn read(message: &[u8]) -> Option<(PreviewHeader, &[u8])> {
        let (length, rest) = message.split_first_chunk::<4>()?;
        let (head, pixels) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        Some((serde_json::from_slice(head).ok()?, pixels))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn headers_round_trip() {
        let section = tracker::CrossSection {
            y: 3,
            x: 7,
            observed: vec![1.0, f64::NAN],
            model: vec![f32::NAN, 2.5],
            sigma: vec![f32::NAN, 0.5],
            saturation: f64::INFINITY,
        };
        let overlay = tracker::PreviewOverlay {
            contours: vec![vec![[1.006, 2.0], [3.0, 4.0]]],
            section: Some(section),
            ..tracker::PreviewOverlay::default()
        };
        let drawing = PreviewDrawing::new("one", 4, 17, [640, 480], overlay);
        assert_eq!(drawing.contour, [[[1.01, 2.0], [3.0, 4.0]]]);
        let section = drawing.section.as_ref().unwrap();
        assert_eq!((&section.x[..], &section.model[..]), (&[7, 8][..], &[None, Some(2.5)][..]));
        let pixels = PreviewPixels {
            part: PreviewPart::Residual,
            format: PreviewFormat::Raw16,
            width: 1,
            height: 1,
            origin: [0.5, 0.5],
            step: 2,
            levels: PreviewLevels { low: -5.0, high: 5.0 },
        };
        let message = PreviewHeader::message(&pixels, &serde_json::to_string(&drawing).unwrap(), &[1, 2]);
        let (header, sent) = PreviewHeader::read(&message).unwrap();
        assert_eq!((header.pixels, header.drawing, sent), (pixels, drawing, &[1, 2][..]));
        assert!(PreviewHeader::read(&message[..20]).is_none());
    }
}
