//! The program `isophote`: results on standard output, messages on standard error, and an exit status, see
//! [`failure::EXIT_STATUS`].
//!
//! `fit`, `render`, `tune`, `compare` (except `--live`), `replay`, `calibrate`, `model check`, `model explain` and
//! `model export` need no service; `serve` is the service; the others are its clients, of which `cameras` and `camera`
//! fall back to this machine.

mod arguments;
mod calibrate;
mod cameras;
mod compare;
mod compare_live;
#[cfg(feature = "serve")]
mod configuration;
mod connection;
mod data;
mod export;
mod failure;
mod fit;
mod http;
#[cfg(feature = "serve")]
mod log;
mod manual;
mod model_files;
mod models;
mod offline;
mod output;
mod overlay;
mod profile;
mod record;
mod recordings;
mod render;
mod replay;
mod samples;
mod scatter;
#[cfg(feature = "serve")]
mod serve;
mod sessions;
mod shadow;
mod source_uri;
mod sources;
mod targets;
#[cfg(feature = "serve")]
mod token;
mod tune;
mod watch;

use std::io::Write;
use std::process::ExitCode;

#[cfg(feature = "serve")]
use clap::FromArgMatches;
use clap::{CommandFactory, Parser, Subcommand};

use failure::Failure;
use output::StandardOutput;

/// Track targets in camera frames: fit a model formula, differentiated symbolically and compiled to native code
#[derive(Parser)]
#[command(version, propagate_version = true, after_help = failure::EXIT_STATUS)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[cfg(feature = "serve")]
    Serve(serve::ServeArgs),
    /// Create, list and revoke access tokens of a service
    #[cfg(feature = "serve")]
    #[command(subcommand)]
    Token(token::TokenCommand),
    /// Show the configuration of `serve`
    #[cfg(feature = "serve")]
    #[command(subcommand)]
    Config(ConfigCommand),
    /// Check, explain and export model files; manage models of the service
    #[command(subcommand)]
    Model(ModelCommand),
    /// Manage sessions of the service
    #[command(subcommand)]
    Session(SessionCommand),
    /// Manage sources of the service
    #[command(subcommand)]
    Source(SourceCommand),
    Watch(watch::WatchArgs),
    Record(record::RecordArgs),
    Replay(replay::ReplayArgs),
    /// List, download and delete recordings of the service
    #[command(subcommand)]
    Recording(RecordingCommand),
    /// Export the data of the service
    #[command(subcommand)]
    Data(DataCommand),
    Cameras(cameras::ListCamerasArgs),
    /// Control a camera of the service's machine
    #[command(subcommand)]
    Camera(CameraCommand),
    Fit(fit::FitArgs),
    Render(render::RenderArgs),
    Tune(tune::TuneArgs),
    Compare(compare::CompareArgs),
    /// Measure properties of a camera or a target
    #[command(subcommand)]
    Calibrate(CalibrateCommand),
    Completions(manual::CompletionsArgs),
    Man(manual::ManArgs),
}

#[cfg(feature = "serve")]
#[derive(Subcommand)]
enum ConfigCommand {
    Show(configuration::ShowArgs),
}

#[derive(Subcommand)]
enum DataCommand {
    Export(data::DataExportArgs),
}

#[derive(Subcommand)]
enum CameraCommand {
    Set(cameras::SetArgs),
}

#[derive(Subcommand)]
enum CalibrateCommand {
    Colours(calibrate::ColoursArgs),
    Model(calibrate::ModelArgs),
    Noise(calibrate::NoiseArgs),
    Pixels(calibrate::PixelsArgs),
    Response(calibrate::ResponseArgs),
    Profile(profile::ProfileArgs),
}

#[derive(Subcommand)]
enum ModelCommand {
    Check(model_files::CheckArgs),
    Explain(model_files::ExplainArgs),
    Export(export::ExportArgs),
    Push(models::PushArgs),
    List(models::ListModelsArgs),
    Show(models::ModelNameArgs),
    /// List the versions of a model, newest first
    History(models::ModelNameArgs),
    Rollback(models::RollbackArgs),
    /// Remove a model from the service
    Remove(models::ModelNameArgs),
}

#[derive(Subcommand)]
enum SessionCommand {
    Start(Box<sessions::StartArgs>),
    List(sessions::ListSessionsArgs),
    /// Show a session with its document and its last estimate
    Show(sessions::SessionNameArgs),
    Swap(sessions::SwapArgs),
    Shadow(shadow::ShadowArgs),
    /// Stop and remove a session
    Stop(sessions::SessionNameArgs),
}

#[derive(Subcommand)]
enum RecordingCommand {
    List(recordings::ListRecordingsArgs),
    Get(recordings::GetRecordingArgs),
    Remove(recordings::RemoveRecordingArgs),
}

#[derive(Subcommand)]
enum SourceCommand {
    Put(sources::PutSourceArgs),
    List(sources::ListSourcesArgs),
    /// Show a source with its document and its state
    Show(sources::SourceNameArgs),
    /// Stop and remove a source that no session uses
    Remove(sources::SourceNameArgs),
    Scene(sources::SceneArgs),
    Play(sources::PlayArgs),
}

fn main() -> ExitCode {
    let mut out = StandardOutput::new();
    let done = run_line(&mut out).and_then(|()| out.flush().map_err(Failure::output));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) if out.is_unread() => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("{failure}");
            ExitCode::from(failure.status())
        }
    }
}

/// Wrong usage exits with status 2.
#[cfg(feature = "serve")]
fn run_line(out: &mut dyn Write) -> Result<(), Failure> {
    let (matches, settings) = configuration::matches(command_line(), std::env::args_os().collect())?;
    run(&Arguments::from_arg_matches(&matches).map_err(Failure::other)?.command, &settings, out)
}

/// Wrong usage exits with status 2.
#[cfg(not(feature = "serve"))]
fn run_line(out: &mut dyn Write) -> Result<(), Failure> {
    run(&Arguments::parse().command, &(), out)
}

/// All commands, with the variables that set options of `serve`.
#[cfg(feature = "serve")]
fn command_line() -> clap::Command {
    configuration::with_variables(Arguments::command())
}

/// All commands.
#[cfg(not(feature = "serve"))]
fn command_line() -> clap::Command {
    Arguments::command()
}

/// The settings of `serve`, for `config show`.
#[cfg(feature = "serve")]
type Settings = Vec<configuration::Setting>;
#[cfg(not(feature = "serve"))]
type Settings = ();

#[cfg_attr(not(feature = "serve"), allow(unused_variables))] // nothing is configurable
fn run(command: &Command, settings: &Settings, out: &mut dyn Write) -> Result<(), Failure> {
    match command {
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::run(args, out),
        #[cfg(feature = "serve")]
        Command::Token(command) => token::run(command, out),
        #[cfg(feature = "serve")]
        Command::Config(ConfigCommand::Show(args)) => configuration::show(args, settings, out),
        Command::Model(ModelCommand::Check(args)) => model_files::check(args, out),
        Command::Model(ModelCommand::Explain(args)) => model_files::explain(args, out),
        Command::Model(ModelCommand::Export(args)) => export::run(args, out),
        Command::Model(ModelCommand::Push(args)) => models::push(args, out),
        Command::Model(ModelCommand::List(args)) => models::list(args, out),
        Command::Model(ModelCommand::Show(args)) => models::show(args, out),
        Command::Model(ModelCommand::History(args)) => models::history(args, out),
        Command::Model(ModelCommand::Rollback(args)) => models::roll_back(args, out),
        Command::Model(ModelCommand::Remove(args)) => models::remove(args, out),
        Command::Session(SessionCommand::Start(args)) => sessions::start(args, out),
        Command::Session(SessionCommand::List(args)) => sessions::list(args, out),
        Command::Session(SessionCommand::Show(args)) => sessions::show(args, out),
        Command::Session(SessionCommand::Swap(args)) => sessions::swap(args, out),
        Command::Session(SessionCommand::Stop(args)) => sessions::stop(args, out),
        Command::Session(SessionCommand::Shadow(args)) => shadow::run(args, out),
        Command::Source(SourceCommand::Put(args)) => sources::put(args, out),
        Command::Source(SourceCommand::List(args)) => sources::list(args, out),
        Command::Source(SourceCommand::Show(args)) => sources::show(args, out),
        Command::Source(SourceCommand::Remove(args)) => sources::remove(args, out),
        Command::Source(SourceCommand::Scene(args)) => sources::scene(args, out),
        Command::Source(SourceCommand::Play(args)) => sources::play(args, out),
        Command::Watch(args) => watch::run(args, out),
        Command::Record(args) => record::run(args, out),
        Command::Replay(args) => replay::run(args, out),
        Command::Recording(RecordingCommand::List(args)) => recordings::list(args, out),
        Command::Recording(RecordingCommand::Get(args)) => recordings::get(args, out),
        Command::Recording(RecordingCommand::Remove(args)) => recordings::remove(args, out),
        Command::Data(DataCommand::Export(args)) => data::export(args, out),
        Command::Cameras(args) => cameras::list(args, out),
        Command::Camera(CameraCommand::Set(args)) => cameras::set(args, out),
        Command::Fit(args) => fit::run(args, out),
        Command::Render(args) => render::run(args, out),
        Command::Tune(args) => tune::run(args, out),
        Command::Compare(args) => compare::run(args, out),
        Command::Calibrate(CalibrateCommand::Colours(args)) => calibrate::colours(args, out),
        Command::Calibrate(CalibrateCommand::Model(args)) => calibrate::model(args, out),
        Command::Calibrate(CalibrateCommand::Noise(args)) => calibrate::noise(args, out),
        Command::Calibrate(CalibrateCommand::Pixels(args)) => calibrate::pixels(args, out),
        Command::Calibrate(CalibrateCommand::Response(args)) => calibrate::response(args, out),
        Command::Calibrate(CalibrateCommand::Profile(args)) => profile::run(args, out),
        Command::Completions(args) => manual::completions(args, command_line(), out),
        Command::Man(args) => manual::man(args, command_line(), out),
    }
}
