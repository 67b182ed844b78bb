//! `isophote record`: a session of the service is recorded, and the file fetched.
//!
//! The service writes, in the folder that its operator gave it; so nothing is lost on the way, however slow that is. The file is
//! fetched when the recording has ended, and deleted there.

use std::io::Write;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use isophote_wire::{RecordDocument, RecordedFrames, RecordingState, RecordingView};

use crate::failure::Failure;
use crate::http::{RemoteService, ServiceArgs, segment};
use crate::output;

/// Between looks at how far it is.
const INTERVAL: Duration = Duration::from_millis(200);

/// Record a session into an MCAP file, until Ctrl-C, or as long as --seconds and --count say
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    /// The session
    pub session: String,
    /// The file to write
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// For so long
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// Until so many frames are fitted
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// What is kept of the pixels
    #[arg(long, value_enum, default_value_t = FramesArgument::Raw)]
    pub frames: FramesArgument,
    /// 10⁶ bytes at most
    #[arg(long, value_name = "MB", default_value_t = 4000)]
    pub budget_mb: u64,
    /// Leave the file in the service's folder as well
    #[arg(long)]
    pub keep: bool,
    #[command(flatten)]
    service: ServiceArgs,
}

/// What is kept of the pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FramesArgument {
    /// All, as they are: fits can be repeated bit for bit.
    Raw,
    /// Pictures of 8 bits, which lose something.
    Jpeg,
    /// None.
    None,
}

/// `isophote record`.
pub fn run(args: &RecordArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if args.seconds.is_some_and(|seconds| !(seconds > 0.0 && seconds < 1e9)) || args.count == Some(0) {
        return Err(Failure::Usage("--seconds and --count are more than 0".into()));
    }
    let (_listening, interrupted) = interrupts(args)?;
    // Before anything is recorded: a file that cannot be written is said at once.
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

/// Until what was asked for is recorded, somebody interrupts, or it ends by itself.
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

/// Ctrl-C, from now on; the sender keeps whoever waits from hearing an end that is none.
type Interrupts = (SyncSender<()>, Receiver<()>);

/// Listens for it.
#[cfg(feature = "serve")]
fn interrupts(_args: &RecordArgs) -> Result<Interrupts, Failure> {
    let (sender, heard) = sync_channel(1);
    let say = sender.clone();
    let mut signals = isophote_server::Signals::handle()
        .map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    let listen = move || {
        signals.wait();
        say.try_send(()).ok(); // it may be over
        signals.wait();
        // Whoever asks twice does not want to wait for the file.
        #[allow(clippy::disallowed_methods)] // there is nothing to tidy up: the service ends the recording by itself
        std::process::exit(130);
    };
    let thread = std::thread::Builder::new().name("interrupts".into()).spawn(listen);
    thread.map(|_| (sender, heard)).map_err(|error| Failure::Other(format!("no thread for signals: {error}")))
}

/// A program without the service hears no signals.
#[cfg(not(feature = "serve"))]
fn interrupts(args: &RecordArgs) -> Result<Interrupts, Failure> {
    if args.seconds.is_none() && args.count.is_none() {
        return Err(Failure::Usage("say how long: --seconds S or --count N".into()));
    }
    Ok(sync_channel(1))
}
