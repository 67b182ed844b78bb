//! `isophote source put|list|show|remove|scene|play`: sources of the service, what they show, and how they go on while they run.

use std::io::Write;
use std::path::PathBuf;

use isophote_capture::Moving;
use isophote_wire::{Items, PlaybackDocument, PlaybackView, SceneDocument, SceneView, SourceView};
use serde_json::Value;

use crate::arguments::{FormulaArgs, NumberArgs};
use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::{output, sessions, source_uri};

/// Give a name to a source that several sessions may share, or replace the one of that name
#[derive(Clone, Debug, clap::Args)]
pub struct PutSourceArgs {
    /// The source's name
    pub name: String,
    /// FILE.json or @FILE, a JSON source document; or a URI, as `session start --source` takes it
    #[arg(value_name = "FILE|URI")]
    pub source: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Name a source
#[derive(Clone, Debug, clap::Args)]
pub struct SourceNameArgs {
    /// The source's name
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// List the sources that have a name
#[derive(Clone, Debug, clap::Args)]
pub struct ListSourcesArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Show or change what a synthetic source shows, from the next frame on; what is not named stays as it is
#[derive(Clone, Debug, clap::Args)]
pub struct SceneArgs {
    /// The source's name
    pub name: String,
    /// Parameters and constants that stand still from now on
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub set: Vec<NumberArgs>,
    /// Parameters that move: formulas of t, seconds since the first frame
    #[arg(long, value_name = "k=FORMULA,…", allow_hyphen_values = true)]
    pub motion: Vec<FormulaArgs>,
    /// So many times the light, a number or a formula of t
    #[arg(long, value_name = "FACTOR")]
    pub exposure: Option<Moving>,
    /// Amplifies what was read, light and noise alike; a number or a formula of t
    #[arg(long, value_name = "GAIN")]
    pub gain: Option<Moving>,
    /// Electrons at the saturation limit; 0: no noise
    #[arg(long, value_name = "E")]
    pub full_well_e: Option<f64>,
    /// Standard deviation of the read noise
    #[arg(long, value_name = "E")]
    pub read_noise_e: Option<f64>,
    /// Standard deviation of what all pixels of a row are off by together
    #[arg(long, value_name = "E")]
    pub row_noise_e: Option<f64>,
    /// Glare, occluders, blindness, defocus and hot pixels: JSON, as `light` of a synthetic source
    #[arg(long, value_name = "FILE")]
    pub light: Option<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Show how a recording or a synthetic source goes on, or change it; frames are counted on whatever is done
#[derive(Clone, Debug, clap::Args)]
pub struct PlayArgs {
    /// The source's name
    pub name: String,
    /// What it does from now on
    #[arg(value_enum)]
    pub action: Option<PlayAction>,
    /// How many frames `step` goes on (of a recording below 0 back; 1 if left out); the frame that `seek` goes to, counted from 0; how many times
    /// its rate `speed` is; whether `loop` begins again after the last frame, true or false
    #[arg(allow_hyphen_values = true)]
    pub value: Option<String>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// What a source is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PlayAction {
    /// Stand still
    Pause,
    /// Go on
    Resume,
    /// Stand still, so many frames further on
    Step,
    /// Go on with that frame; of a synthetic source, which has to stand still, go on to it
    Seek,
    /// Go so many times as fast as its rate
    Speed,
    /// Of a recording: whether it begins again
    Loop,
}

fn path(name: &str) -> String {
    format!("/v1/sources/{}", segment(name))
}

/// Puts a document under a name.
pub fn put(args: &PutSourceArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let document = source_uri::own_document(&args.source)?;
    let view: Value = RemoteService::new(&args.service)?.put(&path(&args.name), &document)?;
    if args.service.json {
        return output::json(out, &view);
    }
    writeln!(out, "{} {}", args.name, view["state"].as_str().unwrap_or_default()).map_err(Failure::output)
}

/// Lists all.
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

/// Prints one as JSON, with `--json` on one line.
pub fn show(args: &SourceNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::show::<SourceView>(&args.service, &path(&args.name), out)
}

/// Stops and removes one.
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
        // Those that are not named go on; what is to stand still moves no more.
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

/// What the action asks for.
fn wanted(action: PlayAction, value: Option<&str>) -> Result<PlaybackDocument, Failure> {
    let document = PlaybackDocument::default();
    Ok(match action {
        PlayAction::Pause | PlayAction::Resume if value.is_some() => {
            return Err(Failure::Usage("pause and resume take no value".into()));
        }
        // A step begins where the source stands still.
        PlayAction::Pause | PlayAction::Step => PlaybackDocument { paused: Some(true), ..document },
        PlayAction::Resume => PlaybackDocument { paused: Some(false), ..document },
        PlayAction::Seek => {
            PlaybackDocument { frame: read(value, "a frame counted from 0, as `seek` takes it")?, ..document }
        }
        PlayAction::Speed => PlaybackDocument { speed: read(value, "a number, as `speed` takes it")?, ..document },
        PlayAction::Loop => PlaybackDocument { repeat: read(value, "true or false, as `loop` takes it")?, ..document },
    })
}

/// The frame that is so many further on.
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

/// Shows or changes how a source goes on.
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
