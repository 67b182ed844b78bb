//! `isophote calibrate response`: a camera's black level, gamma and gain of each pixel, from an even field at several
//! light levels.

use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;

use isophote_capture::{FrameSource, Recording};
use isophote_tracker::{
    Camera, CameraResponse, GainMeasurement, MeasuredGains, MeasuredResponse, ResponseMeasurement, ResponseOptions,
};
use serde::Serialize;

use super::dark::Dark;
use crate::failure::Failure;
use crate::output::{rounded, with_deviation};
use crate::{offline, output};

/// Measure how pixel values depend on light: black level, gamma, and the gain of each pixel; fits and searches then use light
///
/// Frames show a steady, even field that fills them, such as a white wall or a screen out of focus, at three or more exposure times,
/// without clipping. Gamma follows from the growth of the values, gains from the differences between neighbouring pixels.
#[derive(Clone, Debug, clap::Args)]
pub struct ResponseArgs {
    /// Relative light of a field, such as its exposure time, and its frames; give at least three lights
    #[arg(long = "flat", value_name = "LIGHT=PATH", required = true)]
    pub flats: Vec<FlatArgument>,
    /// Frames taken without light, for the black level [default: that of --camera, else measured from fields at four or more lights]
    #[arg(long, value_name = "PATH")]
    pub dark: Option<PathBuf>,
    /// JSON document of the camera, to which the response is added
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Write the camera's document to this file, for --camera of fit, compare, render and the other calibrations, and for sessions
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Maximum share of values of dark frames that may be clipped at 0.
const CLIPPED_MAX: f64 = 1e-3;

/// `LIGHT=PATH`: an even field.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatArgument {
    light: f64,
    path: PathBuf,
}

impl FromStr for FlatArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<FlatArgument, String> {
        let (light, path) = text.split_once('=').ok_or("is not LIGHT=PATH, such as 0.5=flats/half")?;
        let light = light.trim().parse().map_err(|_| format!("`{light}` is no number: LIGHT=PATH"))?;
        Ok(FlatArgument { light, path: path.into() })
    }
}

/// The answer as JSON; each figure with one standard deviation where it has one.
#[derive(Serialize)]
struct ResponseAnswer<'a> {
    frames: usize,
    lights: usize,
    gamma: f64,
    gamma_sigma: f64,
    black: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    black_sigma: Option<f64>,
    /// Largest deviation of a field from the power law, relative to its light.
    off: f64,
    #[serde(flatten)]
    gains: Option<GainsAnswer>,
    camera: &'a Camera,
}

#[derive(Serialize)]
struct GainsAnswer {
    /// Standard deviation of the pixels' gains; 0 where they differ by no more than noise.
    nonuniformity: f64,
    nonuniformity_sigma: f64,
    /// Standard deviation of a gain of the map.
    gain_sigma: f64,
    /// Outlying pixels whose gain is left at 1.
    left_out: usize,
}

/// Reads all frames twice and prints the response.
pub fn response(args: &ResponseArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let known = offline::camera(args.camera.as_deref())?;
    let dark = args.dark.as_deref().map(Dark::of).transpose()?;
    // Where noise without light is clipped at 0 its mean is not the black level; a default black of 0 is not a stated
    // one.
    let dark = dark.filter(|dark| dark.clipped <= CLIPPED_MAX).map(|dark| dark.mean);
    let black = dark.map(rounded).or(Some(known.black).filter(|black| *black != 0.0));
    let mut measurement = ResponseMeasurement::new(ResponseOptions { black, saturation: known.saturation });
    let refused =
        |path: &PathBuf, fault: &dyn std::fmt::Display| Failure::Other(format!("{}: {fault}", path.display()));
    each(args, |flat, captured| {
        measurement.add(flat.light, &captured.frame).map_err(|fault| refused(&flat.path, &fault))
    })?;
    let found = measurement.finish().map_err(Failure::other)?;
    let found = MeasuredResponse { black: dark.unwrap_or(found.black), ..found };
    let black = black.unwrap_or_else(|| rounded(found.black));
    let response = CameraResponse { gamma: rounded(found.gamma), gains: None };
    let camera = Camera { black, saturation: Some(found.saturation), response: Some(response.clone()), ..known };
    let linear = camera.linear_response().map_err(Failure::other)?;
    let mut gains = linear.map(GainMeasurement::new);
    each(args, |_, captured| {
        gains.iter_mut().for_each(|gains| gains.add(&captured.frame));
        Ok(())
    })?;
    let gains = gains.and_then(GainMeasurement::finish);
    let map = gains.as_ref().and_then(|gains| gains.map.clone());
    let camera = Camera { response: Some(CameraResponse { gains: map, ..response }), ..camera };
    if let Some(path) = &args.out {
        let text = serde_json::to_string(&camera).map_err(Failure::other)? + "\n";
        output::file(path, text.as_bytes())?;
    }
    if args.json {
        let MeasuredResponse { gamma: [gamma, gamma_sigma], off, lights, frames, .. } = found;
        let gains =
            gains.map(|MeasuredGains { nonuniformity: [value, sigma], sigma: gain_sigma, left_out, .. }| GainsAnswer {
                nonuniformity: value,
                nonuniformity_sigma: sigma,
                gain_sigma,
                left_out,
            });
        let ([black, sigma], camera) = (found.black, &camera);
        let black_sigma = Some(sigma).filter(|sigma| *sigma > 0.0);
        let answer = ResponseAnswer { frames, lights, gamma, gamma_sigma, black, black_sigma, off, gains, camera };
        return output::json(out, &answer);
    }
    writeln!(out, "{}", sentence(&found, gains.as_ref())).map_err(Failure::output)?;
    if args.out.is_none() {
        writeln!(out, "--out FILE writes the camera's document with them").map_err(Failure::output)?;
    }
    Ok(())
}

/// All frames of all fields, in order.
fn each(
    args: &ResponseArgs,
    mut look: impl FnMut(&FlatArgument, &isophote_capture::Captured) -> Result<(), Failure>,
) -> Result<(), Failure> {
    for flat in &args.flats {
        let mut recording = Recording::open(&flat.path).map_err(Failure::other)?;
        while let Some(captured) = recording.next().map_err(Failure::other)? {
            look(flat, &captured)?;
        }
    }
    Ok(())
}

fn sentence(found: &MeasuredResponse, gains: Option<&MeasuredGains>) -> String {
    let MeasuredResponse { gamma: [gamma, gamma_sigma], black, saturation, off, lights, frames } = found;
    let gains = match gains {
        None => "gains of pixels not measured: that takes two pictures of one plane".to_string(),
        Some(MeasuredGains { map: None, nonuniformity: [_, most], .. }) => {
            format!("pixels differ by at most {:.2} % of their light, too little to be told", 100.0 * most)
        }
        Some(MeasuredGains { nonuniformity: [value, sigma], sigma: gain_sigma, left_out, .. }) => format!(
            "pixels differ by {} % of their light; each gain is known to {:.2} %, {left_out} far ones are left at 1",
            with_deviation(100.0 * value, Some(100.0 * sigma)),
            100.0 * gain_sigma,
        ),
    };
    format!(
        "gamma {}, black level {} DN, clipped at {saturation} DN\n{gains}\n\
         from {frames} frames in {lights} lights, each within {:.2} % of that power",
        with_deviation(*gamma, Some(*gamma_sigma)),
        with_deviation(black[0], Some(black[1])),
        100.0 * off,
    )
}
