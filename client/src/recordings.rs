//! `isophote recording list|get|remove`: finished recordings of the service.

use std::io::Write;
use std::path::{Path, PathBuf};

use isophote_wire::{Items, RecordedFile};
use serde_json::json;

use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::output::{self, NewFile};

/// List the recordings that are finished
#[derive(Clone, Debug, clap::Args)]
pub struct ListRecordingsArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Download a recording; the file appears when all of it has arrived
#[derive(Clone, Debug, clap::Args)]
pub struct GetRecordingArgs {
    /// The recording, as `isophote recording list` shows it
    pub name: String,
    /// The file to write, which is replaced if it is there [default: NAME in this folder]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Delete a recording from the service
#[derive(Clone, Debug, clap::Args)]
pub struct RemoveRecordingArgs {
    /// The recording, as `isophote recording list` shows it
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

fn path(name: &str) -> String {
    format!("/v1/recordings/{}", segment(name))
}

/// Lists all.
pub fn list(args: &ListRecordingsArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let recordings: Items<RecordedFile> = RemoteService::new(&args.service)?.get("/v1/recordings")?;
    if args.service.json {
        return output::json(out, &recordings);
    }
    let row = |recorded: &RecordedFile| vec![recorded.file.clone(), recorded.bytes.to_string()];
    let rows: Vec<Vec<String>> = recordings.items.iter().map(row).collect();
    output::table(out, &["FILE", "BYTES"], &rows)
}

/// Downloads one.
pub fn get(args: &GetRecordingArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let own = || Path::new(&args.name).file_name().map(PathBuf::from);
    let wrong =
        || Failure::Usage(format!("`{}` is no name of a recording; `isophote recording list` shows them", args.name));
    let place = args.out.clone().or_else(own).ok_or_else(wrong)?;
    let service = RemoteService::new(&args.service)?;
    // A file that cannot be written is an error before anything is sent.
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

/// Deletes one.
pub fn remove(args: &RemoveRecordingArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::remove(&args.service, &path(&args.name), &args.name, out)
}
