//! `isophote calibrate profile`: measures the profile of a target from frames, and writes a document that uses it.
//!
//! The model is fitted to every frame; each pixel then samples the profile at its distance from the fitted centre,
//! relative to the fitted background and brightness. All frames together sample it more finely than one. Fit and
//! measurement are repeated with the document that has the profile.

use std::collections::HashSet;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use isophote_jit::KernelCache;
use isophote_symbolic::{Model, ParameterId, Roles};
use isophote_tracker::{Camera, Estimate, Frame, MeasuredProfile, ProfileMeasurement, TrackState, TrackerOptions};
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::{model_files, offline, output};

/// Measure a target's profile from frames, and write a document that uses it instead of the formula
#[derive(Clone, Debug, clap::Args)]
pub struct ProfileArgs {
    /// Model document that fits roughly, with roles for centre, background and brightness (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Frames of the target, as for `isophote fit`; the sub-pixel positions of the centres should vary
    #[arg(long, value_name = "PATH")]
    pub frames: PathBuf,
    /// JSON document of the camera: `saturation`, required for frames with clipped pixels, and `defect_map`, whose pixels
    /// are excluded
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Radius up to which to measure the profile: in outlines if the roles have a shape, else in px [default: 3, or 12 px]
    #[arg(long, value_name = "S")]
    pub reach: Option<f64>,
    /// Number of samples of the profile
    #[arg(long, value_name = "N", default_value_t = 41, value_parser = clap::value_parser!(u16).range(8..=400))]
    pub samples: u16,
    /// File to write the document to
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Number of iterations: the first with the document's own formula, the others with the profile so far.
const ROUNDS: usize = 3;

/// Measures the profile and writes the document.
pub fn run(args: &ProfileArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let roles = roles(args, &model)?;
    let reach = args.reach.unwrap_or(if roles.shape.is_empty() { 12.0 } else { 3.0 });
    if !(reach > 0.0 && reach.is_finite()) {
        return Err(Failure::Usage("--reach is a distance above 0".into()));
    }
    let mut fitted = model.clone();
    let (mut text, mut noise) = (String::new(), OldNoise::Kept);
    let (mut profile, mut frames) = (None, 0);
    for _ in 0..ROUNDS {
        let measured = measure(args, &fitted, reach)?;
        frames = measured.1;
        let document = written(&model, &roles, &measured.0, reach);
        let found = document.map_err(|reason| Failure::Other(format!("{}: {reason}", args.model.display())))?;
        (text, fitted, noise) = (found.0, Arc::new(found.1), found.2);
        profile = Some(measured.0);
    }
    output::file(&args.out, text.as_bytes())?;
    if noise == OldNoise::LeftOut {
        let (from, to) = (args.model.display(), args.out.display());
        eprintln!(
            "warning: {to} has no `noise`: that of {from} reads definitions or parameters that are left out; write one without them"
        );
    }
    let Some(MeasuredProfile { pixels, errors, .. }) = profile else { return Ok(()) };
    let worst = errors.iter().copied().fold(0.0, f64::max);
    let line = format!("{}: {pixels} pixels of {frames} frames, standard errors up to {worst:.1e}", args.out.display());
    writeln!(out, "{line}").map_err(Failure::output)
}

/// The roles of the single target.
fn roles(args: &ProfileArgs, model: &Model) -> Result<Roles, Failure> {
    let wrong = |reason: &str| Failure::Usage(format!("{}: {reason}", args.model.display()));
    let [roles] = model.roles() else { return Err(wrong("a profile is measured of one target, with plain `[roles]`")) };
    if roles.centre.len() != 2 || roles.background.is_none() || roles.brightness.is_none() {
        return Err(wrong("the roles `centre` (of two), `background` and `brightness` say what to measure from"));
    }
    if model.channels().len() != 1 {
        return Err(wrong("a profile is measured in one channel"));
    }
    Ok(roles.clone())
}

/// Measures the profile on frames fitted with `model`; also returns the number of frames.
fn measure(args: &ProfileArgs, model: &Arc<Model>, reach: f64) -> Result<(MeasuredProfile, usize), Failure> {
    let camera = offline::camera(args.camera.as_deref())?;
    let mut usable = UsablePixels::of(&camera);
    let response = camera.linear_response().map_err(|error| Failure::Usage(error.to_string()))?;
    // The target is known to be there, and no document fits it yet: accept every fit.
    let options = TrackerOptions { camera: camera.clone(), confidence_min: 0.0, ..TrackerOptions::default() };
    let cache = Arc::new(KernelCache::default());
    let mut run = offline::OfflineRun::open(&args.model, model, &args.frames, None, (options, cache))?;
    let roles = roles(args, model)?;
    let mut measurement = ProfileMeasurement::new(reach, args.samples.into());
    let mut frames = 0;
    while let Some(captured) = run.next(model)? {
        // A fresh tracker per frame: the motion between frames does not matter.
        let estimate = run.tracker()?.track(&captured.frame);
        let is_whole = estimate.substitute.is_none_or(|substitute| substitute.is_marginal());
        if estimate.state == TrackState::Tracking && is_whole {
            if usable.saturation.is_none() && estimate.saturated > 0.0 {
                let message = "the target has clipped pixels, which say too little about its profile; \
                               say where the camera clips, so that they are left out: --camera with `saturation`";
                let number = captured.frame.sequence;
                return Err(Failure::Usage(format!("{}: frame {number}: {message}", args.frames.display())));
            }
            let frame = offline::linear(&camera, response.as_ref(), &captured)?;
            if response.is_some() {
                usable.saturation = frame.largest;
            }
            add(&mut measurement, &roles, &frame, &estimate, (reach, &usable));
            frames += 1;
        }
    }
    let profile = measurement.finish().ok_or_else(|| {
        let message = format!("{frames} frames show the target; together they do not show its profile");
        Failure::Other(format!("{}: {message} out to {reach}", args.frames.display()))
    })?;
    Ok((profile, frames))
}

/// Excludes defects and saturated pixels.
struct UsablePixels {
    saturation: Option<f64>,
    defects: HashSet<[u32; 2]>,
    columns: HashSet<u32>,
    rows: HashSet<u32>,
}

impl UsablePixels {
    fn of(camera: &Camera) -> UsablePixels {
        let map = camera.defect_map.clone().unwrap_or_default();
        UsablePixels {
            saturation: camera.saturation,
            defects: map.pixels.into_iter().collect(),
            columns: map.columns.into_iter().collect(),
            rows: map.rows.into_iter().collect(),
        }
    }

    fn has(&self, pixel: f64, x: usize, y: usize) -> bool {
        let (x, y) = (x as u32, y as u32);
        let is_defect = self.defects.contains(&[x, y]) || self.columns.contains(&x) || self.rows.contains(&y);
        !is_defect && self.saturation.is_none_or(|limit| pixel < limit)
    }
}

/// Adds the pixels of a frame.
fn add(
    measurement: &mut ProfileMeasurement,
    roles: &Roles,
    frame: &Frame,
    estimate: &Estimate,
    (reach, usable): (f64, &UsablePixels),
) {
    let value = |id: &ParameterId| estimate.parameters.get(id.index()).copied().unwrap_or(f64::NAN);
    let [bx, by] = [value(&roles.centre[0]), value(&roles.centre[1])];
    let [a1, a2, a3] = match roles.shape[..] {
        [a1, a2, a3] => [value(&a1), value(&a2), value(&a3)],
        _ => [1.0, 0.0, 1.0],
    };
    let (ground, height) = (roles.background.as_ref().map_or(0.0, value), roles.brightness.as_ref().map_or(1.0, value));
    let plane = frame.plane_view(0);
    let determinant = a1 * a3 - a2 * a2;
    // Half extent of the ellipse dᵀAd = reach² along each axis.
    let far = |across: f64| reach * (across / determinant).sqrt();
    let range = |centre: f64, far: f64, count: usize| {
        let last = (centre + far).min(count as f64 - 1.0);
        ((centre - far).max(0.0).ceil() as usize)..=(last.max(0.0) as usize)
    };
    for y in range(by, far(a1), plane.height()) {
        for x in range(bx, far(a3), plane.width()) {
            let pixel = plane.pixel(x, y);
            let (dx, dy) = (x as f64 - bx, y as f64 - by);
            let s = (a1 * dx * dx + 2.0 * a2 * dx * dy + a3 * dy * dy).sqrt();
            if usable.has(pixel, x, y) {
                measurement.add(s, (pixel - ground) / height, height * height);
            }
        }
    }
}

/// Whether the new document keeps the old one's `noise`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum OldNoise {
    /// Kept, or there was none.
    Kept,
    /// Dropped: it reads names that the new document lacks.
    LeftOut,
}

/// A document with the profile: the parameters of the roles, and everything of the old document that still applies.
fn written(
    model: &Model,
    roles: &Roles,
    profile: &MeasuredProfile,
    reach: f64,
) -> Result<(String, Model, OldNoise), String> {
    let checked = |noise: OldNoise| {
        let text = text(model, roles, profile, reach, noise);
        Model::from_toml(&text).map(|model| (text, model, noise))
    };
    let found = checked(OldNoise::Kept).or_else(|_| checked(OldNoise::LeftOut));
    found.map_err(|faults| faults.first().map_or_else(String::new, |fault| fault.message.clone()))
}

fn text(model: &Model, roles: &Roles, profile: &MeasuredProfile, reach: f64, noise: OldNoise) -> String {
    let document = model.document();
    let name = |id: &ParameterId| model.parameters()[id.index()].name.as_str();
    let optional = [&roles.background, &roles.brightness].into_iter().flatten();
    let used: Vec<&ParameterId> = roles.centre.iter().chain(&roles.shape).chain(optional).collect();
    let mut text =
        format!("name = {}\n", json!(format!("{}-measured", model.name().chars().take(55).collect::<String>())));
    let without = if noise == OldNoise::LeftOut {
        ", without its noise, which reads definitions or parameters of it"
    } else {
        ""
    };
    text += &format!("description = {}\n", json!(format!("{} with a measured profile{without}", model.name())));
    for key in ["coordinates", "channels"] {
        text += &format!("{key} = {}\n", document[key]);
    }
    let values: Vec<f64> = profile.values.iter().map(|value| (value * 1e6).round() / 1e6).collect();
    text += &format!(
        "\n[tables.profile]\nfirst = 0.0\nstep = {:?}\nvalues = {}\n\n[parameters]\n",
        profile.step,
        json!(values)
    );
    for parameter in model.parameters().iter().filter(|parameter| used.iter().any(|id| name(id) == parameter.name)) {
        text += &entry(&parameter.name, &document["parameters"][&parameter.name]);
    }
    text += "\n[roles]\n";
    for (key, value) in document["roles"].as_object().into_iter().flatten() {
        if ["centre", "shape", "background", "brightness"].contains(&key.as_str()) {
            text += &format!("{key} = {value}\n");
        }
    }
    if noise == OldNoise::Kept && document["model"].get("noise").is_some() {
        let constants = document["constants"].as_object().filter(|all| !all.is_empty());
        text += if constants.is_some() { "\n[constants]\n" } else { "" };
        text.extend(constants.into_iter().flatten().map(|(name, value)| entry(name, value)));
    }
    let [x, y] = [0, 1].map(|i| model.coordinates()[i].as_str());
    let [dx, dy] = [format!("({x} - {})", name(&roles.centre[0])), format!("({y} - {})", name(&roles.centre[1]))];
    let square = match roles.shape[..] {
        [a1, a2, a3] => {
            format!("{}*{dx}^2 + 2*{}*{dx}*{dy} + {}*{dy}^2 + 1e-9", name(&a1), name(&a2), name(&a3))
        }
        _ => format!("{dx}^2 + {dy}^2 + 1e-6"),
    };
    let word = |id: &Option<ParameterId>| id.as_ref().map_or("0", |id| name(id)).to_string();
    text += &format!("\n[definitions]\ndistance = \"sqrt({square})\"\n\n[model]\n");
    let (ground, height) = (word(&roles.background), word(&roles.brightness));
    text += &format!("intensity = '{ground} + {height} * table(\"profile\", distance)'\n");
    text += &format!("domain = \"distance <= {reach:?}\"\n");
    if let [a1, a2, a3] = &roles.shape[..] {
        text += &format!("constraint = \"{}*{} - {}^2 > 0\"\n", name(a1), name(a3), name(a2));
    }
    let kept: &[&str] = if noise == OldNoise::Kept { &["noise", "saturated"] } else { &["saturated"] };
    for key in kept {
        if let Some(value) = document["model"].get(key) {
            text += &entry(key, value);
        }
    }
    text
}

/// A line of TOML.
fn entry(name: &str, value: &Value) -> String {
    let inline = |value: &Value| match value {
        Value::Object(fields) => {
            let fields: Vec<String> = fields.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            format!("{{ {} }}", fields.join(", "))
        }
        value => value.to_string(),
    };
    format!("{} = {}\n", if name.is_ascii() { name.to_string() } else { json!(name).to_string() }, inline(value))
}
