//! The frames that schedules are tried on: from a recording, or rendered from the model.

use std::path::Path;
use std::sync::Arc;

use isophote_capture::{FrameSource, Synthetic, SyntheticError, SyntheticSpec};
use isophote_symbolic::Model;
use isophote_tracker::{Camera, Frame, TrackState, TrackerOptions};

use super::arguments::TuneArgs;
use crate::failure::Failure;
use crate::offline::{self, OfflineRun};

/// Maximum number of frames taken from a recording, evenly spread.
const FRAMES_MAX: usize = 16;
/// Number of rendered frames.
const RENDERED: usize = 4;
/// Defaults of the camera document: electrons of a pixel at its limit, and of its read noise.
const FULL_WELL_E: f64 = 5000.0;
const READ_NOISE_E: f64 = 15.0;
const SATURATION: f64 = 255.0;
/// Steps of the centres of rendered frames, in fractions of a pixel: the inverse golden ratio and its square.
const PIXEL_SHARES: [f64; 2] = [0.618_033_988_75, 0.381_966_011_25];

/// A frame, and a point near its answer.
pub struct TrialFrame {
    /// One plane per channel of the model.
    pub frame: Frame,
    /// All parameters.
    pub start: Vec<f64>,
}

/// The frames and options of all fits.
pub struct TrialFrames {
    /// Never empty.
    pub scenes: Vec<TrialFrame>,
    /// Options of the fits.
    pub options: TrackerOptions,
    /// Frames of the recording in which the target was not found.
    pub lost: usize,
}

/// Renders frames, or reads them and finds the target in each.
pub fn scenes(args: &TuneArgs, model: &Arc<Model>) -> Result<TrialFrames, Failure> {
    let camera = offline::camera(args.camera.as_deref())?;
    match &args.frames {
        Some(path) => recorded(path, model, camera, &args.model),
        None => rendered(args, model, camera),
    }
}

fn rendered(args: &TuneArgs, model: &Arc<Model>, given: Camera) -> Result<TrialFrames, Failure> {
    let saturation = given.saturation.unwrap_or(SATURATION);
    let electrons_per_dn = given.electrons_per_dn.unwrap_or(FULL_WELL_E / saturation);
    let read_noise_e = given.read_noise_e.unwrap_or(READ_NOISE_E);
    // Rendered frames have no defects and no response, and a size of their own.
    let camera = Camera {
        saturation: Some(saturation),
        electrons_per_dn: Some(electrons_per_dn),
        read_noise_e: Some(read_noise_e),
        defect_map: None,
        response: None,
        ..given
    };
    let spec = SyntheticSpec {
        bits: if saturation > SATURATION { 16 } else { 8 },
        saturation,
        full_well_e: electrons_per_dn * saturation,
        read_noise_e,
        ..SyntheticSpec::new(model.clone())
    };
    let refused = |error: SyntheticError| match error {
        SyntheticError::Model { .. } => {
            Failure::Usage(format!("{}: {error}; name frames to tune it on: --frames PATH", args.model.display()))
        }
        other => Failure::Usage(other.to_string()),
    };
    let typical = Synthetic::new(spec.clone()).map_err(refused)?.truth(0).map_err(Failure::other)?;
    let mut scenes = Vec::new();
    for number in 0..RENDERED {
        let mut spec = SyntheticSpec { seed: args.seed.wrapping_add(number as u64), ..spec.clone() };
        for roles in model.roles() {
            for (axis, parameter) in roles.centre.iter().enumerate() {
                let name = &model.parameters()[parameter.index()].name;
                let share = (number as f64 * PIXEL_SHARES[axis % PIXEL_SHARES.len()]).fract();
                spec.set.insert(name.clone(), typical[name] + share);
            }
        }
        let captured = Synthetic::new(spec).map_err(refused)?.next().map_err(Failure::other)?;
        let captured = captured.ok_or_else(|| Failure::Other("the synthetic camera gave no frame".into()))?;
        let truth = captured.truth.unwrap_or_default();
        let start = model.parameters().iter().map(|parameter| truth[&parameter.name]).collect();
        scenes.push(TrialFrame { frame: captured.frame, start });
    }
    Ok(TrialFrames { scenes, options: options(camera), lost: 0 })
}

/// Accepts every fit, however rough the model.
fn options(camera: Camera) -> TrackerOptions {
    TrackerOptions { camera, confidence_min: 0.0, ..TrackerOptions::default() }
}

fn recorded(path: &Path, model: &Arc<Model>, camera: Camera, document: &Path) -> Result<TrialFrames, Failure> {
    let options = options(camera);
    let mut run = OfflineRun::open(document, model, path, None, (options, Arc::default()))?;
    let step = run.recording.len().div_ceil(FRAMES_MAX).max(1);
    let (mut scenes, mut lost, mut number) = (Vec::new(), 0, 0);
    while let Some(captured) = run.next(model)? {
        number += 1;
        if (number - 1) % step != 0 {
            continue;
        }
        let truth = captured.truth.as_ref();
        let known = model.parameters().iter().map(|p| truth.and_then(|truth| truth.get(&p.name).copied()));
        match known.collect::<Option<Vec<f64>>>().or_else(|| found(&run, &captured.frame)) {
            Some(start) => scenes.push(TrialFrame { frame: captured.frame, start }),
            None => lost += 1,
        }
    }
    if scenes.is_empty() {
        let message = format!(
            "{}: {} finds its target in none of {lost} frames; see what `isophote fit` says of them",
            path.display(),
            document.display()
        );
        return Err(Failure::Other(message));
    }
    Ok(TrialFrames { scenes, options: run.options, lost })
}

/// A search of its own for each frame.
fn found(run: &OfflineRun, frame: &Frame) -> Option<Vec<f64>> {
    let estimate = run.tracker().ok()?.track(frame);
    (estimate.state == TrackState::Tracking).then_some(estimate.parameters)
}
