//! `isophote record`: records a session of the service and downloads the file.
//!
//! The service writes into its operator's folder, so a slow connection loses nothing. The file is downloaded when the
//! recording has ended, and then deleted there unless `--keep`.

use std::io::Write;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use isophote_wire::{RecordDocument, RecordedFrames, RecordingState, RecordingView};

use crate::failure::Failure;
use crate::http::{RemoteService, ServiceArgs, segment};
use crate::output;

/// Polling interval.
const INTERVAL: Duration = Duration::from_millis(200);

/// Record a session into an MCAP file, until Ctrl-C, --seconds or --count
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    /// Name of the session
    pub session: String,
    /// MCAP file to write
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// Stop after this many seconds
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// Stop after this many fitted frames
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Pixels to record
    #[arg(long, value_enum, default_value_t = FramesArgument::Raw)]
    pub frames: FramesArgument,
    /// Maximum size, in units of 10⁶ bytes
    #[arg(long, value_name = "MB", default_value_t = 4000)]
    pub budget_mb: u64,
    /// Keep the file in the service's folder as well
    #[arg(long)]
    pub keep: bool,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Pixels to record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FramesArgument {
    /// All pixels, unchanged: fits can be repeated bit for bit.
    Raw,
    /// 8-bit JPEG, lossy.
    Jpeg,
    /// No pixels.
    None,
}

/// `isophote record`.
pub fn run(args: &RecordArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if args.seconds.is_some_and(|seconds| !(seconds > 0.0 && seconds < 1e9)) || args.count == Some(0) {
        return Err(Failure::Usage("--seconds and --count are more than 0".into()));
    }
    let (_listening, interrupted) = interrupts(args)?;
    // Fail before anything is recorded if the file cannot be written.
    let mut file = output::NewFile::create(&args.out)?;
    let service = RemoteService::new(&args.service)?;
    let path = format!("/v1/sessions/{}/recording", segment(&args.session));
    let frames = match args.frames {
        FramesArgument::Raw => RecordedFrames::Raw,
        FramesArgument::Jpeg => RecordedFrames::Jpeg,
        FramesArgument::None => RecordedFrames::None,
    };
    let document = RecordDocument { frames, disk_budget_mb: args.budget_mb, ..RecordDocument::default() };
    let _: RecordingView = service.put(&path, &document)?;
    eprintln!("record: {} is being recorded", args.session);
    let waited = wait(args, &service, &path, &interrupted);
    let view: Result<RecordingView, Failure> = service.get(&path);
    service.delete(&path)?;
    waited?;
    let view = view?;
    let Some(name) = view.files.last() else {
        return Err(Failure::Other("nothing was recorded: no frame came; is the session's source running?".into()));
    };
    let recorded = format!("/v1/recordings/{}", segment(name));
    let bytes = service.download(&recorded, &mut file)?;
    file.finish()?;
    if !args.keep {
        service.delete(&recorded)?;
    }
    if let (RecordingState::Ended | RecordingState::Failed, Some(reason)) = (view.state, &view.reason) {
        eprintln!("record: it ended early: {reason}");
    }
    if view.dropped > 0 {
        eprintln!("record: the disk was too slow for {} frames", view.dropped);
    }
    if args.service.json {
        return output::json(out, &view);
    }
    let (file, fits, frames) = (args.out.display(), view.fits, view.recorded_frames);
    writeln!(out, "{file}: {fits} fits, {frames} frames, {bytes} bytes").map_err(Failure::output)
}

/// Waits until `--seconds`, `--count`, an interrupt, or the end of the recording.
fn wait(args: &RecordArgs, service: &RemoteService, path: &str, interrupted: &Receiver<()>) -> Result<(), Failure> {
    let begin = Instant::now();
    loop {
        let left = args.seconds.map(|seconds| Duration::from_secs_f64(seconds).saturating_sub(begin.elapsed()));
        if left == Some(Duration::ZERO) {
            return Ok(());
        }
        if interrupted.recv_timeout(left.map_or(INTERVAL, |left| left.min(INTERVAL))).is_ok() {
            return Ok(());
        }
        let view: RecordingView = service.get(path)?;
        if view.state != RecordingState::Recording || args.count.is_some_and(|count| view.fits >= count) {
            return Ok(());
        }
    }
}

/// Interrupts from Ctrl-C; the sender keeps the channel open.
type Interrupts = (SyncSender<()>, Receiver<()>);

/// Handles SIGINT and SIGTERM.
#[cfg(feature = "serve")]
fn interrupts(_args: &RecordArgs) -> Result<Interrupts, Failure> {
    let (sender, heard) = sync_channel(1);
    let say = sender.clone();
    let mut signals = isophote_server::Signals::handle()
        .map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    let listen = move || {
        signals.wait();
        say.try_send(()).ok(); // the receiver may be gone
        signals.wait();
        // A second interrupt does not wait for the file.
        #[allow(clippy::disallowed_methods)] // nothing to clean up: the service ends the recording by itself
        std::process::exit(130);
    };
    let thread = std::thread::Builder::new().name("interrupts".into()).spawn(listen);
    thread.map(|_| (sender, heard)).map_err(|error| Failure::Other(format!("no thread for signals: {error}")))
}

/// Without the service feature signals are not handled.
#[cfg(not(feature = "serve"))]
fn interrupts(args: &RecordArgs) -> Result<Interrupts, Failure> {
    if args.seconds.is_none() && args.count.is_none() {
        return Err(Failure::Usage("say how long: --seconds S or --count N".into()));
    }
    Ok(sync_channel(1))
}
