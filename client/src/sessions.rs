//! `isophote session start|list|show|swap|stop`: sessions of the service.

use std::io::Write;
use std::path::PathBuf;

use isophote_symbolic::Diagnostic;
use isophote_wire::{Items, SessionView, SwapAnswer, SwapDocument};
use serde_json::{Map, Value, json};

use crate::arguments::{NumberArgs, PrecisionArgument, SizesArgument, WindowArgument};
use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::source_uri;
use crate::{offline, output};

/// Start a session, replacing any of the same name
#[derive(Clone, Debug, clap::Args)]
pub struct StartArgs {
    /// Name of the session
    pub name: String,
    /// Name of a model of the service
    #[arg(long)]
    pub model: String,
    /// Source of the frames: the name of a source of the service; @FILE, a JSON source document;
    /// synthetic:MODEL[?key=value&…]; a path or file:PATH[?rate_hz=30&loop=true], a recording; recording:PATH, one below the service's --recordings;
    /// /dev/video0[?format=GREY&width=640&height=480] or camera:IDENTITY, a camera; pushed:WIDTHxHEIGHT[?format=u8]
    #[arg(long, value_name = "URI|@FILE")]
    pub source: String,
    /// Starting values, replacing the document's
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub start: Vec<NumberArgs>,
    /// Values of the model's constants
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true)]
    pub constant: Vec<NumberArgs>,
    /// Fit only these pixels
    #[arg(long, value_name = "x,y,w,h")]
    pub window: Option<WindowArgument>,
    /// JSON document of the camera: saturation, black, electrons_per_dn, read_noise_e, row_noise_e, defects, defect_map,
    /// intrinsics; or a YAML file of OpenCV's calibration or ROS's camera_info
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// JSON document of the target: spots with positions and radii in mm; with the camera's intrinsics it yields poses
    #[arg(long, value_name = "FILE")]
    pub target: Option<PathBuf>,
    /// Minimum confidence, 0 to 1, to accept one of several candidates as the target; 0 accepts any [default: 0.5]
    #[arg(long, value_name = "P")]
    pub confidence_min: Option<f64>,
    /// Number of targets, each with the model's formula
    #[arg(long, value_name = "N")]
    pub targets: Option<usize>,
    /// Least signal-to-noise ratio of targets, 3 and above; confidence is then not asked
    #[arg(long, value_name = "SNR")]
    pub snr_min: Option<f64>,
    /// Sizes that targets may have: the geometric mean of their outline's half widths, px
    #[arg(long, value_name = "MIN,MAX")]
    pub sizes_px: Option<SizesArgument>,
    /// Arithmetic of the pixel loops [default: f32]
    #[arg(long, value_enum)]
    pub precision: Option<PrecisionArgument>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// A session by name
#[derive(Clone, Debug, clap::Args)]
pub struct SessionNameArgs {
    /// Name of the session
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// List the sessions
#[derive(Clone, Debug, clap::Args)]
pub struct ListSessionsArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Switch a running session to another model, between two frames
#[derive(Clone, Debug, clap::Args)]
pub struct SwapArgs {
    /// Name of the session
    pub name: String,
    /// Name of a model of the service
    pub model: String,
    /// Accept a model whose fits exceed the time limit of a frame; they then end with their best point so far
    #[arg(long)]
    pub allow_slow: bool,
    #[command(flatten)]
    service: ServiceArgs,
}

fn path(name: &str) -> String {
    format!("/v1/sessions/{}", segment(name))
}

/// Starts a session.
pub fn start(args: &StartArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let mut document = Map::new();
    document.insert("source".into(), source_uri::document(&args.source)?);
    document.insert("model".into(), json!(args.model));
    document.insert("start".into(), json!(NumberArgs::merged(&args.start).map_err(Failure::Usage)?));
    document.insert("constants".into(), json!(NumberArgs::merged(&args.constant).map_err(Failure::Usage)?));
    if let Some(WindowArgument(window)) = args.window {
        let mut fields = json!({"x": window.x, "y": window.y, "width": window.width, "height": window.height});
        // Unnamed axes are covered completely.
        for (axis, [first, count]) in [["z", "depth"], ["w", "length"]].into_iter().enumerate() {
            if window.slices.count[axis] < usize::MAX {
                fields[first] = json!(window.slices.first[axis]);
                fields[count] = json!(window.slices.count[axis]);
            }
        }
        let window = fields;
        document.insert("window".into(), window);
    }
    if let Some(path) = &args.camera {
        document.insert("camera".into(), offline::camera_document(path)?);
    }
    if let Some(path) = &args.target {
        document.insert("target".into(), source_uri::read_json(path)?);
    }
    let mut options = Map::new();
    if let Some(precision) = args.precision {
        options.insert("precision".into(), json!(isophote_symbolic::Precision::from(precision)));
    }
    let sizes_px = args.sizes_px.map(|sizes| json!(sizes.0));
    let given = [
        ("confidence_min", args.confidence_min.map(|value| json!(value))),
        ("targets", args.targets.map(|value| json!(value))),
        ("snr_min", args.snr_min.map(|value| json!(value))),
        ("sizes_px", sizes_px),
    ];
    options.extend(given.into_iter().filter_map(|(key, value)| Some((key.to_string(), value?))));
    if !options.is_empty() {
        document.insert("options".into(), options.into());
    }
    let view: Value = RemoteService::new(&args.service)?.put(&path(&args.name), &document)?;
    let warnings = serde_json::from_value(view["warnings"].clone()).unwrap_or_else(|_| Vec::<Diagnostic>::new());
    warnings.iter().for_each(|warning| eprintln!("{}", output::warning(&args.name, warning)));
    if args.service.json {
        return output::json(out, &view);
    }
    writeln!(out, "{} {}", args.name, view["state"].as_str().unwrap_or_default()).map_err(Failure::output)
}

/// Lists all sessions.
pub fn list(args: &ListSessionsArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let service = RemoteService::new(&args.service)?;
    if args.service.json {
        return output::json(out, &service.get::<Value>("/v1/sessions")?);
    }
    let sessions: Items<SessionView> = service.get("/v1/sessions")?;
    let row = |session: &SessionView| {
        let track = session.last.as_ref().and_then(|last| serde_json::to_value(last.state).ok());
        vec![
            session.name.clone(),
            word(serde_json::to_value(session.state).ok()),
            word(track),
            session.active_model.clone(),
            format!("{:.1}", session.rate_hz),
            session.frames.to_string(),
            session.dropped.to_string(),
            session.reason.clone().unwrap_or_default(),
        ]
    };
    let rows: Vec<Vec<String>> = sessions.items.iter().map(row).collect();
    output::table(out, &["NAME", "STATE", "TRACK", "MODEL", "HZ", "FRAMES", "DROPPED", ""], &rows)
}

/// The text of a JSON string, or a dash.
pub fn word(value: Option<Value>) -> String {
    value.and_then(|value| value.as_str().map(str::to_string)).unwrap_or_else(|| "-".into())
}

/// Prints a session as JSON, with `--json` on one line.
pub fn show(args: &SessionNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::show::<SessionView>(&args.service, &path(&args.name), out)
}

/// Swaps the model of a session.
pub fn swap(args: &SwapArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let document = SwapDocument { model: args.model.clone(), allow_slow: args.allow_slow };
    let answer: SwapAnswer =
        RemoteService::new(&args.service)?.put(&format!("{}/model", path(&args.name)), &document)?;
    swapped(&answer, &args.service, out)
}

/// Names separated by commas.
pub fn listed(names: &[String]) -> String {
    if names.is_empty() { "nothing".to_string() } else { names.join(", ") }
}

/// Prints the result of a swap.
pub fn swapped(answer: &SwapAnswer, service: &ServiceArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if service.json {
        return output::json(out, answer);
    }
    writeln!(
        out,
        "{} since frame {} (compiled in {:.1} ms); carried {}; reset {}",
        answer.active_model,
        answer.active_since_frame,
        answer.compile_ms,
        listed(&answer.carried),
        listed(&answer.reset)
    )
    .map_err(Failure::output)
}

/// Stops and removes a session.
pub fn stop(args: &SessionNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    RemoteService::new(&args.service)?.delete(&path(&args.name))?;
    if args.service.json { output::json(out, &json!({"stopped": args.name})) } else { Ok(()) }
}
