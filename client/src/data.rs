//! `isophote data export`: writes the documents of a running service to plain files.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use isophote_wire::{Items, ModelItem, SessionView, SourceView};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::failure::Failure;
use crate::http::{RemoteService, ServiceArgs, segment};
use crate::output;

/// Export all models, sources and sessions of the service to files
#[derive(Clone, Debug, clap::Args)]
pub struct DataExportArgs {
    /// New or empty folder; `isophote serve --models DIR/models` loads the models again
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Writes `models/NAME.toml` as sent, or `NAME.json`, `sources/NAME.json`, `sessions/NAME.json`.
pub fn export(args: &DataExportArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let service = RemoteService::new(&args.service)?;
    // Fetch everything before writing anything.
    let mut files = models(&service)?;
    let models = files.len();
    let sources: Items<SourceView> = service.get("/v1/sources")?;
    let sessions: Items<SessionView> = service.get("/v1/sessions")?;
    for source in &sources.items {
        files.push((format!("sources/{}.json", segment(&source.name)), pretty(&source.document)?));
    }
    for session in &sessions.items {
        files.push((format!("sessions/{}.json", segment(&session.name)), pretty(&session.document)?));
    }
    let shown = args.folder.display();
    if fs::read_dir(&args.folder).is_ok_and(|mut entries| entries.next().is_some()) || args.folder.is_file() {
        return Err(Failure::Other(format!("{shown} is there already, and nothing is overwritten; name a new folder")));
    }
    for (name, text) in &files {
        let path = args.folder.join(name);
        write(&path, text)
            .map_err(|error| Failure::Other(format!("{}: cannot be written: {error}", path.display())))?;
    }
    let (sources, sessions) = (sources.items.len(), sessions.items.len());
    if args.service.json {
        return output::json(out, &json!({"models": models, "sources": sources, "sessions": sessions}));
    }
    writeln!(out, "{models} models, {sources} sources and {sessions} sessions in {shown}").map_err(Failure::output)
}

/// File names and contents.
type Files = Vec<(String, String)>;

fn models(service: &RemoteService) -> Result<Files, Failure> {
    let models: Items<ModelItem> = service.get("/v1/models")?;
    let file = |model: &ModelItem| {
        let path = format!("/v1/models/{}", segment(&model.name));
        let text = service.get_text(&path, "application/toml, application/json;q=0.5")?;
        // Models sent as JSON are answered as JSON, with version and digest added.
        let Ok(mut document) = serde_json::from_str::<Map<String, Value>>(&text) else {
            return Ok((format!("models/{}.toml", segment(&model.name)), text));
        };
        document.remove("version");
        document.remove("digest");
        Ok((format!("models/{}.json", segment(&model.name)), pretty(&document)?))
    };
    models.items.iter().map(file).collect()
}

fn pretty(document: &impl Serialize) -> Result<String, Failure> {
    Ok(serde_json::to_string_pretty(document).map_err(Failure::other)? + "\n")
}

fn write(path: &Path, text: &str) -> std::io::Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::File::create_new(path)?.write_all(text.as_bytes())
}
