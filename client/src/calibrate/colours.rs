//! `isophote calibrate colours`: the mixing matrix of a colour camera, from frames of its lights.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use isophote_capture::FrameSource;
use isophote_symbolic::Model;
use isophote_tracker::{Mixing, MixingError, MixingMeasurement};
use serde::Serialize;

use crate::failure::Failure;
use crate::output::with_deviation;
use crate::{model_files, offline, output};

/// Measure how much of each light every channel reads, from frames of one light at a time or of several lights apart
#[derive(Clone, Debug, clap::Args)]
pub struct ColoursArgs {
    /// Folder of pictures, or one picture, of each channel's light, alone or apart from the others
    #[arg(long, value_name = "PATH")]
    pub frames: PathBuf,
    /// Model document with these channels (TOML; JSON if named *.json)
    #[arg(long, value_name = "FILE")]
    pub model: PathBuf,
    /// JSON document of the camera, for its saturation and response
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The answer as JSON; rows are channels, columns are lights, both in the order of `channels`.
#[derive(Serialize)]
struct Colours<'a> {
    channels: &'a [String],
    mixing: &'a [Vec<f64>],
    standard_errors: &'a [Vec<f64>],
    pixels: &'a [usize],
    /// For `--constant`, as far as the model has them: `m_rg` is the share of g's light that r reads.
    constants: &'a BTreeMap<String, f64>,
}

/// Measures all frames and prints the mixing matrix.
pub fn colours(args: &ColoursArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let channels = model.channels();
    if channels.len() < 2 {
        let file = args.model.display();
        return Err(Failure::Usage(format!("{file} has one channel, {}: there is nothing to mix", channels.join(""))));
    }
    let mut recording = offline::recording(&args.frames, &model)?;
    let camera = offline::camera(args.camera.as_deref())?;
    let response = camera.linear_response().map_err(|error| Failure::Usage(error.to_string()))?;
    // With a response, linearised frames carry their own saturation.
    let saturation = camera.saturation.filter(|_| response.is_none());
    let mut measurement = MixingMeasurement::new(channels.len(), saturation);
    let refused =
        |error: MixingError| Failure::Other(format!("{}: {}", args.frames.display(), reason(&error, channels)));
    while let Some(captured) = recording.next().map_err(Failure::other)? {
        let frame = offline::linear(&camera, response.as_ref(), &captured)?;
        measurement.add(&frame).map_err(refused)?;
    }
    let mixing = measurement.finish().map_err(refused)?;
    let constants = constants(&model, &mixing);
    let answer = Colours {
        channels,
        mixing: &mixing.matrix,
        standard_errors: &mixing.errors,
        pixels: &mixing.pixels,
        constants: &constants,
    };
    if let Some(path) = &args.out {
        let text = serde_json::to_string_pretty(&answer).map_err(Failure::other)? + "\n";
        output::file(path, text.as_bytes())?;
    }
    if args.json {
        return output::json(out, &answer);
    }
    table(out, channels, &mixing)?;
    if !constants.is_empty() {
        let pairs: Vec<String> = constants.iter().map(|(name, value)| format!("{name}={value:.5}")).collect();
        writeln!(out, "--constant {}", pairs.join(",")).map_err(Failure::output)?;
    }
    Ok(())
}

/// One row per channel, one column per light.
fn table(out: &mut dyn Write, channels: &[String], mixing: &Mixing) -> Result<(), Failure> {
    let head: Vec<String> = channels.iter().map(|light| format!("LIGHT {light}")).collect();
    let head: Vec<&str> = ["CHANNEL"].into_iter().chain(head.iter().map(String::as_str)).collect();
    let cell = |(value, error): (&f64, &f64)| match *error > 0.0 {
        true => with_deviation(*value, Some(*error)),
        false => format!("{value}"),
    };
    let rows = channels.iter().zip(mixing.matrix.iter().zip(&mixing.errors));
    let rows = rows.map(|(channel, (values, errors))| {
        [channel.clone()].into_iter().chain(values.iter().zip(errors).map(cell)).collect()
    });
    output::table(out, &head, &rows.collect::<Vec<Vec<String>>>())
}

fn constants(model: &Model, mixing: &Mixing) -> BTreeMap<String, f64> {
    let channels = model.channels();
    let names = |row: usize, column: usize| format!("m_{}{}", channels[row], channels[column]);
    let all = mixing.matrix.iter().enumerate();
    let all = all.flat_map(|(row, values)| values.iter().enumerate().map(move |(column, v)| (names(row, column), *v)));
    all.filter(|(name, _)| model.constant(name).is_some()).collect()
}

/// Describes the fault of the frames and its remedy.
fn reason(error: &MixingError, channels: &[String]) -> String {
    match error {
        MixingError::Planes { found, .. } => {
            format!("a picture has {found} channels, the model {}: {}", channels.len(), channels.join(", "))
        }
        MixingError::NoLight { channel, seen } => {
            let counts = seen.iter().zip(channels).filter(|(count, _)| **count > 0);
            let counts: Vec<String> = counts.map(|(count, channel)| format!("{count} in {channel}")).collect();
            let seen = if counts.is_empty() { "nothing was found".to_string() } else { counts.join(", ") };
            format!(
                "no light is brightest in the channel {} ({seen}); either it is missing, or two lights have the same colour: \
                 show a light for each channel, alone or apart from the others",
                channels[*channel]
            )
        }
        MixingError::Clipped(light) => format!(
            "the light of the channel {} is clipped everywhere; expose less, or give it a soft edge (out of focus)",
            channels[*light]
        ),
        MixingError::SameColour(a, b) => format!(
            "the lights of the channels {} and {} have the same colour as far as this camera sees: they cannot be told apart",
            channels[*a], channels[*b]
        ),
        MixingError::TwoLights(light) => format!(
            "two lights of different colours are brightest in the channel {}; show one light for each channel",
            channels[*light]
        ),
        MixingError::Mixed(light) => format!(
            "what is brightest in the channel {} has more than one colour; lights must lie apart from each other, and \
             from others",
            channels[*light]
        ),
    }
}
