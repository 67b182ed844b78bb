//! `isophote source put|list|show|remove|scene|play`: sources of the service, their scenes and their playback.

use std::io::Write;
use std::path::PathBuf;

use isophote_capture::Moving;
use isophote_wire::{Items, PlaybackDocument, PlaybackView, SceneDocument, SceneView, SourceView};
use serde_json::Value;

use crate::arguments::{FormulaArgs, NumberArgs};
use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::{output, sessions, source_uri};

/// Create or replace a named source, which several sessions may share
#[derive(Clone, Debug, clap::Args)]
pub struct PutSourceArgs {
    /// Name of the source
    pub name: String,
    /// JSON source document (FILE.json or @FILE), or a URI as for `session start --source`
    #[arg(value_name = "FILE|URI")]
    pub source: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// A source by name
#[derive(Clone, Debug, clap::Args)]
pub struct SourceNameArgs {
    /// Name of the source
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// List the named sources
#[derive(Clone, Debug, clap::Args)]
pub struct ListSourcesArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Show or change the scene of a synthetic source, from the next frame on; values not given are kept
#[derive(Clone, Debug, clap::Args)]
pub struct SceneArgs {
    /// Name of the source
    pub name: String,
    /// Fixed values of parameters and constants
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub set: Vec<NumberArgs>,
    /// Moving parameters: formulas of t, seconds since the first frame
    #[arg(long, value_name = "k=FORMULA,…", allow_hyphen_values = true)]
    pub motion: Vec<FormulaArgs>,
    /// Factor on the light: a number or a formula of t
    #[arg(long, value_name = "FACTOR")]
    pub exposure: Option<Moving>,
    /// Gain of signal and noise: a number or a formula of t
    #[arg(long, value_name = "GAIN")]
    pub gain: Option<Moving>,
    /// Electrons at saturation; 0: no noise
    #[arg(long, value_name = "E")]
    pub full_well_e: Option<f64>,
    /// Standard deviation of the read noise, in electrons
    #[arg(long, value_name = "E")]
    pub read_noise_e: Option<f64>,
    /// Standard deviation of the noise that all pixels of a row share, in electrons
    #[arg(long, value_name = "E")]
    pub row_noise_e: Option<f64>,
    /// JSON file of glare, occluders, blindness, defocus and hot pixels, as `light` of a synthetic source
    #[arg(long, value_name = "FILE")]
    pub light: Option<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Show or change the playback of a recording or a synthetic source; frame numbers keep increasing
#[derive(Clone, Debug, clap::Args)]
pub struct PlayArgs {
    /// Name of the source
    pub name: String,
    /// Action [default: show the playback]
    #[arg(value_enum)]
    pub action: Option<PlayAction>,
    /// Value of the action. step: number of frames, in a recording also negative [default: 1]; seek: frame, counted from 0;
    /// speed: factor on the rate; loop: true or false
    #[arg(allow_hyphen_values = true)]
    pub value: Option<String>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Playback action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PlayAction {
    /// Pause
    Pause,
    /// Resume
    Resume,
    /// Pause and move by a number of frames
    Step,
    /// Continue from a frame; a synthetic source must be paused, and runs up to it
    Seek,
    /// Set the speed as a factor on the rate
    Speed,
    /// Set whether a recording begins again after its last frame
    Loop,
}

fn path(name: &str) -> String {
    format!("/v1/sources/{}", segment(name))
}

/// Puts a source document under a name.
pub fn put(args: &PutSourceArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let document = source_uri::own_document(&args.source)?;
    let view: Value = RemoteService::new(&args.service)?.put(&path(&args.name), &document)?;
    if args.service.json {
        return output::json(out, &view);
    }
    writeln!(out, "{} {}", args.name, view["state"].as_str().unwrap_or_default()).map_err(Failure::output)
}

/// Lists all sources.
pub fn list(args: &ListSourcesArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let service = RemoteService::new(&args.service)?;
    if args.service.json {
        return output::json(out, &service.get::<Value>("/v1/sources")?);
    }
    let sources: Items<SourceView> = service.get("/v1/sources")?;
    let row = |source: &SourceView| {
        vec![
            source.name.clone(),
            source.document.kind().to_string(),
            sessions::word(serde_json::to_value(source.state).ok()),
            source.frames.to_string(),
            source.sessions.to_string(),
            source.reason.clone().unwrap_or_default(),
        ]
    };
    let rows: Vec<Vec<String>> = sources.items.iter().map(row).collect();
    output::table(out, &["NAME", "KIND", "STATE", "FRAMES", "SESSIONS", ""], &rows)
}

/// Prints a source as JSON, with `--json` on one line.
pub fn show(args: &SourceNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::show::<SourceView>(&args.service, &path(&args.name), out)
}

/// Stops and removes a source.
pub fn remove(args: &SourceNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::remove(&args.service, &path(&args.name), &args.name, out)
}

/// Shows or changes a scene.
pub fn scene(args: &SceneArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let (service, path) = (RemoteService::new(&args.service)?, path(&args.name) + "/scene");
    let now: SceneView = service.get(&path)?;
    let set = NumberArgs::merged(&args.set).map_err(Failure::Usage)?;
    let motion = FormulaArgs::merged(&args.motion).map_err(Failure::Usage)?;
    let mut wanted = SceneDocument {
        exposure: args.exposure.clone(),
        gain: args.gain.clone(),
        full_well_e: args.full_well_e,
        read_noise_e: args.read_noise_e,
        row_noise_e: args.row_noise_e,
        light: match &args.light {
            Some(path) => serde_json::from_value(source_uri::read_json(path)?)
                .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?,
            None => None,
        },
        ..SceneDocument::default()
    };
    if !set.is_empty() || !motion.is_empty() {
        // Merge with the scene in force; a parameter that is set stops moving.
        let (mut still, mut moving) =
            (now.scene.set.clone().unwrap_or_default(), now.scene.motion.clone().unwrap_or_default());
        moving.retain(|name, _| !set.contains_key(name));
        still.extend(set);
        moving.extend(motion);
        (wanted.set, wanted.motion) = (Some(still), Some(moving));
    }
    let view = if wanted == SceneDocument::default() { now } else { service.put(&path, &wanted)? };
    if args.service.json {
        return output::json(out, &view);
    }
    writeln!(out, "since frame {}", view.since_frame).map_err(Failure::output)?;
    let moving = view.scene.motion.unwrap_or_default();
    let still = view.scene.set.unwrap_or_default().into_iter().filter(|(name, _)| !moving.contains_key(name));
    let mut rows: Vec<Vec<String>> = still.map(|(name, value)| vec![name, value.to_string()]).collect();
    rows.extend(moving.iter().map(|(name, formula)| vec![name.clone(), formula.clone()]));
    rows.sort();
    for (name, value) in [("exposure", view.scene.exposure), ("gain", view.scene.gain)] {
        rows.extend(value.map(|value| {
            let text = match value {
                Moving::Number(number) => number.to_string(),
                Moving::Formula(formula) => formula,
            };
            vec![name.to_string(), text]
        }));
    }
    let SceneDocument { full_well_e, read_noise_e, row_noise_e, .. } = view.scene;
    for (name, value) in [("full_well_e", full_well_e), ("read_noise_e", read_noise_e), ("row_noise_e", row_noise_e)] {
        rows.extend(value.map(|value| vec![name.to_string(), value.to_string()]));
    }
    output::table(out, &["NAME", "VALUE"], &rows)
}

fn read<T: std::str::FromStr>(value: Option<&str>, what: &str) -> Result<Option<T>, Failure> {
    let text = value.ok_or_else(|| Failure::Usage(format!("{what} is missing")))?;
    let wrong = |_| Failure::Usage(format!("`{text}` is not {what}"));
    text.parse().map(Some).map_err(wrong)
}

/// The playback document of an action.
fn wanted(action: PlayAction, value: Option<&str>) -> Result<PlaybackDocument, Failure> {
    let document = PlaybackDocument::default();
    Ok(match action {
        PlayAction::Pause | PlayAction::Resume if value.is_some() => {
            return Err(Failure::Usage("pause and resume take no value".into()));
        }
        // A step pauses the source first.
        PlayAction::Pause | PlayAction::Step => PlaybackDocument { paused: Some(true), ..document },
        PlayAction::Resume => PlaybackDocument { paused: Some(false), ..document },
        PlayAction::Seek => {
            PlaybackDocument { frame: read(value, "a frame counted from 0, as `seek` takes it")?, ..document }
        }
        PlayAction::Speed => PlaybackDocument { speed: read(value, "a number, as `speed` takes it")?, ..document },
        PlayAction::Loop => PlaybackDocument { repeat: read(value, "true or false, as `loop` takes it")?, ..document },
    })
}

/// Moves the position by `step` frames.
fn stepped(now: &PlaybackView, step: i64) -> Result<PlaybackDocument, Failure> {
    let at = now.frame.map_or(-1, |frame| frame as i64);
    let to = match now.length.map(|length| length as i64).filter(|length| *length > 0 && now.repeat == Some(true)) {
        Some(length) => at.saturating_add(step).rem_euclid(length),
        None => at.saturating_add(step),
    };
    let frame =
        u64::try_from(to).map_err(|_| Failure::Other(format!("there is no frame {to}: the first one is frame 0")))?;
    Ok(PlaybackDocument { frame: Some(frame), ..PlaybackDocument::default() })
}

/// Shows or changes the playback of a source.
pub fn play(args: &PlayArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let wanted = args.action.map(|action| wanted(action, args.value.as_deref())).transpose()?;
    let step = match args.action {
        Some(PlayAction::Step) => {
            read(args.value.as_deref().or(Some("1")), "a whole number of frames, as `step` takes it")?
        }
        _ => None,
    };
    let (service, path) = (RemoteService::new(&args.service)?, path(&args.name) + "/playback");
    let mut view: PlaybackView = match wanted {
        Some(wanted) => service.put(&path, &wanted)?,
        None => service.get(&path)?,
    };
    if let Some(step) = step {
        view = service.put(&path, &stepped(&view, step)?)?;
    }
    if args.service.json {
        return output::json(out, &view);
    }
    let state = if view.paused { "paused" } else { "playing" };
    let place = view.frame.map(|frame| format!(" at frame {frame}")).unwrap_or_default();
    let length = view.length.map(|length| format!(" of {length}")).unwrap_or_default();
    let round = if view.repeat == Some(true) { ", again and again" } else { "" };
    let PlaybackView { speed, next_frame, .. } = view;
    writeln!(out, "{state}{place}{length}, {speed} times its rate{round}; the next frame is number {next_frame}")
        .map_err(Failure::output)
}
