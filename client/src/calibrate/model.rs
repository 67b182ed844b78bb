//! `isophote calibrate model`: by how much a target's profile differs from a document's formula, from pictures of the target.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use isophote_jit::KernelCache;
use isophote_symbolic::Model;
use isophote_tracker::{DeviationLikelihood, TrackState, TrackerOptions};

use crate::failure::Failure;
use crate::{model_files, offline};

/// Measure the difference between a target's profile and the formula, for the document's `deviation`
///
/// Fits the model to each picture separately, and prints a line for `[model]` of the document. With this line, a target that looks
/// like these pictures is not taken for something else.
#[derive(Clone, Debug, clap::Args)]
pub struct ModelArgs {
    /// Model document of one target with an outline (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Pictures of the target alone, as for `isophote fit`
    #[arg(long, value_name = "PATH")]
    pub frames: PathBuf,
    /// JSON document of the camera
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
}

/// Fits all pictures and prints the deviation.
pub fn model(args: &ModelArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let camera = offline::camera(args.camera.as_deref())?;
    let options = TrackerOptions { camera, ..TrackerOptions::default() };
    let cache = Arc::new(KernelCache::default());
    let mut run = offline::OfflineRun::open(&args.model, &model, &args.frames, None, (options, cache))?;
    let (mut pictures, mut single) = (0, Vec::new());
    let mut all: Option<DeviationLikelihood> = None;
    while let Some(captured) = run.next(&model)? {
        pictures += 1;
        let mut tracker = run.tracker()?;
        let estimate = tracker.track(&captured.frame);
        let signs = (estimate.state == TrackState::Tracking).then(|| tracker.signs(&captured.frame, &estimate));
        let Some(found) = signs.flatten().and_then(|signs| signs.deviations) else { continue };
        single.push(found.most_likely());
        all = Some(all.map_or(found, |all| all.joined(&found)));
    }
    let deviation = all.map(|all| all.most_likely()).ok_or_else(|| {
        let message =
            "the model is fitted to none of the pictures, or is not one target with an outline (the role `shape`)";
        Failure::Other(format!("{}: {pictures} pictures: {message}", args.frames.display()))
    })?;
    if deviation > *Model::DEVIATION.end() {
        let message = "the target is another one than the formula says: measure its profile with `calibrate profile`";
        let frames = args.frames.display();
        return Err(Failure::Other(format!("{frames}: {:.0} % of the height: {message}", 100.0 * deviation)));
    }
    let [least, most] = [f64::min, f64::max].map(|of| single.iter().copied().fold(deviation, of));
    let line = format!(
        "deviation = {deviation:.4}  # of {} of {pictures} pictures; single ones: {least:.4} to {most:.4}",
        single.len()
    );
    writeln!(out, "{line}").map_err(Failure::output)
}
