//! `isophote recording list|get|remove`: finished recordings of the service.

use std::io::Write;
use std::path::{Path, PathBuf};

use isophote_wire::{Items, RecordedFile};
use serde_json::json;

use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::output::{self, NewFile};

/// List the finished recordings
#[derive(Clone, Debug, clap::Args)]
pub struct ListRecordingsArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Download a recording; the file appears once it is complete
#[derive(Clone, Debug, clap::Args)]
pub struct GetRecordingArgs {
    /// Name of the recording, as listed by `isophote recording list`
    pub name: String,
    /// File to write, replaced if it exists [default: NAME in the current folder]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Delete a recording from the service
#[derive(Clone, Debug, clap::Args)]
pub struct RemoveRecordingArgs {
    /// Name of the recording, as listed by `isophote recording list`
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

fn path(name: &str) -> String {
    format!("/v1/recordings/{}", segment(name))
}

/// Lists all recordings.
pub fn list(args: &ListRecordingsArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let recordings: Items<RecordedFile> = RemoteService::new(&args.service)?.get("/v1/recordings")?;
    if args.service.json {
        return output::json(out, &recordings);
    }
    let row = |recorded: &RecordedFile| vec![recorded.file.clone(), recorded.bytes.to_string()];
    let rows: Vec<Vec<String>> = recordings.items.iter().map(row).collect();
    output::table(out, &["FILE", "BYTES"], &rows)
}

/// Downloads a recording.
pub fn get(args: &GetRecordingArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let own = || Path::new(&args.name).file_name().map(PathBuf::from);
    let wrong =
        || Failure::Usage(format!("`{}` is no name of a recording; `isophote recording list` shows them", args.name));
    let place = args.out.clone().or_else(own).ok_or_else(wrong)?;
    let service = RemoteService::new(&args.service)?;
    // Fail before any request if the file cannot be written.
    let mut file = NewFile::create(&place)?;
    let bytes = service.download(&path(&args.name), &mut file)?;
    file.finish()?;
    if args.service.json {
        return output::json(
            out,
            &json!({"recording": args.name, "file": place.display().to_string(), "bytes": bytes}),
        );
    }
    writeln!(out, "{}: {bytes} bytes", place.display()).map_err(Failure::output)
}

/// Deletes a recording.
pub fn remove(args: &RemoveRecordingArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::remove(&args.service, &path(&args.name), &args.name, out)
}
