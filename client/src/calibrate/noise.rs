//! `isophote calibrate noise`: electrons per DN and the noise without light, from frames of a scene that stands still.

use std::io::Write;
use std::path::PathBuf;

use isophote_capture::{FrameSource, Recording};
use isophote_tracker::{Camera, MeasuredNoise, NoiseMeasurement, NoiseOptions};
use serde::Serialize;

use super::dark::Dark;
use crate::failure::Failure;
use crate::output::rounded;
use crate::{offline, output};

/// Measure a camera's noise: electrons per DN, the noise without light, and row noise; models with `noise` weight pixels by
/// them
///
/// Frames show one static scene with bright and dark parts, at the gain that is used later: every difference between frames counts
/// as noise.
#[derive(Clone, Debug, clap::Args)]
pub struct NoiseArgs {
    /// Folders or files of pictures, all of one size: at least two pictures, of which the first 64 are used
    #[arg(value_name = "FRAMES", required_unless_present = "folder")]
    pub frames: Vec<PathBuf>,
    /// Same as FRAMES
    #[arg(long = "frames", value_name = "PATH")]
    pub folder: Option<PathBuf>,
    /// Frames taken without light, for the black level [default: the black level of --camera, or 0]
    #[arg(long, value_name = "PATH")]
    pub dark: Option<PathBuf>,
    /// JSON document of the camera, to which the noise is added
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Write the camera's document to this file, for --camera of fit, compare and tune, and for sessions
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The answer as JSON; each figure with one standard deviation where it has one.
#[derive(Serialize)]
struct NoiseAnswer<'a> {
    frames: usize,
    electrons_per_dn: f64,
    electrons_per_dn_sigma: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    read_noise_e: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    read_noise_e_sigma: Option<f64>,
    /// Upper limit.
    read_noise_most_e: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    row_noise_e: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    row_noise_e_sigma: Option<f64>,
    black: f64,
    /// Range of the values used, DN.
    range: [f64; 2],
    reduced_chi_square: f64,
    /// Share of pixels that differed by more than noise.
    left_out: f64,
    camera: &'a Camera,
}

/// Measures all frames and prints the noise.
pub fn noise(args: &NoiseArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let known = offline::camera(args.camera.as_deref())?;
    let dark = args.dark.as_deref().map(Dark::of).transpose()?;
    let black = dark.map_or(known.black, |dark| dark.mean[0]);
    let known = Camera { black, ..known };
    let response = known.linear_response().map_err(|error| Failure::Usage(error.to_string()))?;
    let options = match response {
        None => NoiseOptions { black, saturation: known.saturation, rounding_gain: 0.0 },
        Some(_) => NoiseOptions { black: 0.0, saturation: None, rounding_gain: known.rounding_gain() },
    };
    let mut measurement = NoiseMeasurement::new(options);
    let paths = || args.frames.iter().chain(&args.folder);
    for path in paths() {
        let mut recording = Recording::open(path).map_err(Failure::other)?;
        while !measurement.is_full() {
            let Some(captured) = recording.next().map_err(Failure::other)? else { break };
            let frame = offline::linear(&known, response.as_ref(), &captured)?;
            let added = measurement.add(&frame);
            added.map_err(|fault| Failure::Other(format!("{}: {fault}", path.display())))?;
        }
    }
    let first = paths().next().map(|path| path.display().to_string()).unwrap_or_default();
    let found = measurement.finish().map_err(|fault| Failure::Other(format!("{first}: {fault}")))?;
    let camera = Camera {
        electrons_per_dn: Some(rounded(found.electrons_per_dn)),
        read_noise_e: found.read_noise_e.map(rounded).or(known.read_noise_e),
        row_noise_e: found.row_noise_e.map(rounded),
        ..known
    };
    if let Some(path) = &args.out {
        let text = serde_json::to_string(&camera).map_err(Failure::other)? + "\n";
        output::file(path, text.as_bytes())?;
    }
    if args.json {
        let [electrons_per_dn, electrons_per_dn_sigma] = found.electrons_per_dn;
        let MeasuredNoise { frames, range, reduced_chi_square, left_out, .. } = found;
        let (read_noise_e, read_noise_e_sigma) = found.read_noise_e.map(|[value, sigma]| (value, sigma)).unzip();
        let (row_noise_e, row_noise_e_sigma) = found.row_noise_e.map(|[value, sigma]| (value, sigma)).unzip();
        let answer = NoiseAnswer {
            frames,
            electrons_per_dn,
            electrons_per_dn_sigma,
            read_noise_e,
            read_noise_e_sigma,
            read_noise_most_e: found.read_noise_most_e,
            row_noise_e,
            row_noise_e_sigma,
            black,
            range,
            reduced_chi_square,
            left_out,
            camera: &camera,
        };
        return output::json(out, &answer);
    }
    writeln!(out, "{}", sentence(&found, black)).map_err(Failure::output)?;
    if args.out.is_none() {
        writeln!(out, "--out FILE writes the camera's document with them").map_err(Failure::output)?;
    }
    Ok(())
}

fn sentence(found: &MeasuredNoise, black: f64) -> String {
    let MeasuredNoise { frames, range: [darkest, brightest], reduced_chi_square, left_out, .. } = found;
    let with_sigma = |both: [f64; 2]| format!("{} ± {}", rounded(both), rounded([both[1], both[1]]));
    let read = match found.read_noise_e {
        Some(read) => format!("{} electrons without light", with_sigma(read)),
        None => format!("at most {:.1} electrons without light, too little to be told", found.read_noise_most_e),
    };
    let rows = found.row_noise_e.map(|rows| format!(", rows off by {} electrons", with_sigma(rows)));
    let rows = rows.unwrap_or_default();
    format!(
        "{} electrons per DN, noise of {read}{rows}\n\
         from {frames} frames, values of {darkest:.1} to {brightest:.1} DN, black level {black:.2} DN, χ²/ν of the line \
         {reduced_chi_square:.2}, {:.2} % of the pixels left out",
        with_sigma(found.electrons_per_dn),
        100.0 * left_out,
    )
}
