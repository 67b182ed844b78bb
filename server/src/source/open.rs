//! Opens the source that a document describes, or reports the wrong key.

use std::sync::Arc;

use isophote_capture::camera::FormatWanted;
use isophote_capture::{
    CameraError, CameraSpec, FrameSource, LiveCamera, ReadableFolder, Recording, SourceError, Synthetic, SyntheticSpec,
};
use isophote_jit::PixelFormat;
use isophote_symbolic::Model;
use isophote_tracker::plain;
use isophote_wire::{
    CameraDocument, Pace, PushedDocument, PushedFormat, RecordingDocument, SourceDocument, SyntheticDocument,
};

use super::scene::synthetic_problem;
use super::{Drivers, FrameShape, Paused, Producer};
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;

/// Who receives the opened source.
#[derive(Clone)]
pub enum Taker {
    /// A source of that name.
    Source(Name),
    /// A session of that name, as its own source.
    Session(Name),
}

impl Taker {
    /// Prefix of the source's keys in the request document.
    pub fn prefix(&self) -> &'static str {
        match self {
            Taker::Source(_) => "",
            Taker::Session(_) => "source.",
        }
    }
}

/// A source that is ready to start.
pub struct Opened {
    /// Produces the frames.
    pub producer: Producer,
    /// The frames' shape, as far as it is known.
    pub shape: FrameShape,
    /// Whether frames follow the clock or the fits.
    pub pace: Pace,
    /// Frames per second; 0: as fast as `pace` allows.
    pub rate_hz: f64,
    /// Keeps the camera's previous reader closed until dropped.
    pub held: Option<Paused>,
}

/// Opens a synthetic or pushed source; recordings and cameras, which may block, have functions of their own. `prefix` is the
/// position in the request document (`source.` or nothing), `find` looks a model up.
pub fn open(
    document: &SourceDocument,
    prefix: &str,
    find: impl Fn(&str) -> Result<Arc<Model>, Problem>,
) -> Result<Opened, Problem> {
    match document {
        SourceDocument::Synthetic(synthetic) => open_synthetic(synthetic, prefix, find(&synthetic.model)?),
        SourceDocument::Recording(_) => Err(Problem::bug("a recording is opened before, by `open_recording`")),
        SourceDocument::Pushed(pushed) => open_pushed(pushed, prefix),
        SourceDocument::Camera(_) => Err(Problem::bug("a camera is opened before, by `open_camera`")),
    }
}

fn open_synthetic(document: &SyntheticDocument, prefix: &str, model: Arc<Model>) -> Result<Opened, Problem> {
    check_rate(document.rate_hz, document.pace, prefix)?;
    check_size(document.width, document.height, prefix)?;
    let saturation = document.saturation_level();
    let typical = SyntheticSpec::new(model.clone());
    let (depth, length) = (document.depth.unwrap_or(typical.depth), document.length.unwrap_or(typical.length));
    check_pixels(&[document.width, document.height, depth, length], prefix)?;
    let spec = SyntheticSpec {
        set: document.set.clone(),
        motion: document.motion.clone(),
        width: document.width,
        height: document.height,
        depth,
        length,
        // `t` of a motion is frames over rate; a rate of 0 means only that nothing waits
        rate_hz: if document.rate_hz > 0.0 { document.rate_hz } else { typical.rate_hz },
        bits: document.bits,
        samples: document.samples,
        full_well_e: document.full_well_e,
        read_noise_e: document.read_noise_e,
        row_noise_e: document.row_noise_e,
        exposure: document.exposure.clone(),
        gain: document.gain.clone(),
        saturation,
        black: document.black,
        response: document.response.clone(),
        light: (*document.light).clone(),
        seed: document.seed,
        exposure_latency: document.exposure_latency,
        ..typical
    };
    let source = Synthetic::new(spec).map_err(|error| synthetic_problem(&error, document, prefix))?;
    let shape = FrameShape {
        dimensions: Some(model.coordinates().len()),
        planes: Some(model.channels().len()),
        format: Some(if document.bits <= 8 { PixelFormat::U8 } else { PixelFormat::U16 }),
        columns: None,
        size: source.size(),
    };
    let producer = Producer::Frames(Box::new(source));
    Ok(Opened { producer, shape, pace: document.pace, rate_hz: document.rate_hz, held: None })
}

/// Opens a recording, which may block. `reader` is the model that will fit the frames, if known; `reach` is the folder that the
/// recording may be in. Returns its address relative to that.
pub fn open_recording(
    document: &RecordingDocument,
    prefix: &str,
    reader: Option<&Model>,
    reach: &ReadableFolder,
) -> Result<(String, Opened), Problem> {
    check_rate(document.rate_hz, document.pace, prefix)?;
    let wrong = |error: SourceError| Problem::wrong_key("wrong-source", &format!("{prefix}path"), error.to_string());
    // Pictures are stacked if the reading model has more than two coordinates.
    let dimensions = reader.map_or(2, |model| model.coordinates().len());
    let recording = Recording::within(&document.path, dimensions, reach).map_err(wrong)?;
    let recording = recording.at_rate(document.rate_hz);
    recording.check_picture().map_err(wrong)?;
    // All planes and columns are kept; each session picks its own.
    let columns = recording.csv_channels().map_err(wrong)?;
    let size = recording.size();
    let shape = FrameShape {
        dimensions: size.as_ref().map(Vec::len).or(columns.is_some().then_some(1)),
        planes: None,
        format: None,
        columns,
        size,
    };
    let address = recording.address();
    let producer = Producer::Frames(Box::new(recording));
    Ok((address, Opened { producer, shape, pace: document.pace, rate_hz: document.rate_hz, held: None }))
}

fn open_pushed(document: &PushedDocument, prefix: &str) -> Result<Opened, Problem> {
    check_size(document.width, document.height, prefix)?;
    let format = pixel_format(document.format);
    let shape = FrameShape {
        dimensions: Some(2),
        planes: None, // a PNG may have colour
        format: Some(format),
        columns: None,
        size: Some(vec![document.width, document.height]),
    };
    Ok(Opened { producer: Producer::Pushed, shape, pace: Pace::Fit, rate_hz: 0.0, held: None })
}

/// Opens a camera, tests the document's settings, and closes it again. May block in the driver.
///
/// # Errors
/// A fault of the document or the camera, or 503 if the driver does not answer.
pub fn open_camera(document: &CameraDocument, prefix: &str, drivers: &Drivers) -> Result<Opened, Problem> {
    let size = match (document.width, document.height) {
        (Some(width), Some(height)) => {
            check_size(width as usize, height as usize, prefix)?;
            Some([width, height])
        }
        (None, None) => None,
        (width, _) => {
            let key = if width.is_none() { "width" } else { "height" };
            let message = format!("{key} is missing; give width and height, or neither");
            return Err(Problem::wrong_key("missing-key", prefix.trim_end_matches('.'), message));
        }
    };
    if let Some(rate_hz) = document.rate_hz {
        check_rate(rate_hz, Pace::Realtime, prefix)?;
    }
    let limit = isophote_capture::LIMITS.exposure_latency;
    if document.exposure_latency > limit {
        let message = format!("exposure_latency is {}; it may be {limit} frames", document.exposure_latency);
        return Err(Problem::wrong_key("out-of-range", &format!("{prefix}exposure_latency"), message));
    }
    let spec = CameraSpec {
        device: document.device.clone(),
        format: FormatWanted { format: document.format.clone(), size, rate_hz: document.rate_hz },
        colour: document.colour,
        controls: document.controls.clone(),
    };
    let camera = drivers.ask(&document.device, LIMITS.camera_open_time, move || LiveCamera::open(spec))?;
    let camera = camera.map_err(|error| camera_problem(&error, prefix))?;
    let shape = FrameShape {
        dimensions: Some(2),
        planes: Some(camera.planes()),
        format: Some(camera.pixel_format()),
        columns: None,
        size: Some(camera.size().to_vec()),
    };
    let producer = Producer::Camera { camera: Box::new(camera), drivers: drivers.clone() };
    Ok(Opened { producer, shape, pace: Pace::Realtime, rate_hz: 0.0, held: None })
}

/// 409 for a camera in use, 503 for one that does not answer; other errors are reported at the document's key.
pub fn camera_problem(error: &CameraError, prefix: &str) -> Problem {
    match error {
        CameraError::Silent { .. } => Problem::late(error.to_string()),
        CameraError::Busy { .. } => Problem::conflict("in-use", error.to_string()),
        _ => Problem::wrong_key("wrong-source", &format!("{prefix}{}", error.key()), error.to_string()),
    }
}

impl FrameShape {
    /// Pixel format that the model's fits read: a model with one channel reads colour frames as luma, which is `F32`.
    pub fn format_for(&self, model: &Model) -> Option<PixelFormat> {
        let is_luma = self.planes == Some(3) && self.columns.is_none() && model.channels().len() == 1;
        if is_luma { Some(PixelFormat::F32) } else { self.format }
    }
}

/// Pixel format of raw pushed frames.
pub fn pixel_format(format: PushedFormat) -> PixelFormat {
    match format {
        PushedFormat::U8 => PixelFormat::U8,
        PushedFormat::U16le => PixelFormat::U16,
        PushedFormat::F32 => PixelFormat::F32,
    }
}

fn check_rate(rate_hz: f64, pace: Pace, prefix: &str) -> Result<(), Problem> {
    let (least, most) = (LIMITS.rate_hz_least, LIMITS.rate_hz);
    if (least..=most).contains(&rate_hz) || rate_hz == 0.0 && pace == Pace::Fit {
        return Ok(());
    }
    let message = format!(
        "rate_hz is {}; it must be above 0, from {least} to {most} (0 with pace fit: no limit)",
        plain(rate_hz)
    );
    Err(Problem::wrong_key("out-of-range", &format!("{prefix}rate_hz"), message))
}

fn check_size(width: usize, height: usize, prefix: &str) -> Result<(), Problem> {
    let limit = LIMITS.window_pixels;
    for (key, side) in [("width", width), ("height", height)] {
        if side == 0 || side > limit {
            let message = format!("{key} is {side}; it must be at least 1");
            return Err(Problem::wrong_key("out-of-range", &format!("{prefix}{key}"), message));
        }
    }
    check_pixels(&[width, height], prefix)
}

fn check_pixels(sides: &[usize], prefix: &str) -> Result<(), Problem> {
    let limit = LIMITS.window_pixels;
    if sides.iter().fold(1usize, |pixels, side| pixels.saturating_mul(*side)) > limit {
        let sides: Vec<String> = sides.iter().map(usize::to_string).collect();
        let message = format!("{} pixels are more than the {limit} that a frame may have", sides.join(" × "));
        return Err(Problem::wrong_key("out-of-range", &format!("{prefix}width"), message));
    }
    Ok(())
}
