//! `isophote render`: renders any model to files, with the truth beside them.

use std::io::Write;
use std::path::{Path, PathBuf};

use isophote_capture::{
    Captured, FrameSource, Light, Moving, Recording, Synthetic, SyntheticError, SyntheticSpec, encode_png_planes,
    encode_tiff,
};
use isophote_symbolic::Model;
use isophote_tracker::Frame;
use serde::Serialize;

use crate::arguments::{FormulaArgs, NumberArgs, Size};
use crate::failure::Failure;
use crate::{model_files, offline};

/// Render a model to PNG files (TIFF for stacks), with sub-pixel sampling, motion, noise and saturation
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Values of parameters and constants; by default the target is in the middle of the frame, with a typical size and brightness
    #[arg(long, value_name = "k=v,…")]
    pub set: Vec<NumberArgs>,
    /// Folder for 000000.png, … and truth.jsonl; 000000.tiff for three coordinates, a folder 000000 of TIFF files for four
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Size of a frame in pixels, one number per coordinate of the model [default: 640x480, 64x64x32, 32x32x16x8]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// Number of frames
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: u64,
    /// Parameters as formulas of t, seconds since the first frame
    #[arg(long, value_name = "k=FORMULA,…")]
    pub motion: Vec<FormulaArgs>,
    /// Frames per second, for motion: frame n is at t = n / rate
    #[arg(long, value_name = "HZ", default_value_t = 60.0)]
    pub rate_hz: f64,
    /// Bits per pixel; more than 8 writes 16-bit files
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub bits: u32,
    /// Sub-pixel samples per side, along x and y
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub samples: u32,
    /// Electrons at saturation; 0: no noise [default: from --camera, else 0]
    #[arg(long, value_name = "E")]
    pub full_well_e: Option<f64>,
    /// Standard deviation of the read noise, in electrons [default: from --camera, else 0]
    #[arg(long, value_name = "E")]
    pub read_noise_e: Option<f64>,
    /// Standard deviation of the noise that all pixels of a row share, in electrons [default: from --camera, else 0]
    #[arg(long, value_name = "E")]
    pub row_noise_e: Option<f64>,
    /// JSON document of the simulated camera: saturation, electrons_per_dn, read_noise_e, row_noise_e; with a response, the model's
    /// intensity is light above the black level, and pixels have the values that this camera gives it
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Factor on the light: a number or a formula of t
    #[arg(long, value_name = "FACTOR", default_value = "1")]
    pub exposure: Moving,
    /// Gain of signal and noise, but not of the rounding: a number or a formula of t
    #[arg(long, value_name = "GAIN", default_value = "1")]
    pub gain: Moving,
    /// JSON file of glare, occluders, blindness, defocus and hot pixels, as `light` of a synthetic source
    #[arg(long, value_name = "FILE")]
    pub light: Option<PathBuf>,
    /// Pixel value at which pixels clip [default: from --camera, else the largest value of --bits, 255 for 8]
    #[arg(long, value_name = "DN")]
    pub saturation: Option<f64>,
    /// Seed of the noise; the same seed gives the same frames
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Also print the lines of truth.jsonl on standard output
    #[arg(long)]
    pub json: bool,
}

/// One line of truth.jsonl.
#[derive(Serialize)]
struct Truth<'a> {
    frame: u64,
    file: &'a str,
    /// s since the first frame.
    t: Option<f64>,
    parameters: &'a std::collections::BTreeMap<String, f64>,
}

/// Renders all frames.
pub fn run(args: &RenderArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let typical = SyntheticSpec::new(model.clone());
    let [width, height, depth, length] = sides(args, &typical)?;
    let seen_by = offline::camera(args.camera.as_deref())?;
    let largest = f64::from((1u32 << args.bits.clamp(1, 16)) - 1);
    let saturation = args.saturation.or(seen_by.saturation).unwrap_or(largest);
    // Without a response the model's background includes the black level.
    let black = if seen_by.response.is_some() { seen_by.black } else { 0.0 };
    let full_well_e = seen_by.electrons_per_dn.map(|electrons| electrons * (saturation - black));
    let spec = SyntheticSpec {
        set: NumberArgs::merged(&args.set).map_err(Failure::Usage)?,
        motion: FormulaArgs::merged(&args.motion).map_err(Failure::Usage)?,
        width,
        height,
        depth,
        length,
        rate_hz: args.rate_hz,
        bits: args.bits,
        samples: args.samples,
        full_well_e: args.full_well_e.or(full_well_e).unwrap_or(0.0),
        read_noise_e: args.read_noise_e.or(seen_by.read_noise_e).unwrap_or(0.0),
        row_noise_e: args.row_noise_e.or(seen_by.row_noise_e).unwrap_or(0.0),
        exposure: args.exposure.clone(),
        gain: args.gain.clone(),
        light: args.light.as_deref().map(read_light).transpose()?.unwrap_or_default(),
        saturation,
        black,
        response: seen_by.response,
        seed: args.seed,
        ..typical
    };
    let coordinates = spec.model.coordinates().len();
    check_channels(args, &spec.model)?;
    let mut camera = Synthetic::new(spec).map_err(|error| refused(&args.model, error))?;
    let failed = |path: &Path, error: &dyn std::fmt::Display| {
        Failure::Other(format!("{}: cannot be written: {error}", path.display()))
    };
    std::fs::create_dir_all(&args.out).map_err(|error| failed(&args.out, &error))?;
    let truth_path = args.out.join("truth.jsonl");
    let mut truth = std::fs::File::create(&truth_path).map_err(|error| failed(&truth_path, &error))?;
    for number in 0..args.frames {
        let captured = camera.next().map_err(|error| Failure::Other(error.to_string()))?;
        let Some(Captured { frame, truth: Some(parameters), .. }) = captured else { break };
        let file = write(&args.out, number, &frame)?;
        let line = Truth { frame: number, file: &file, t: frame.time_s, parameters: &parameters };
        let line = serde_json::to_string(&line).map_err(|error| failed(&truth_path, &error))?;
        writeln!(truth, "{line}").map_err(|error| failed(&truth_path, &error))?;
        if args.json {
            writeln!(out, "{line}").map_err(Failure::output)?;
        }
    }
    warn_of_strangers(args, coordinates);
    Ok(())
}

fn read_light(path: &Path) -> Result<Light, Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::Usage(format!("--light {}: {error}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| wrong(&error))?;
    serde_json::from_str(&text).map_err(|error| wrong(&error))
}

/// Files hold one channel, or the three of a colour picture.
fn check_channels(args: &RenderArgs, model: &Model) -> Result<(), Failure> {
    let (channels, coordinates) = (model.channels(), model.coordinates().len());
    let what = match channels.len() {
        1 => return Ok(()),
        3 if coordinates <= 2 => return Ok(()),
        _ if coordinates > 2 => "stacks are written with one channel",
        _ => "pictures are written with one channel or with three, red, green and blue",
    };
    let (file, names) = (args.model.display(), channels.join(", "));
    Err(Failure::Model(format!("error: {file}: it has the channels {names}; {what}")))
}

/// Pixels along x, y, z, w.
fn sides(args: &RenderArgs, typical: &SyntheticSpec) -> Result<[usize; 4], Failure> {
    let coordinates = typical.model.coordinates();
    let mut sides = [typical.width, typical.height, typical.depth, typical.length];
    let Some(Size(given)) = &args.size else { return Ok(sides) };
    // A one-dimensional frame is a picture of one row.
    if given.len() != coordinates.len() && (coordinates.len(), given.len()) != (1, 2) {
        let text: Vec<String> = given.iter().map(usize::to_string).collect();
        return Err(Failure::Usage(format!(
            "--size {} has {} numbers, the model {} coordinates: {}",
            text.join("x"),
            given.len(),
            coordinates.len(),
            coordinates.join(", ")
        )));
    }
    sides.iter_mut().zip(given).for_each(|(side, given)| *side = *given);
    Ok(sides)
}

/// Writes a frame and returns its name: a picture as PNG, a volume as a TIFF of its slices, a series as a folder of
/// volumes.
fn write(folder: &Path, number: u64, frame: &Frame) -> Result<String, Failure> {
    let failed = |path: &Path, error: &dyn std::fmt::Display| {
        Failure::Other(format!("{}: cannot be written: {error}", path.display()))
    };
    let [width, height, _, volumes] = frame.sides();
    let plane = &frame.planes()[0];
    let pixels = plane.buffer.bytes();
    let planes: Vec<&[u8]> = frame.planes().iter().map(|plane| plane.buffer.bytes()).collect();
    let save = |path: PathBuf, bytes: Result<Vec<u8>, isophote_capture::encode::EncodeError>| {
        let bytes = bytes.map_err(|error| failed(&path, &error))?;
        std::fs::write(&path, bytes).map_err(|error| failed(&path, &error))
    };
    let name = match frame.size().len() {
        0..=2 => format!("{number:06}.png"),
        3 => format!("{number:06}.tiff"),
        _ => format!("{number:06}"),
    };
    let path = folder.join(&name);
    match frame.size().len() {
        0..=2 => save(path, encode_png_planes(width, height, plane.format, &planes))?,
        3 => save(path, encode_tiff(width, height, plane.format, pixels))?,
        _ => {
            std::fs::create_dir_all(&path).map_err(|error| failed(&path, &error))?;
            for (volume, pixels) in pixels.chunks(pixels.len() / volumes).enumerate() {
                save(path.join(format!("{volume:06}.tiff")), encode_tiff(width, height, plane.format, pixels))?;
            }
        }
    }
    Ok(name)
}

/// A wrong name or number is wrong usage; a document that cannot be rendered is a wrong model.
fn refused(model: &Path, error: SyntheticError) -> Failure {
    match error {
        SyntheticError::Motion { name, diagnostics } => {
            let rendered: Vec<String> = diagnostics.iter().map(|d| d.render(&format!("--motion {name}"))).collect();
            Failure::Usage(format!("the motion of `{name}` is wrong\n{}", rendered.join("\n").trim_end()))
        }
        SyntheticError::Model { .. } => Failure::Model(format!("error: {}: {error}", model.display())),
        other => Failure::Usage(other.to_string()),
    }
}

/// Warns of frames left by an earlier, longer run.
fn warn_of_strangers(args: &RenderArgs, coordinates: usize) {
    let found = Recording::of_dimensions(&args.out, coordinates).map_or(0, |recording| recording.len() as u64);
    if found > args.frames {
        let (out, others) = (args.out.display(), found - args.frames);
        eprintln!("warning: {out} holds {others} frames more than were rendered; `isophote fit` will read them too");
    }
}
