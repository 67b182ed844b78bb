//! `isophote compare`: accuracy, stillness and speed of several models on the same frames.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use isophote_capture::Captured;
use isophote_jit::{KernelCache, VectorWidth};
use isophote_symbolic::Model;
use isophote_tracker::tune::figures;
use isophote_tracker::{CONFIDENCE_MIN, Camera, Estimate, TrackState, TrackerOptions};
use serde::Serialize;

use crate::arguments::VectorWidthArgument;
use crate::failure::Failure;
use crate::http::ServiceArgs;
use crate::offline::{self, OfflineRun};
use crate::scatter::{Dot, Scatter};
use crate::targets::TargetCount;
use crate::{compare_live, model_files, output};

/// Track the same frames with several models and compare their errors, failures, stillness and times
#[derive(Clone, Debug, clap::Args)]
pub struct CompareArgs {
    /// Model documents (TOML; JSON if named *.json); with --live the name of one model of the service
    #[arg(value_name = "MODEL", required = true)]
    pub models: Vec<PathBuf>,
    /// Folder or file of frames, as for `isophote fit`; errors require truth.jsonl beside the frames
    #[arg(long, value_name = "PATH", required_unless_present = "live", conflicts_with = "live")]
    pub frames: Option<PathBuf>,
    /// Compare with the model of this session of the service, on the frames that the session fits
    #[arg(long, value_name = "SESSION", conflicts_with_all = ["camera", "confidence_min", "vector_width", "plot"])]
    pub live: Option<String>,
    /// With --live: number of frames to compare [default: 200]
    #[arg(long, value_name = "N", requires = "live", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub count: Option<u64>,
    /// JSON document of the camera: saturation, electrons_per_dn, read_noise_e, row_noise_e, defects, defect_map
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Minimum confidence, 0 to 1, to accept one of several candidates as the target; 0 accepts any [default: 0.5]
    #[arg(long, value_name = "P")]
    pub confidence_min: Option<f64>,
    /// Number of targets, each with the document's formula; all: as many as there are, at most 1000. Errors are those of one target
    #[arg(long, value_name = "N|all", default_value = "1", conflicts_with = "live")]
    pub targets: TargetCount,
    /// Vector width in bits; auto: the fastest on this machine, measured at the start
    #[arg(long, value_enum, default_value_t = VectorWidthArgument::Auto)]
    pub vector_width: VectorWidthArgument,
    /// Write an SVG plot of the models' errors against their fit times
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    #[command(flatten)]
    pub service: ServiceArgs,
}

/// One model's figures; unknown ones are absent.
#[derive(Clone, Debug, Serialize)]
pub struct ModelFigures {
    /// Model name.
    pub model: String,
    /// Path of the model document, if it is a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Frames in total.
    pub frames: usize,
    /// Frames in which the target was tracked; of several targets their sum.
    pub tracked: usize,
    /// Frames in which it was not; of several targets their sum.
    pub failures: usize,
    /// Root mean square of the centre's distance from the truth, over tracked frames with a truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse_px: Option<f64>,
    /// Median over tracked frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reduced_chi_square: Option<f64>,
    /// Root mean square of the centre's second differences, over three tracked frames in a row.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_difference_px: Option<f64>,
    /// Median time of a fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_us: Option<f64>,
    /// 95th percentile of the time of a fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_us_95: Option<f64>,
}

/// `isophote compare`.
pub fn run(args: &CompareArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let frames = match (&args.live, &args.frames) {
        (Some(session), _) => return compare_live::run(args, session, out),
        (None, Some(frames)) => frames,
        (None, None) => return Err(Failure::Usage("say which frames: --frames PATH, or --live SESSION".into())),
    };
    let camera = offline::camera(args.camera.as_deref())?;
    let models = args.models.iter().map(|path| model_files::read(path)).collect::<Result<Vec<_>, _>>()?;
    let width = args.vector_width.width()?;
    let mut rows = Vec::new();
    for (path, model) in args.models.iter().zip(&models) {
        eprintln!("compare: {}", path.display());
        rows.push(followed(args, frames, path, model, (&camera, width))?);
    }
    match args.service.json {
        true => rows.iter().try_for_each(|row| output::json(out, row))?,
        false => table(out, &rows)?,
    }
    args.plot.as_ref().map_or(Ok(()), |path| plot(path, &rows))
}

/// Tracks the target through all frames.
fn followed(
    args: &CompareArgs,
    frames: &Path,
    document: &Path,
    model: &Arc<Model>,
    (camera, width): (&Camera, VectorWidth),
) -> Result<ModelFigures, Failure> {
    let confidence_min = args.confidence_min.unwrap_or(CONFIDENCE_MIN);
    let targets = args.targets.most();
    let options = TrackerOptions { camera: camera.clone(), confidence_min, targets, ..TrackerOptions::default() };
    let cache = Arc::new(KernelCache::of_width(width));
    let mut run = OfflineRun::open(document, model, frames, None, (options, cache))?;
    let mut tracker = run.tracker()?;
    offline::warn_of_camera(args.camera.as_deref(), &run.options, model);
    let (mut times_us, mut errors_px, mut chi_squares, mut frames) = (Vec::new(), Vec::new(), Vec::new(), 0);
    // Of each target, by frame.
    let mut places: Vec<Vec<Option<Vec<f64>>>> = vec![Vec::new(); targets];
    while let Some(captured) = run.next(model)? {
        let Captured { frame, truth, .. } = captured;
        if frames == 0 {
            // Kernels are compiled at first use: keep that out of the timing.
            run.tracker()?.track_all(&frame);
        }
        frames += 1;
        let begin = Instant::now();
        let estimates = tracker.track_all(&frame);
        times_us.push(begin.elapsed().as_nanos() as f64 / 1e3);
        let truth = truth.filter(|_| targets == 1);
        for (estimate, places) in estimates.iter().zip(&mut places) {
            let place = centre(model, estimate);
            errors_px
                .extend(truth.as_ref().zip(place.as_ref()).and_then(|(truth, place)| error_px(model, truth, place)));
            if place.is_some() {
                chi_squares.extend(estimate.reduced_chi_square);
            }
            places.push(place);
        }
    }
    if args.targets == TargetCount::All {
        places.retain(|places| places.iter().any(Option::is_some));
    }
    let tracked = places.iter().flatten().flatten().count();
    let steps: Vec<f64> = places.iter().flat_map(|places| figures::second_differences(places)).collect();
    Ok(ModelFigures {
        model: model.name().to_string(),
        file: Some(document.display().to_string()),
        frames,
        tracked,
        failures: places.iter().map(Vec::len).sum::<usize>() - tracked,
        rmse_px: figures::rms(&errors_px),
        reduced_chi_square: figures::median(&chi_squares),
        second_difference_px: figures::rms(&steps).filter(|_| has_centre(model)),
        time_us: figures::median(&times_us),
        time_us_95: figures::quantile(&times_us, 0.95),
    })
}

fn has_centre(model: &Model) -> bool {
    model.roles().iter().any(|roles| !roles.centre.is_empty())
}

/// The centres of all targets, concatenated; `None` where the model is not tracking.
fn centre(model: &Model, estimate: &Estimate) -> Option<Vec<f64>> {
    let centres = model.roles().iter().flat_map(|roles| &roles.centre);
    let is_tracked = estimate.state == TrackState::Tracking;
    is_tracked.then(|| centres.map(|parameter| estimate.parameters[parameter.index()]).collect())
}

/// Distance of a centre from the truth, root mean square over several targets. `None` where the truth lacks a centre.
pub fn error_px(model: &Model, truth: &BTreeMap<String, f64>, place: &[f64]) -> Option<f64> {
    let targets = model.roles().iter().filter(|roles| !roles.centre.is_empty()).count();
    let centres = model.roles().iter().flat_map(|roles| &roles.centre);
    let true_place = centres.map(|parameter| truth.get(&model.parameters()[parameter.index()].name).copied());
    let true_place: Vec<f64> = true_place.collect::<Option<_>>()?;
    let squares: f64 = true_place.iter().zip(place).map(|(is, found)| (found - is).powi(2)).sum();
    (targets > 0).then(|| (squares / targets as f64).sqrt())
}

/// One line per model.
pub fn table(out: &mut dyn Write, rows: &[ModelFigures]) -> Result<(), Failure> {
    let shown = |value: Option<f64>, times: f64| value.map_or("-".to_string(), |value| significant(value * times));
    let cells = |row: &ModelFigures| {
        vec![
            row.model.clone(),
            row.frames.to_string(),
            row.tracked.to_string(),
            row.failures.to_string(),
            shown(row.rmse_px, 1.0),
            shown(row.reduced_chi_square, 1.0),
            shown(row.second_difference_px, 1.0),
            shown(row.time_us, 1e-3),
            shown(row.time_us_95, 1e-3),
        ]
    };
    let head = ["MODEL", "FRAMES", "TRACKED", "FAILURES", "RMSE/PX", "CHI²", "2ND DIFF/PX", "MS", "95 %"];
    output::table(out, &head, &rows.iter().map(cells).collect::<Vec<_>>())
}

/// Formats with three significant digits.
pub fn significant(value: f64) -> String {
    let decimals = if value > 0.0 { (2 - value.log10().floor() as i32).clamp(0, 9) as usize } else { 0 };
    format!("{value:.decimals$}")
}

/// Plots against the fit time the first of these figures that some model has: error, stillness, χ².
fn plot(path: &Path, rows: &[ModelFigures]) -> Result<(), Failure> {
    type Figure = (&'static str, fn(&ModelFigures) -> Option<f64>);
    let figures: [Figure; 3] = [
        ("RMSE of the centre, px", |row| row.rmse_px),
        ("rms second difference of the centre, px", |row| row.second_difference_px),
        ("reduced χ²", |row| row.reduced_chi_square),
    ];
    let svg = figures.into_iter().find_map(|(name, figure)| {
        let dot = |row: &ModelFigures| {
            let ms = |time: Option<f64>| time.map_or(f64::NAN, |us| us / 1e3);
            let at = [ms(row.time_us), figure(row).unwrap_or(f64::NAN)];
            Dot { name: row.model.clone(), at, to_x: ms(row.time_us_95) }
        };
        let dots: Vec<Dot> = rows.iter().map(dot).collect();
        Scatter { x: "time for a frame, ms: median, and 95 % of the frames", y: name, dots: &dots }.svg()
    });
    let Some(svg) = svg else {
        return Err(Failure::Other("there is nothing to plot: no model tracked anything".into()));
    };
    output::file(path, svg.as_bytes())
}

/// Measurements of a model by another command, frame by frame.
#[derive(Clone, Debug, Default)]
pub struct MeasuredModel {
    /// Model name.
    pub name: String,
    /// Path of its document.
    pub file: String,
    /// The centres of its targets, concatenated; `None` where they were not tracked.
    pub places: Vec<Option<Vec<f64>>>,
    /// Distances of centres from the truth, where that is known.
    pub errors_px: Vec<f64>,
    /// Reduced χ² of tracked frames.
    pub chi_squares: Vec<f64>,
    /// Times of fits.
    pub times_us: Vec<f64>,
}

impl MeasuredModel {
    fn row(&self) -> ModelFigures {
        let tracked = self.places.iter().flatten().count();
        let has_places = self.places.iter().flatten().any(|place| !place.is_empty());
        let differences = figures::second_differences(&self.places);
        ModelFigures {
            model: self.name.clone(),
            file: self.file.clone().into(),
            frames: self.places.len(),
            tracked,
            failures: self.places.len() - tracked,
            rmse_px: figures::rms(&self.errors_px),
            reduced_chi_square: figures::median(&self.chi_squares),
            second_difference_px: figures::rms(&differences).filter(|_| has_places),
            time_us: figures::median(&self.times_us),
            time_us_95: figures::quantile(&self.times_us, 0.95),
        }
    }
}

/// Prints the figures of the models as a table.
pub fn measured_table(models: &[MeasuredModel], out: &mut dyn Write) -> Result<(), Failure> {
    table(out, &models.iter().map(MeasuredModel::row).collect::<Vec<_>>())
}

/// Prints the figures as one JSON object per model.
pub fn measured_json(models: &[MeasuredModel], out: &mut dyn Write) -> Result<(), Failure> {
    models.iter().try_for_each(|model| output::json(out, &model.row()))
}
