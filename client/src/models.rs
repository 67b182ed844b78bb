//! `isophote model push|list|show|history|rollback|remove`: models of the service.

use std::io::Write;
use std::path::PathBuf;

use isophote_wire::{Items, ModelAnswer, ModelItem, ProblemDocument, RollbackDocument, VersionItem, VersionList};

use crate::failure::Failure;
use crate::http::{self, Refusal, RemoteService, ServiceArgs, segment};
use crate::output;

/// Upload a model document to the service
#[derive(Clone, Debug, clap::Args)]
pub struct PushArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Name of the model on the service [default: the document's own]
    #[arg(long)]
    pub name: Option<String>,
    /// Replace the model only if this is its current version
    #[arg(long, value_name = "VERSION")]
    pub if_match: Option<String>,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Show the document of a model of the service
#[derive(Clone, Debug, clap::Args)]
pub struct ModelNameArgs {
    /// Name of the model
    pub name: String,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Make a stored version of a model the active one
#[derive(Clone, Debug, clap::Args)]
pub struct RollbackArgs {
    /// Name of the model
    pub name: String,
    /// Version, as listed by `isophote model history`
    #[arg(value_name = "VERSION")]
    pub to: u64,
    #[command(flatten)]
    service: ServiceArgs,
}

/// List the models of the service
#[derive(Clone, Debug, clap::Args)]
pub struct ListModelsArgs {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Sends a document.
pub fn push(args: &PushArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let file = args.model.display().to_string();
    let (text, is_json) = crate::model_files::text(&args.model)?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => crate::model_files::read(&args.model)?.name().to_string(),
    };
    let media = if is_json { "application/json" } else { "application/toml" };
    let tag = args.if_match.as_ref().map(|tag| format!("\"{}\"", tag.trim_matches('"')));
    let path = format!("/v1/models/{}", segment(&name));
    let answer = RemoteService::new(&args.service)?.put_text(&path, media, &text, tag.as_deref());
    let answer = answer.map_err(|refusal| match refusal {
        Refusal::Problem(problem) if is_wrong_model(&problem) => Failure::model(&file, &problem.diagnostics),
        other => other.into(),
    })?;
    let answer: ModelAnswer = http::read(&answer)?;
    crate::model_files::warn(&args.model, &answer.report);
    placed(&answer, &args.service, out)
}

/// Whether the document itself is wrong, not its name.
fn is_wrong_model(problem: &ProblemDocument) -> bool {
    !problem.diagnostics.is_empty() && problem.diagnostics.iter().all(|diagnostic| diagnostic.code != "wrong-name")
}

/// Prints the active version and the versions collected.
fn placed(answer: &ModelAnswer, service: &ServiceArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if service.json {
        return output::json(out, answer);
    }
    writeln!(out, "{} version {} {}", answer.name, answer.version, answer.report.digest).map_err(Failure::output)?;
    match answer.collected.as_slice() {
        [] => Ok(()),
        [one] => writeln!(out, "version {one} is not kept any more").map_err(Failure::output),
        [first, .., last] => writeln!(out, "versions {first} to {last} are not kept any more").map_err(Failure::output),
    }
}

/// Lists the versions of a model, newest first.
pub fn history(args: &ModelNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let path = format!("/v1/models/{}/versions", segment(&args.name));
    let versions: VersionList = RemoteService::new(&args.service)?.get(&path)?;
    if args.service.json {
        return output::json(out, &versions);
    }
    let row = |version: &VersionItem| {
        vec![
            version.version.to_string(),
            if version.active { "active" } else { "" }.to_string(),
            version.digest.chars().take("sha256:".len() + 12).collect(),
            version.bytes.to_string(),
            version.created_at.clone().unwrap_or_else(|| "-".into()),
        ]
    };
    let rows: Vec<Vec<String>> = versions.items.iter().map(row).collect();
    output::table(out, &["VERSION", "", "DIGEST", "BYTES", "PUT"], &rows)?;
    match versions.collected {
        0 => Ok(()),
        count => writeln!(out, "{count} older ones are not kept any more").map_err(Failure::output),
    }
}

/// Rolls back to a version.
pub fn roll_back(args: &RollbackArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let path = format!("/v1/models/{}:rollback", segment(&args.name));
    let document = RollbackDocument { version: args.to };
    let answer: ModelAnswer = RemoteService::new(&args.service)?.post(&path, &document)?;
    placed(&answer, &args.service, out)
}

/// Lists all models.
pub fn list(args: &ListModelsArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let models: Items<ModelItem> = RemoteService::new(&args.service)?.get("/v1/models")?;
    if args.service.json {
        return output::json(out, &models);
    }
    let row = |model: &ModelItem| {
        let digest = model.digest.chars().take("sha256:".len() + 12).collect();
        vec![
            model.name.clone(),
            model.version.to_string(),
            digest,
            model.parameters.join(","),
            model.description.clone(),
        ]
    };
    let rows: Vec<Vec<String>> = models.items.iter().map(row).collect();
    output::table(out, &["NAME", "VERSION", "DIGEST", "PARAMETERS", "DESCRIPTION"], &rows)
}

/// Prints a document as sent, or with `--json` in canonical form with version and digest.
pub fn show(args: &ModelNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let path = format!("/v1/models/{}", segment(&args.name));
    let accept = if args.service.json { "application/json" } else { "application/toml, application/json;q=0.5" };
    let text = RemoteService::new(&args.service)?.get_text(&path, accept)?;
    writeln!(out, "{}", text.trim_end()).map_err(Failure::output)
}

/// Removes a model.
pub fn remove(args: &ModelNameArgs, out: &mut dyn Write) -> Result<(), Failure> {
    http::remove(&args.service, &format!("/v1/models/{}", segment(&args.name)), &args.name, out)
}
