//! An offline run: a recording, the arithmetic that suits it, and a model compiled for it, as `fit`, `tune` and `compare` need.
//!
//! In: paths and options of a command. Out: an [`OfflineRun`], and the documents about camera and target. It never knows what is done
//! with the frames.

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

/// A recording and what looks at it.
pub struct OfflineRun {
    /// At its first frame.
    pub recording: Recording,
    /// With the precision of the kernels.
    pub options: TrackerOptions,
    /// The document at the path that [`OfflineRun::open`] was given.
    pub compiled: Arc<Compiled>,
    /// The size of the last frame, px.
    size: Option<Vec<usize>>,
}

impl OfflineRun {
    /// Opens the frames and compiles the model for them; without a `precision` in f32, for CSV files in f64.
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

    /// The next frame, if the window, the camera and the columns suit it. One that is not as large as that before it is told.
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
        let told = |size: &[usize]| size.iter().map(usize::to_string).collect::<Vec<_>>().join("×");
        match self.size.replace(size.clone()) {
            Some(before) if before != size => {
                eprintln!("{name} has {} px, the frame before it {} px", told(&size), told(&before));
            }
            _ => {}
        }
        Ok(Some(captured))
    }

    /// One that has seen nothing yet.
    pub fn tracker(&self) -> Result<Tracker, Failure> {
        let tracker = Tracker::new(self.compiled.clone(), self.options.clone());
        tracker.map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// The frames at that path as the model wants them: of its dimensions, its channels by name.
pub fn recording(frames: &Path, model: &Model) -> Result<Recording, Failure> {
    let recording = Recording::of_dimensions(frames, model.coordinates().len()).map_err(Failure::other)?;
    Ok(recording.for_channels(model.channels()))
}

/// Derives and compiles the stages of the document at that path.
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

/// The document at that path does not compile.
pub fn refused(document: &Path, failure: &CompileFailure) -> Failure {
    Failure::model(&document.display().to_string(), &explain::diagnostics(failure))
}

/// The camera of that document. JSON begins with a brace; everything else is taken for a calibration file.
pub fn camera(path: Option<&Path>) -> Result<Camera, Failure> {
    let Some(path) = path else { return Ok(Camera::default()) };
    let text = read(path)?;
    if is_json(&text) {
        return json(path, &text, CAMERA);
    }
    Ok(Camera { intrinsics: Some(intrinsics(path, &text)?), ..Camera::default() })
}

/// Doubts go to standard error: keys of the camera's document at that path that change nothing with this model.
pub fn warn_of_camera(path: Option<&Path>, options: &TrackerOptions, model: &Model) {
    let name = path.map_or_else(String::new, |path| path.display().to_string());
    options.unread(model).iter().for_each(|warning| eprintln!("{}", output::warning(&name, warning)));
}

/// The same as a session's document has it.
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

/// What a camera document is.
const CAMERA: &str = "a camera document (JSON, e.g. {\"saturation\":253,\"electrons_per_dn\":19.6})";

/// The frame in light, where its camera has a response.
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

/// The target of that document.
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
