//! `isophote fit`: fits a model to every frame of a recording, without a service.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_capture::Captured;
use isophote_capture::encode::encode_png_rgb;
use isophote_jit::{KernelCache, Window};
use isophote_symbolic::{Model, ParameterId, Precision};
use isophote_tracker::{
    CONFIDENCE_MIN, Contour, Ending, Estimate, ExposureGoal, Pose, Stop, TrackState, TrackerOptions, Watch, contours,
};
use isophote_wire as wire;

use crate::arguments::{NumberArgs, PrecisionArgument, SizesArgument, VectorWidthArgument, WindowArgument};
use crate::failure::Failure;
use crate::output::with_deviation;
use crate::targets::{self, TargetCount, TargetsFile};
use crate::{model_files, offline, output, overlay};

/// Confidences below this are printed.
const DOUBTFUL: f64 = 0.5;
/// Confidences below this are printed in scientific notation.
const LITTLE: f64 = 0.001;
/// Noise that differs from the stated noise by more than this share is printed.
const NOISE_ASTRAY: f64 = 0.1;

/// Fit a model to every frame of a folder or file, and print one line per frame
#[derive(Clone, Debug, clap::Args)]
pub struct FitArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Folder of PNG, JPEG, TIFF or FITS files (in natural name order, counted from 0), one such file, a Y4M video, an MCAP
    /// file (FILE.mcap#/topic if it has several image topics), or a CSV file, which is one 1-D frame whose header names the
    /// channels. For models of three coordinates, a folder of pictures or a file of several pages is one frame; for models of
    /// four, a folder of either
    #[arg(long, value_name = "PATH")]
    pub frames: PathBuf,
    /// Starting values of the first frame, replacing the document's
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub start: Vec<NumberArgs>,
    /// Values of the model's constants
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub constant: Vec<NumberArgs>,
    /// Fit only these pixels, in all slices; x,y,z,w,h,d restricts the slices as well
    #[arg(long, value_name = "x,y,w,h")]
    pub window: Option<WindowArgument>,
    /// JSON document of the camera: saturation, black, electrons_per_dn, read_noise_e, row_noise_e, defects, defect_map,
    /// intrinsics; or a YAML file of OpenCV's calibration or ROS's camera_info
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// JSON document of the target: spots with positions and radii in mm; with the camera's intrinsics it yields the pose
    #[arg(long, value_name = "FILE")]
    pub target: Option<PathBuf>,
    /// Minimum confidence, 0 to 1, to accept one of several candidates as the target; 0 accepts any [default: 0.5]
    #[arg(long, value_name = "P")]
    pub confidence_min: Option<f64>,
    /// Number of targets, each with the document's formula; all: as many as there are, at most 1000
    #[arg(long, value_name = "N|all", default_value = "1")]
    pub targets: TargetCount,
    /// Least signal-to-noise ratio of targets, 3 and above; confidence is then not asked
    #[arg(long, value_name = "SNR")]
    pub snr_min: Option<f64>,
    /// Sizes that targets may have: the geometric mean of their outline's half widths, px
    #[arg(long, value_name = "MIN,MAX")]
    pub sizes_px: Option<SizesArgument>,
    /// Search for the target anew in every frame, for pictures that are not a sequence
    #[arg(long)]
    pub cold: bool,
    /// Arithmetic of the pixel loops [default: f32; f64 for CSV files]
    #[arg(long, value_enum)]
    pub precision: Option<PrecisionArgument>,
    /// Vector width in bits; auto: the fastest on this machine, measured at the start
    #[arg(long, value_enum, default_value_t = VectorWidthArgument::Auto)]
    pub vector_width: VectorWidthArgument,
    /// Write a picture of each frame with the fitted contour and centre to this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,
    /// Add the points that each fit tried, and the values of F (`trace`); requires --json
    #[arg(long, requires = "json")]
    pub trace: bool,
    /// Print a table of the targets below the line of each frame
    #[arg(long, conflicts_with = "json")]
    pub table: bool,
    /// Write a row for each target of each frame to this file
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Print one JSON object per line
    #[arg(long)]
    pub json: bool,
}

/// Traces each fit and never stops it.
struct Traced;

impl Watch for Traced {
    fn stop(&self) -> Option<Stop> {
        None
    }
    fn is_traced(&self) -> bool {
        true
    }
}

/// Fits all frames. A lost target yields a line with its state; an unreadable file ends the run.
pub fn run(args: &FitArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    check_overlay(args, &model)?;
    let precision = args.precision.map(Precision::from);
    let width = args.vector_width.width()?;
    let cache = Arc::new(KernelCache::of_width(width));
    let mut run = offline::OfflineRun::open(&args.model, &model, &args.frames, precision, (options(args)?, cache))?;
    let mut tracker = run.tracker()?;
    offline::warn_of_camera(args.camera.as_deref(), &run.options, &model);
    let frames = run.recording.path();
    let mut overlays = args.overlay.as_deref().map(|folder| Overlays::create(folder, frames)).transpose()?;
    let mut csv = args.csv.as_deref().map(TargetsFile::create).transpose()?;
    let model_id = wire::model_id(model.name(), model.digest());
    let window = args.window.map(|window| window.0);
    while let Some(captured) = run.next(&model)? {
        check_dimensions(args, &model, &captured)?;
        if args.cold {
            tracker = run.tracker()?;
        }
        let start = std::time::Instant::now();
        let estimates = match args.trace {
            true => tracker.track_all_while(&captured.frame, &Traced),
            false => tracker.track_all(&captured.frame),
        };
        let fit_us = start.elapsed().as_micros() as u64;
        let view = |estimate: Estimate| {
            let mut view = wire::EstimateView::new(&model, &model_id, captured.frame.sequence, &estimate);
            view.trace = wire::trace(&estimate);
            view.file = captured.file.clone();
            view.time_s = captured.frame.time_s;
            view.vector_width = Some(8 * width.bytes());
            view.truth = captured.truth.as_ref().map(|truth| in_document_order(&model, truth));
            view.timing_us = Some(wire::Timing { wait: None, fit: fit_us });
            (estimate, view)
        };
        let all: Vec<(Estimate, wire::EstimateView)> = estimates.into_iter().map(view).collect();
        print(args, &model, &all, run.options.precision, out)?;
        if let Some(csv) = &mut csv {
            csv.write(&model, &all)?;
        }
        if let Some(overlays) = &mut overlays {
            overlays.write(&model, &captured, &all, window)?;
        }
    }
    csv.map_or(Ok(()), TargetsFile::finish)
}

/// Prints the estimates of a frame: as JSON lines, a line for a single target, or a summary.
fn print(
    args: &FitArgs,
    model: &Model,
    all: &[(Estimate, wire::EstimateView)],
    precision: Precision,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    if args.json {
        return targets::found(all).into_iter().try_for_each(|(_, view)| output::json(out, view));
    }
    let text = match all {
        [(estimate, view)] if args.targets == TargetCount::Exactly(1) => {
            let mut text = columns(model, view, estimate);
            if estimate.ending == Ending::NonFinite && precision == Precision::F32 {
                text += ": F or a derivative is no number in f32 (--precision f64 has a wider range)";
            }
            text
        }
        _ if args.targets == TargetCount::All => {
            targets::summary(targets::found(all).into_iter().map(|(_, view)| view))
        }
        _ => targets::summary(all.iter().map(|(_, view)| view)),
    };
    writeln!(out, "{text}").map_err(Failure::output)?;
    if args.table { targets::table(out, model, all) } else { Ok(()) }
}

fn options(args: &FitArgs) -> Result<TrackerOptions, Failure> {
    Ok(TrackerOptions {
        window: args.window.map(|window| window.0),
        start: NumberArgs::merged(&args.start).map_err(Failure::Usage)?,
        constants: NumberArgs::merged(&args.constant).map_err(Failure::Usage)?,
        camera: offline::camera(args.camera.as_deref())?,
        target: args.target.as_deref().map(offline::target).transpose()?,
        exposure: Some(ExposureGoal::Centre),
        targets: args.targets.most(),
        snr_min: args.snr_min,
        sizes_px: args.sizes_px.map(|sizes| sizes.0),
        confidence_min: args.confidence_min.unwrap_or(CONFIDENCE_MIN),
        ..TrackerOptions::default()
    })
}

/// Checked before anything is fitted.
fn check_overlay(args: &FitArgs, model: &Model) -> Result<(), Failure> {
    let coordinates = model.coordinates().len();
    if args.overlay.is_none() || coordinates == 2 {
        return Ok(());
    }
    let noun = if coordinates == 1 { "coordinate" } else { "coordinates" };
    Err(Failure::Usage(format!(
        "--overlay draws outlines over pictures: two coordinates; {} has {coordinates} {noun}, so leave --overlay out",
        args.model.display()
    )))
}

/// Reports wrong dimensions in full, where the tracker could only reject the frame.
fn check_dimensions(args: &FitArgs, model: &Model, captured: &Captured) -> Result<(), Failure> {
    let name = captured.file.as_deref().unwrap_or("the frame");
    let size: Vec<String> = captured.frame.size().iter().map(usize::to_string).collect();
    let (dimensions, coordinates) = (size.len(), model.coordinates().len());
    let is_line = coordinates == 1 && captured.frame.rows() == 1;
    if dimensions != coordinates && !is_line {
        return Err(Failure::Other(format!(
            "{name} has {dimensions} dimensions ({} px), but the model {} has {coordinates}: {}",
            size.join("×"),
            args.model.display(),
            model.coordinates().join(", ")
        )));
    }
    Ok(())
}

fn in_document_order(model: &Model, truth: &BTreeMap<String, f64>) -> wire::Named {
    let names = model.parameters().iter().map(|p| p.name.as_str());
    names.filter_map(|name| truth.get(name).map(|value| (name, *value))).collect()
}

/// A frame's line for people: number, file, state, parameters with standard deviations, χ², saturated share.
pub fn columns(model: &Model, line: &wire::EstimateView, estimate: &Estimate) -> String {
    let state = serde_json::to_value(line.state).ok().and_then(|v| v.as_str().map(str::to_string)).unwrap_or_default();
    let mut text = format!("{:>6}  {:<24}  {state:<9}", line.frame, line.file.as_deref().unwrap_or("-"));
    if line.state == TrackState::Tracking {
        for (name, value) in line.parameters.iter() {
            let deviation = model.parameter(name).and_then(|id| estimate.deviation(id));
            text += &format!("  {name} {}", with_deviation(value, deviation));
        }
        if let Some(chi_square) = line.reduced_chi_square {
            text += &format!("  χ² {chi_square:.3}");
        }
        if let Some(ratio) = line.noise_ratio.filter(|ratio| (ratio - 1.0).abs() > NOISE_ASTRAY) {
            text += &format!("  noise {ratio:.2} times what is stated");
        }
        if let Some(pose) = &line.pose {
            text += &pose_columns(pose);
        }
        text += &format!("  saturated {:.1} %", 100.0 * line.saturated);
        if let Some(count) = line.left_out.filter(|count| *count > 0) {
            text += &format!("  {count} defects left out");
        }
        if let Some(substitute) = &line.substitute {
            text += &substitute_column(substitute);
        }
        for name in &line.at_bounds {
            text += &format!("  {name} at its bound");
        }
    }
    let place = line.candidate.as_ref().map(|fit| place(model, fit)).unwrap_or_default();
    let known = line.confidence.or(line.candidate.as_ref().and_then(|fit| fit.confidence));
    let confidence = known.map(|confidence| match confidence {
        ..LITTLE => format!("{confidence:.1e}"),
        _ => format!("{confidence:.3}"),
    });
    match (line.rejection, confidence, known) {
        (Some(wire::Rejection::Unlikely), Some(confidence), _) => {
            text += &format!("  not taken{place}: confidence {confidence} (--confidence-min 0 takes it)");
        }
        (Some(wire::Rejection::OneOfSeveral), Some(confidence), _) => {
            text += &format!(
                "  not taken{place}: one of several things, confidence {confidence} (--window or --start says which)"
            );
        }
        (Some(wire::Rejection::Unlike), Some(confidence), _) => {
            text += &format!("  not taken{place}: unlike the target that was followed, confidence {confidence}");
        }
        // A bad ending is printed at the end of the line.
        (Some(wire::Rejection::Ending) | None, _, Some(confidence)) if confidence < DOUBTFUL => {
            text += &format!("  confidence {confidence:.2}");
        }
        (Some(wire::Rejection::Ending) | None, ..) => {}
        (Some(rejection), ..) => text += &format!("  not taken{place}: {}", rejection.name()),
    }
    if let Some(strongest) = &line.strongest {
        let wire::Strength { score, threshold, place: [x, y], .. } = strongest;
        text += &format!("  strongest {score:.1} of {threshold:.1} σ at {x:.0}, {y:.0}");
    }
    text + "  " + line.ending.name()
}

/// The centre of a rejected fit.
fn place(model: &Model, fit: &wire::CandidateView) -> String {
    let centre = model.roles().first().map_or(&[][..], |roles| &roles.centre);
    let name = |id: &ParameterId| model.parameters()[id.index()].name.as_str();
    let values: Vec<String> =
        centre.iter().filter_map(|id| Some(format!("{:.1}", fit.parameters.get(name(id))?))).collect();
    if values.is_empty() { String::new() } else { format!(" at {}", values.join(", ")) }
}

/// The substitute of the model that was fitted.
fn substitute_column(substitute: &wire::Substitute) -> String {
    let degree = match substitute.degree {
        0 => "even background".to_string(),
        degree => format!("background of degree {degree}"),
    };
    let robust = if substitute.robust { ", outliers left out" } else { "" };
    format!("  substitute: {degree}, {:.0} % hidden{robust}", 100.0 * substitute.hidden)
}

/// Position with standard deviations in mm; rotation vector in degrees.
fn pose_columns(pose: &Pose) -> String {
    let deviation = |i: usize| pose.covariance.as_ref().and_then(|c| c.get(7 * i)).map(|variance| variance.sqrt());
    let mut text = String::from("  pose");
    for (i, (name, value)) in ["x", "y", "z"].into_iter().zip(pose.position_mm).enumerate() {
        text += &format!(" {name} {} mm", with_deviation(value, deviation(i)));
    }
    let [x, y, z, w] = pose.orientation_xyzw;
    let sine = (x * x + y * y + z * z).sqrt();
    let degrees = if sine > 0.0 { 2.0 * sine.atan2(w).to_degrees() / sine } else { 0.0 };
    let turned = [x, y, z].map(|c| format!("{:.3}", c * degrees)).join(" ");
    let others = pose.alternatives.len();
    let also = if others > 0 { format!(" (ambiguous: or {others} other)") } else { String::new() };
    let left_out = pose.left_out.join(", ");
    let without = if left_out.is_empty() { String::new() } else { format!(" (without {left_out})") };
    format!("{text} turned {turned} °{also}{without}")
}

/// The folder of overlay pictures.
struct Overlays {
    folder: PathBuf,
    written: BTreeSet<String>,
}

impl Overlays {
    /// Creates the folder. It must not be that of the frames, whose files the pictures would replace.
    fn create(folder: &Path, frames: &Path) -> Result<Overlays, Failure> {
        let failed = |error| Failure::Other(format!("{}: cannot be made: {error}", folder.display()));
        std::fs::create_dir_all(folder).map_err(failed)?;
        let own = if frames.is_dir() { Some(frames) } else { frames.parent() };
        let own = own.map(|own| if own.as_os_str().is_empty() { Path::new(".") } else { own });
        if own.and_then(|own| own.canonicalize().ok()) == Some(folder.canonicalize().map_err(failed)?) {
            let message = "--overlay names the folder of the frames, whose files the pictures would replace";
            return Err(Failure::Usage(message.into()));
        }
        Ok(Overlays { folder: folder.into(), written: BTreeSet::new() })
    }

    /// Draws one frame; targets only while they are tracked.
    fn write(
        &mut self,
        model: &Model,
        captured: &Captured,
        all: &[(Estimate, wire::EstimateView)],
        window: Option<Window>,
    ) -> Result<(), Failure> {
        let frame = &captured.frame;
        let plane = frame.plane_view(0);
        let part = overlay::part_to_draw(window, frame.width(), frame.rows());
        let found = all.iter().filter(|(estimate, _)| estimate.state == TrackState::Tracking);
        let outlines: Vec<Contour> = found.clone().flat_map(|(found, _)| contours(model, &found.parameters)).collect();
        let drawn = found.count() > 0;
        let picture = overlay::draw(&plane, part, overlay::white(frame), drawn.then_some(&outlines));
        let name = self.name(captured);
        let path = self.folder.join(name);
        let png = encode_png_rgb(picture.width, picture.height, &picture.rgb).map_err(Failure::other)?;
        output::file(&path, &png)
    }

    /// The frame's file name with `.png`; with its number appended where that name is taken (a.jpg beside a.png).
    fn name(&mut self, captured: &Captured) -> String {
        let file = captured.file.as_deref().unwrap_or("frame");
        let stem = Path::new(file).file_stem().map_or_else(|| file.into(), |stem| stem.to_string_lossy());
        let mut name = format!("{stem}.png");
        if self.written.contains(&name) {
            name = format!("{stem}-{}.png", captured.frame.sequence);
        }
        self.written.insert(name.clone());
        name
    }
}
