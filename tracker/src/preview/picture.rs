//! `PreviewPicture`: a part of a frame, or its residuals, as pixels for clients.

use isophote_frame::Frame;
use isophote_jit::{PixelFormat, PlaneView, Slices, Window};
use serde::{Deserialize, Serialize};

use super::viewer::FrameScene;

/// Range of the residuals shown, σ.
const RESIDUAL_SIGMAS: [f64; 2] = [-5.0, 5.0];

/// Content of a preview.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum PreviewPart {
    /// The whole frame.
    #[default]
    Frame,
    /// The window that the fit used, or the whole frame if there is none.
    Window,
    /// Residuals of the same pixels: observed − intensity, in σ.
    Residual,
}

/// Pixel type of a preview.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PreviewDepth {
    /// One byte a pixel.
    Eight,
    /// Two bytes a pixel, little endian.
    Sixteen,
    /// Red, green and blue, a byte each, for frames with colours; else one byte.
    Colour,
}

/// A preview image, row by row without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct PreviewPicture {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Numbers per pixel: 1, or 3 for colours.
    pub channels: usize,
    /// Position of the first pixel's centre in the frame, px.
    pub origin: [f64; 2],
    /// Distance between pixels, px of the frame: each is the mean of a block.
    pub step: usize,
    /// Values of 0 and of the largest number: pixel values, σ for residuals.
    pub levels: [f64; 2],
    /// See [`PreviewDepth`].
    pub bytes: Vec<u8>,
}

/// Mapping of values to the numbers that are sent.
#[derive(Clone, Copy)]
struct Scale {
    low: f64,
    high: f64,
    depth: PreviewDepth,
    /// Replaces NaN.
    unknown: f64,
}

impl Scale {
    fn put(&self, bytes: &mut Vec<u8>, value: f64) {
        let value = if value.is_finite() { value } else { self.unknown };
        let share = (value - self.low) / (self.high - self.low);
        match self.depth {
            PreviewDepth::Sixteen => bytes.extend(((share * 65535.0).round() as u16).to_le_bytes()),
            PreviewDepth::Eight | PreviewDepth::Colour => bytes.push((share * 255.0).round() as u8),
        }
    }

    /// True when 8-bit pixels can be sent unchanged.
    fn is_plain(&self) -> bool {
        self.depth != PreviewDepth::Sixteen && self.low == 0.0 && self.high == f64::from(u8::MAX)
    }
}

impl FrameScene<'_> {
    /// A part of the frame in the slice shown, averaged over blocks of `step` × `step` pixels (smaller where the frame
    /// is narrower).
    pub fn picture(&self, part: PreviewPart, step: usize, depth: PreviewDepth) -> PreviewPicture {
        let [width, height, ..] = self.frame.sides();
        let whole = Window { slices: Slices { first: self.slice, count: [1, 1] }, ..Window::whole(width, height) };
        let window = match part {
            PreviewPart::Frame => whole,
            PreviewPart::Window | PreviewPart::Residual => self.window.unwrap_or(whole),
        };
        if part == PreviewPart::Residual {
            return self.residual(window, step, depth);
        }
        let is_colour = depth == PreviewDepth::Colour && self.frame.planes().len() == 3 && self.frame.names().is_none();
        let (frame, planes) = if is_colour { (&self.frame, 0..3) } else { (&self.grey, self.shown_plane()) };
        let views: Vec<PlaneView> = planes.map(|plane| frame.plane_view(plane)).collect();
        let [low, high] = levels(frame, &views, window, depth);
        let scale = Scale { low, high, depth, unknown: low };
        let mut blocks = Blocks::of(window, step);
        if let ([view], 1, true) = (&views[..], blocks.step, scale.is_plain())
            && let Some(bytes) = plain(view, window)
        {
            return blocks.picture(1, scale, bytes);
        }
        let mut row = Vec::with_capacity(window.width);
        let bytes = blocks.means(views.len(), scale, &mut |channel, y, sums: &mut BlockRow| {
            read_row(&views[channel], window, y, &mut row);
            sums.add(&row);
        });
        blocks.picture(views.len(), scale, bytes)
    }

    /// The plane of a grey frame: the only one, else the first that the model reads.
    fn shown_plane(&self) -> std::ops::Range<usize> {
        let model = self.viewer.model().channels();
        let read = self.grey.planes_of(model).and_then(|planes| planes.first().copied());
        let plane = if self.grey.planes().len() == 1 { 0 } else { read.unwrap_or(0) };
        plane..plane + 1
    }

    fn residual(&self, window: Window, step: usize, depth: PreviewDepth) -> PreviewPicture {
        let mut values = vec![f32::NAN; window.pixels()];
        for target in &self.targets {
            for seen in self.unexplained(target, target.window) {
                for (y, row) in seen.residuals.chunks_exact(target.window.width).enumerate() {
                    let first = (target.window.y + y - window.y) * window.width + target.window.x - window.x;
                    // The observed value with the largest residual.
                    let places = values[first..first + row.len()].iter_mut().zip(row);
                    places
                        .filter(|(old, new)| old.is_nan() || new.abs() > old.abs())
                        .for_each(|(old, new)| *old = *new);
                }
            }
        }
        let [low, high] = RESIDUAL_SIGMAS;
        let scale = Scale { low, high, depth, unknown: 0.0 };
        let mut blocks = Blocks::of(window, step);
        let bytes = blocks.means(1, scale, &mut |_, y, sums| sums.add(&values[y * window.width..][..window.width]));
        blocks.picture(1, scale, bytes)
    }
}

/// Values of 0 and of the largest number: the format's range, or that of the data.
fn levels(frame: &Frame, views: &[PlaneView], window: Window, depth: PreviewDepth) -> [f64; 2] {
    let format = views.first().map_or(PixelFormat::U8, PlaneView::format);
    match (format, depth) {
        (PixelFormat::U8, _) => [0.0, f64::from(u8::MAX)],
        (PixelFormat::U16, PreviewDepth::Sixteen) => [0.0, f64::from(u16::MAX)],
        (PixelFormat::U16, _) if frame.largest.is_some_and(|largest| largest > 0.0) => {
            [0.0, frame.largest.unwrap_or_default()]
        }
        (PixelFormat::U16, _) => [0.0, extremes(views, window)[1].max(1.0)],
        // Luma of 8-bit colours.
        (PixelFormat::F32, _) if frame.largest == Some(f64::from(u8::MAX)) => [0.0, f64::from(u8::MAX)],
        (PixelFormat::F32 | PixelFormat::F64, _) => {
            let [low, high] = extremes(views, window);
            if low < high { [low, high] } else { [low.min(0.0), low.max(0.0) + 1.0] }
        }
    }
}

/// The smallest and the largest value; 0 without any.
fn extremes(views: &[PlaneView], window: Window) -> [f64; 2] {
    let (mut row, mut found) = (Vec::with_capacity(window.width), [f64::INFINITY, f64::NEG_INFINITY]);
    for view in views {
        for y in 0..window.height {
            read_row(view, window, y, &mut row);
            for value in row.iter().map(|value| f64::from(*value)).filter(|value| value.is_finite()) {
                found = [found[0].min(value), found[1].max(value)];
            }
        }
    }
    if found[0] <= found[1] { found } else { [0.0; 2] }
}

/// A row of the window as numbers.
fn read_row(view: &PlaneView, window: Window, y: usize, row: &mut Vec<f32>) {
    row.clear();
    let [x0, y0, z, w] = window.first();
    let place = [x0, y0 + y, z, w];
    if let Some(bytes) = view.bytes_of_row(place, window.width) {
        row.extend(bytes.iter().map(|byte| f32::from(*byte)));
    } else if let Some(bytes) = view.words_of_row(place, window.width) {
        row.extend(bytes.chunks_exact(2).map(|word| f32::from(u16::from_ne_bytes([word[0], word[1]]))));
    } else {
        row.extend((x0..x0 + window.width).map(|x| view.pixel_at([x, place[1], z, w]) as f32));
    }
}

/// The bytes of a window of packed 8-bit pixels.
fn plain(view: &PlaneView, window: Window) -> Option<Vec<u8>> {
    let [x, y, z, w] = window.first();
    let mut bytes = Vec::with_capacity(window.pixels());
    for row in 0..window.height {
        bytes.extend_from_slice(view.bytes_of_row([x, y + row, z, w], window.width)?);
    }
    Some(bytes)
}

/// Sums of a row of blocks, of one channel.
struct BlockRow {
    across: usize,
    sums: Vec<f64>,
    counts: Vec<u32>,
}

impl BlockRow {
    /// Adds a row of pixels, NaN excluded.
    fn add(&mut self, row: &[f32]) {
        let blocks = row.chunks_exact(self.across).zip(self.sums.iter_mut().zip(&mut self.counts));
        for (block, (sum, count)) in blocks {
            for value in block.iter().filter(|value| value.is_finite()) {
                *sum += f64::from(*value);
                *count += 1;
            }
        }
    }
}

/// A window in blocks. Incomplete blocks at the right and lower side are dropped.
struct Blocks {
    window: Window,
    step: usize,
    across: usize,
    down: usize,
}

impl Blocks {
    fn of(window: Window, step: usize) -> Blocks {
        let (across, down) = (step.clamp(1, window.width), step.clamp(1, window.height));
        Blocks { window, step: across.max(down), across, down }
    }

    fn size(&self) -> [usize; 2] {
        [self.window.width / self.across, self.window.height / self.down]
    }

    /// The means, row by row. `read` adds row `y` of a channel.
    fn means(&mut self, channels: usize, scale: Scale, read: &mut dyn FnMut(usize, usize, &mut BlockRow)) -> Vec<u8> {
        let [width, height] = self.size();
        let mut bytes = Vec::with_capacity(2 * width * height * channels);
        let empty = || BlockRow { across: self.across, sums: vec![0.0; width], counts: vec![0; width] };
        let mut rows: Vec<BlockRow> = (0..channels).map(|_| empty()).collect();
        for block in 0..height {
            for (channel, row) in rows.iter_mut().enumerate() {
                row.sums.fill(0.0);
                row.counts.fill(0);
                (0..self.down).for_each(|y| read(channel, block * self.down + y, row));
            }
            for x in 0..width {
                for row in &rows {
                    scale.put(&mut bytes, row.sums[x] / f64::from(row.counts[x]));
                }
            }
        }
        bytes
    }

    fn picture(&self, channels: usize, scale: Scale, bytes: Vec<u8>) -> PreviewPicture {
        let [width, height] = self.size();
        let centre = |first: usize, side: usize| first as f64 + (side - 1) as f64 / 2.0;
        let origin = [centre(self.window.x, self.across), centre(self.window.y, self.down)];
        PreviewPicture { width, height, channels, origin, step: self.step, levels: [scale.low, scale.high], bytes }
    }
}
