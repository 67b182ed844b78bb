//! Finds a camera's defective pixels in dark frames or a running scene: a [`DefectMap`] with the number of pixels by fault.
//!
//! 1. In every frame a pixel is compared with the median of its eight neighbours (of its own colour, in a mosaic).
//! 2. The mean of the middle half of these differences over the frames is the pixel's offset ([`contrast`]): neither noise nor a
//!    passing target changes it much.
//! 3. The scatter of sound pixels is that of most pixels; the threshold follows from the accepted number of sound pixels in the map
//!    ([`faults`]). In a running scene a defect must also be sharper than optics: nothing around it shows anything similar.

mod contrast;
mod faults;

use isophote_frame::Frame;

use crate::camera::{DefectMap, DefectMapError};
use contrast::Contrast;
use faults::{PlaneFaults, deviations, is_silent, tells_noisy};

pub use faults::DefectScene;

/// Most frames kept.
const FRAMES_MAX: usize = 64;
/// Most bytes of frames; two frames are kept whatever their size.
const BYTES_MAX: usize = 512 * 1024 * 1024;

/// Most re-evaluations of the pixels.
const ROUNDS: usize = 6;

/// Parameters of a search for defects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DefectOptions {
    /// The kind of frames.
    pub scene: DefectScene,
    /// Whether frames are raw colour mosaics of two by two pixels.
    pub kinds: PixelKinds,
    /// Average number of sound pixels in the whole map that are taken for defects.
    pub false_alarms: f64,
}

/// The kinds of pixels in a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelKinds {
    /// Pixels of one kind.
    One,
    /// A mosaic of two by two pixels.
    Mosaic,
}

/// The result.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundDefects {
    /// The map.
    pub map: DefectMap,
    /// Single pixels that read too much.
    pub hot: usize,
    /// Single pixels that read too little, or are not finite in most frames.
    pub dead: usize,
    /// Single pixels that scatter too much.
    pub noisy: usize,
    /// Frames used, evenly spread over all.
    pub frames: usize,
    /// Threshold in standard deviations of the sound pixels.
    pub deviations: f64,
    /// Whether noisy pixels were detectable: with enough dark frames.
    pub tells_noisy: bool,
}

/// Why there is no map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DefectFault {
    /// See the text.
    #[error("there is no frame to look at")]
    NoFrame,
    /// A frame unlike the first.
    #[error("frames of different sizes or planes: {0}, then {1}")]
    Unlike(String, String),
    /// See the text.
    #[error("frames are pictures: of two dimensions, at least 8 × 8 px")]
    Small,
    /// See the text.
    #[error(
        "frames without any noise, maybe clipped at zero: nothing says how much sound pixels differ; take frames with an offset \
         or some even light"
    )]
    Silent,
    /// Too many pixels and lines stand out to be defects.
    #[error(
        "{0}; that is not a camera's doing: take dark frames, or a scene that moves or is out of focus, and say whether frames are \
         raw mosaics"
    )]
    TooMany(DefectMapError),
}

/// A measurement to which frames are added.
#[derive(Clone, Debug)]
pub struct DefectMeasurement {
    options: DefectOptions,
    kept: Vec<Frame>,
    /// Frames per kept frame.
    stride: usize,
    seen: usize,
}

impl DefectMeasurement {
    /// A measurement without frames.
    pub fn new(options: DefectOptions) -> DefectMeasurement {
        DefectMeasurement { options, kept: Vec::new(), stride: 1, seen: 0 }
    }

    /// Adds a frame; keeps as many as the limits allow, evenly spread.
    ///
    /// # Errors
    /// When it is no picture, or unlike the first.
    pub fn add(&mut self, frame: &Frame) -> Result<(), DefectFault> {
        let [width, height, depth, length] = frame.sides();
        if depth * length > 1 || width < 8 || height < 8 {
            return Err(DefectFault::Small);
        }
        let shape = |frame: &Frame| (frame.size().to_vec(), frame.planes().len());
        if let Some(first) = self.kept.first().filter(|first| shape(first) != shape(frame)) {
            let describe =
                |frame: &Frame| format!("{} × {} px in {} planes", frame.width(), frame.rows(), frame.planes().len());
            return Err(DefectFault::Unlike(describe(first), describe(frame)));
        }
        if self.seen.is_multiple_of(self.stride) {
            let bytes: usize = frame.planes().iter().map(|p| width * height * p.format.bytes_per_pixel()).sum();
            if self.kept.len() >= (BYTES_MAX / bytes).clamp(2, FRAMES_MAX) {
                let mut number = 0;
                self.kept.retain(|_| {
                    number += 1;
                    number % 2 == 1
                });
                self.stride *= 2;
            }
            if self.seen.is_multiple_of(self.stride) {
                self.kept.push(frame.clone());
            }
        }
        self.seen += 1;
        Ok(())
    }

    /// Computes the map.
    ///
    /// # Errors
    /// When there was no frame, when frames have no noise at all, or more stands out than a map may hold.
    pub fn finish(&self) -> Result<FoundDefects, DefectFault> {
        let first = self.kept.first().ok_or(DefectFault::NoFrame)?;
        let [width, height, ..] = first.sides();
        let (planes, frames) = (first.planes().len(), self.kept.len());
        let tells_noisy = tells_noisy(self.options.scene, frames);
        let asked = planes as f64 * (width * height * if tells_noisy { 2 } else { 1 } + width + height) as f64;
        let deviations = deviations(self.options.false_alarms, asked);
        let spacing = if self.options.kinds == PixelKinds::Mosaic { 2 } else { 1 };
        let mut faults = vec![None; width * height];
        let mut map = DefectMap { width: width as u32, height: height as u32, ..DefectMap::default() };
        for plane in 0..planes {
            let mut contrast = Contrast::of(&self.kept, plane, spacing);
            if is_silent(&contrast) {
                return Err(DefectFault::Silent);
            }
            let mut own = PlaneFaults::of(&contrast, self.options.scene, deviations);
            let mut known = vec![false; width * height];
            // Defects shift the medians of their neighbours: once they are known, those are evaluated again.
            for _ in 0..ROUNDS {
                let found = own.pixels_of([width, height]);
                if found == known {
                    break;
                }
                contrast.renew(&self.kept, plane, &known, &found);
                known = found;
                own = PlaneFaults::of(&contrast, self.options.scene, deviations);
            }
            own.pixels.iter().for_each(|(pixel, fault)| faults[*pixel] = Some(*fault));
            map.columns.extend(own.columns.iter().map(|x| *x as u32));
            map.rows.extend(own.rows.iter().map(|y| *y as u32));
        }
        for lines in [&mut map.columns, &mut map.rows] {
            lines.sort_unstable();
            lines.dedup();
        }
        let mut counts = [0; 3];
        for (pixel, fault) in faults.iter().enumerate() {
            let place = [(pixel % width) as u32, (pixel / width) as u32];
            let is_in_line = map.columns.binary_search(&place[0]).is_ok() || map.rows.binary_search(&place[1]).is_ok();
            let Some(fault) = fault.filter(|_| !is_in_line) else { continue };
            counts[fault as usize] += 1;
            map.pixels.push(place);
        }
        map.check().map_err(DefectFault::TooMany)?;
        let [hot, dead, noisy] = counts;
        Ok(FoundDefects { map, hot, dead, noisy, frames, deviations, tells_noisy })
    }
}

#[cfg(test)]
mod tests;
