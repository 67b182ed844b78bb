//! `isophote calibrate pixels`: the map of a camera's defects, from dark frames or a running scene.

use std::io::Write;
use std::path::{Path, PathBuf};

use isophote_capture::{FrameSource, Recording};
use isophote_tracker::{Camera, DefectFault, DefectMeasurement, DefectOptions, DefectScene, FoundDefects, PixelKinds};
use serde::Serialize;

use crate::failure::Failure;
use crate::{offline, output};

/// Find defective pixels (hot, dead and noisy pixels, columns and rows), which fits and searches then exclude
///
/// Frames are taken without light (--dark), or show a scene that moves or is out of focus, since static light as sharp as a pixel
/// cannot be distinguished from a hot pixel.
#[derive(Clone, Debug, clap::Args)]
pub struct PixelsArgs {
    /// Folders or files of pictures, all of one size; more pictures reveal fainter defects
    #[arg(value_name = "FRAMES", required_unless_present = "folder")]
    pub frames: Vec<PathBuf>,
    /// Same as FRAMES
    #[arg(long = "frames", value_name = "PATH")]
    pub folder: Option<PathBuf>,
    /// Frames show no scene: taken without light, or in even light
    #[arg(long)]
    pub dark: bool,
    /// Frames are raw colour mosaics of two by two pixels; pixels are compared with those of their own colour
    #[arg(long)]
    pub mosaic: bool,
    /// Expected number of sound pixels in the map of defects
    #[arg(long, value_name = "N", default_value_t = 0.01)]
    pub false_alarms: f64,
    /// JSON document of the camera, to which the map is added
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Write the camera's document with the map to this file, for --camera of fit, compare and tune, and for sessions
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The answer as JSON.
#[derive(Serialize)]
struct Pixels<'a> {
    frames: usize,
    hot: usize,
    dead: usize,
    noisy: usize,
    columns: usize,
    rows: usize,
    /// Expected number of sound pixels among the defects.
    false_alarms: f64,
    /// Detection threshold, in standard deviations of the sound pixels.
    deviations: f64,
    camera: &'a Camera,
}

/// Searches all frames and prints the defects.
pub fn pixels(args: &PixelsArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if !(args.false_alarms > 0.0 && args.false_alarms <= 100.0) {
        return Err(Failure::Usage("--false-alarms must be more than 0, and 100 at most".into()));
    }
    let camera = offline::camera(args.camera.as_deref())?;
    let found = found(args)?;
    let camera = Camera { defect_map: Some(found.map.clone()), ..camera };
    if let Some(path) = &args.out {
        let text = serde_json::to_string(&camera).map_err(Failure::other)? + "\n";
        output::file(path, text.as_bytes())?;
    }
    if args.json {
        let FoundDefects { frames, hot, dead, noisy, deviations, ref map, .. } = found;
        let (columns, rows, false_alarms) = (map.columns.len(), map.rows.len(), args.false_alarms);
        let camera = &camera;
        return output::json(
            out,
            &Pixels { frames, hot, dead, noisy, columns, rows, false_alarms, deviations, camera },
        );
    }
    writeln!(out, "{}", sentence(args, &found)).map_err(Failure::output)?;
    if args.out.is_none() {
        writeln!(out, "--out FILE writes the camera's document with the map").map_err(Failure::output)?;
    }
    Ok(())
}

fn found(args: &PixelsArgs) -> Result<FoundDefects, Failure> {
    let scene = if args.dark { DefectScene::Dark } else { DefectScene::Running };
    let kinds = if args.mosaic { PixelKinds::Mosaic } else { PixelKinds::One };
    let options = DefectOptions { scene, kinds, false_alarms: args.false_alarms };
    let mut measurement = DefectMeasurement::new(options);
    let refused = |path: &Path, fault: DefectFault| Failure::Other(format!("{}: {fault}", path.display()));
    for path in args.frames.iter().chain(&args.folder) {
        let mut recording = Recording::open(path).map_err(Failure::other)?;
        while let Some(captured) = recording.next().map_err(Failure::other)? {
            measurement.add(&captured.frame).map_err(|fault| refused(path, fault))?;
        }
    }
    measurement.finish().map_err(|fault| {
        let first = args.frames.iter().chain(&args.folder).next();
        refused(first.map_or(Path::new("frames"), PathBuf::as_path), fault)
    })
}

/// Summary: the defects found and the threshold.
fn sentence(args: &PixelsArgs, found: &FoundDefects) -> String {
    let FoundDefects { map, hot, dead, noisy, frames, deviations, tells_noisy } = found;
    let lines = |name: &str, numbers: &[u32]| match numbers.len() {
        0 => format!("no {name}s"),
        1..=8 => {
            let numbers: Vec<String> = numbers.iter().map(u32::to_string).collect();
            format!("{}{} {}", name, if numbers.len() > 1 { "s" } else { "" }, numbers.join(", "))
        }
        more => format!("{more} {name}s"),
    };
    let noisy = if *tells_noisy { format!("{noisy} noisy") } else { "noisy ones not looked for".to_string() };
    format!(
        "{} × {} px, {frames} frames: {hot} hot, {dead} dead, {noisy}; {}, {}\n\
         beyond {deviations:.1} standard deviations of the sound ones, of which {} may be among them{}",
        map.width,
        map.height,
        lines("column", &map.columns),
        lines("row", &map.rows),
        args.false_alarms,
        if *tells_noisy { "" } else { "; 8 dark frames and more show noisy ones as well" },
    )
}
