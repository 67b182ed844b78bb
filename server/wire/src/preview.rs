//! The head of a preview's message: what its pixels are, and what is drawn over them.

use isophote_tracker as tracker;
pub use isophote_tracker::PreviewPart;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::WindowDocument;
use crate::estimate::EstimateView;

/// How pixels are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PreviewFormat {
    /// A byte a pixel, row by row without gaps. Colours are sent as their luma, here and in `raw16`.
    #[default]
    Raw8,
    /// Two bytes a pixel, the lower first.
    Raw16,
    /// A JFIF file, in colour where frames have colours.
    Jpeg,
}

/// The JSON at the head of a message. What is not known is absent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewHeader {
    /// What follows it.
    #[serde(flatten)]
    pub pixels: PreviewPixels,
    /// What it shows.
    #[serde(flatten)]
    pub drawing: PreviewDrawing,
}

/// What pixels are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewPixels {
    /// What is shown.
    #[schema(inline)]
    pub part: PreviewPart,
    /// How it is sent.
    #[schema(inline)]
    pub format: PreviewFormat,
    /// Pixels of a row, of those sent.
    pub width: usize,
    /// Rows of those sent.
    pub height: usize,
    /// x, y: where the centre of the first pixel lies in the frame.
    pub origin: [f64; 2],
    /// From one pixel to the next, in pixels of the frame: each is the mean of a block.
    pub step: usize,
    /// What the numbers stand for.
    pub levels: PreviewLevels,
}

/// What 0 and the largest number stand for; linear between: pixel values, σ of residuals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewLevels {
    /// Of 0.
    pub low: f64,
    /// Of 255, of `raw16` 65535.
    pub high: f64,
}

/// A frame, its estimates, and what is drawn over it, in its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewDrawing {
    /// The session.
    pub session: String,
    /// The start of the session, see [`EstimateView::epoch`].
    pub epoch: u64,
    /// The source's frame number.
    pub frame: u64,
    /// Width and height of the frame; of a stack those of a slice.
    pub frame_size: [usize; 2],
    /// Of a stack the slice that is shown, z or z, w: the one through the first target's centre, else the middle one.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub slice: Vec<usize>,
    /// The window that the fit used; of several targets one around all of them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub window: Option<WindowDocument>,
    /// What was estimated from the frame, of the first target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub estimate: Option<EstimateView>,
    /// Of all targets, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub estimates: Vec<EstimateView>,
    /// Outlines of the targets, x, y, px: the edge of the formula's domain, else its half maximum. Those that close end where they
    /// begin.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub contour: Vec<Vec<[f64; 2]>>,
    /// The targets' outlines s = 1, of models with the roles `centre` and `shape`; each ends where it begins.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub outline: Vec<Vec<[f64; 2]>>,
    /// A row through the first target's centre.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub section: Option<SectionView>,
    /// Runs of saturated pixels: row, first and last pixel.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub saturated: Vec<[usize; 3]>,
    /// There are more of them.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub saturated_cut: bool,
    /// The axes of poses.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub axes: Vec<AxisView>,
}

/// A row of pixels and what the model predicts of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SectionView {
    /// The row, px.
    pub y: usize,
    /// Where the pixels are, px.
    pub x: Vec<usize>,
    /// What is observed; null where a pixel says nothing.
    pub observed: Vec<Option<f32>>,
    /// The intensity; null outside of the formula's domain.
    pub model: Vec<Option<f32>>,
    /// The standard deviation of a pixel; null outside of the domain.
    pub sigma: Vec<Option<f32>>,
    /// From here on pixels are clipped.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub saturation: Option<f64>,
}

/// An axis of a target in the picture.
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
    /// What the tracker draws, over a frame of that number and size. Coordinates are rounded to hundredths of a pixel.
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

/// Without its slices: what is shown is one of them.
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
    /// A message: the length of the JSON as four bytes, the lowest first, the JSON, the pixels. `drawing` is a [`PreviewDrawing`] as
    /// JSON: many messages share it.
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

    /// A message's head and pixels; `None` where it is none.
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
    fn what_is_written_is_read() {
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
