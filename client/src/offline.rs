//! Offline runs of `fit`, `tune` and `compare`: a recording, a compiled model, and the documents of camera and target.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use isophote_capture::{Captured, FrameSource, Recording};
use isophote_jit::KernelCache;
use isophote_machine::Threads;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{
    Camera, CompileFailure, Compiled, Frame, Intrinsics, Response, Target, Tracker, TrackerOptions,
};
use isophote_wire::explain;

use crate::failure::Failure;
use crate::output;

/// A recording and the model compiled for it.
pub struct OfflineRun {
    /// Starts at the first frame.
    pub recording: Recording,
    /// Includes the precision of the kernels.
    pub options: TrackerOptions,
    /// Compiled from the document given to [`OfflineRun::open`].
    pub compiled: Arc<Compiled>,
    /// The size of the last frame, px.
    size: Option<Vec<usize>>,
}

impl OfflineRun {
    /// Opens the frames and compiles the model; the default `precision` is f32, for CSV files f64.
    pub fn open(
        document: &Path,
        model: &Arc<Model>,
        frames: &Path,
        precision: Option<Precision>,
        (options, cache): (TrackerOptions, Arc<KernelCache>),
    ) -> Result<OfflineRun, Failure> {
        let recording = recording(frames, model)?;
        let is_csv = recording.csv_channels().map_err(Failure::other)?.is_some();
        let precision = precision.unwrap_or(if is_csv { Precision::F64 } else { Precision::F32 });
        let compiled = compile_with(document, model.clone(), precision, cache)?;
        Ok(OfflineRun { recording, options: TrackerOptions { precision, ..options }, compiled, size: None })
    }

    /// The next frame, checked against window, camera and columns. Reports a change of the frame size.
    pub fn next(&mut self, model: &Model) -> Result<Option<Captured>, Failure> {
        let Some(captured) = self.recording.next().map_err(Failure::other)? else { return Ok(None) };
        let size = captured.frame.size().to_vec();
        let name = captured.file.as_deref().unwrap_or("the frame");
        self.options.check_size(model, &size).map_err(|error| Failure::Usage(format!("{name}: {error}")))?;
        if let Some((row, variance)) = self.options.row_without_weight(model, &captured.frame) {
            return Err(Failure::Other(format!(
                "{name}: row {} below the header: `noise` is {variance} there, and a variance must be a number above 0; mend the error in that \
                 row, or take the row out",
                row + 1
            )));
        }
        let format_size = |size: &[usize]| size.iter().map(usize::to_string).collect::<Vec<_>>().join("×");
        match self.size.replace(size.clone()) {
            Some(before) if before != size => {
                eprintln!("{name} has {} px, the frame before it {} px", format_size(&size), format_size(&before));
            }
            _ => {}
        }
        Ok(Some(captured))
    }

    /// A fresh tracker.
    pub fn tracker(&self) -> Result<Tracker, Failure> {
        let tracker = Tracker::new(self.compiled.clone(), self.options.clone());
        tracker.map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Opens frames of the model's dimensions, with its channels by name.
pub fn recording(frames: &Path, model: &Model) -> Result<Recording, Failure> {
    let recording = Recording::of_dimensions(frames, model.coordinates().len()).map_err(Failure::other)?;
    Ok(recording.for_channels(model.channels()))
}

/// Derives and compiles the stages of the model at that path.
pub fn compile(document: &Path, model: Arc<Model>, precision: Precision) -> Result<Arc<Compiled>, Failure> {
    compile_with(document, model, precision, Arc::default())
}

fn compile_with(
    document: &Path,
    model: Arc<Model>,
    precision: Precision,
    cache: Arc<KernelCache>,
) -> Result<Arc<Compiled>, Failure> {
    let compiled = Compiled::with_cache(model, precision, cache, &Threads);
    compiled.map(Arc::new).map_err(|failure| refused(document, &failure))
}

/// The failure of a document that does not compile.
pub fn refused(document: &Path, failure: &CompileFailure) -> Failure {
    Failure::model(&document.display().to_string(), &explain::diagnostics(failure))
}

/// Reads a camera. Text that begins with a brace is JSON; all else is a calibration file.
pub fn camera(path: Option<&Path>) -> Result<Camera, Failure> {
    let Some(path) = path else { return Ok(Camera::default()) };
    let text = read(path)?;
    if is_json(&text) {
        return json(path, &text, CAMERA);
    }
    Ok(Camera { intrinsics: Some(intrinsics(path, &text)?), ..Camera::default() })
}

/// Warns on standard error of camera keys without effect on this model.
pub fn warn_of_camera(path: Option<&Path>, options: &TrackerOptions, model: &Model) {
    let name = path.map_or_else(String::new, |path| path.display().to_string());
    options.unread(model).iter().for_each(|warning| eprintln!("{}", output::warning(&name, warning)));
}

/// The camera as in a session's document.
pub fn camera_document(path: &Path) -> Result<serde_json::Value, Failure> {
    let text = read(path)?;
    match is_json(&text) {
        true => json(path, &text, CAMERA),
        false => Ok(serde_json::json!({"intrinsics": intrinsics(path, &text)?})),
    }
}

fn is_json(text: &str) -> bool {
    text.trim_start().starts_with('{')
}

fn intrinsics(path: &Path, text: &str) -> Result<Intrinsics, Failure> {
    Intrinsics::from_opencv_yaml(text)
        .map_err(|error| Failure::Usage(format!("{}: neither a camera document (JSON) nor {error}", path.display())))
}

/// Describes a camera document, for messages.
const CAMERA: &str = "a camera document (JSON, e.g. {\"saturation\":253,\"electrons_per_dn\":19.6})";

/// The linearised frame, if its camera has a response.
pub fn linear<'a>(
    camera: &Camera,
    response: Option<&Response>,
    captured: &'a Captured,
) -> Result<Cow<'a, Frame>, Failure> {
    let (Some(response), Some(document)) = (response, &camera.response) else {
        return Ok(Cow::Borrowed(&captured.frame));
    };
    let name = captured.file.as_deref().unwrap_or("the frame");
    let checked = document.check_size(captured.frame.size());
    checked.map_err(|error| Failure::Usage(format!("{name}: {error}")))?;
    Ok(Cow::Owned(captured.frame.linear(response)))
}

/// Reads a target.
pub fn target(path: &Path) -> Result<Target, Failure> {
    json(
        path,
        &read(path)?,
        "a target document (JSON, e.g. {\"spots\":[{\"name\":\"red\",\"position_mm\":[0,80,0],\"radius_mm\":30}]})",
    )
}

fn read(path: &Path) -> Result<String, Failure> {
    std::fs::read_to_string(path)
        .map_err(|error| Failure::Usage(format!("{}: cannot be read: {error}", path.display())))
}

fn json<T: serde::de::DeserializeOwned>(path: &Path, text: &str, wanted: &str) -> Result<T, Failure> {
    serde_json::from_str(text).map_err(|error| Failure::Usage(format!("{}: not {wanted}: {error}", path.display())))
}
