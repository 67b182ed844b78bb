//! `isophote token new|list|revoke`: edits the token file of a service on this machine; a running service reloads it
//! within a second.

use std::io::Write;
use std::path::PathBuf;

use clap::Subcommand;
use isophote_server::{Role, TokenError, TokenFile, TokenRecord};
use serde_json::json;

use crate::failure::Failure;
use crate::output;

/// Edits the tokens of a service.
#[derive(Clone, Debug, Subcommand)]
pub enum TokenCommand {
    New(NewTokenArgs),
    List(ListTokensArgs),
    Revoke(RevokeArgs),
}

/// Create a token; it is printed once and cannot be recovered
#[derive(Clone, Debug, clap::Args)]
pub struct NewTokenArgs {
    /// Permissions: view; operate, which also runs sessions and sources; admin, which also puts models
    #[arg(long, value_enum, default_value = "admin")]
    role: RoleArgument,
    /// Name of the token, for `token revoke` [default: its role and a number]
    #[arg(long)]
    name: Option<String>,
    /// Tenant that owns the token; each tenant sees only its own models, sources and sessions
    #[arg(long, value_name = "NAME", default_value = "default")]
    tenant: String,
    #[command(flatten)]
    place: PlaceArgs,
}

/// List the tokens with their roles, tenants and creation times
#[derive(Clone, Debug, clap::Args)]
pub struct ListTokensArgs {
    #[command(flatten)]
    place: PlaceArgs,
}

/// Revoke a token; within a second, a running service rejects it and ends the streams that it opened
#[derive(Clone, Debug, clap::Args)]
pub struct RevokeArgs {
    /// Name of the token
    name: String,
    #[command(flatten)]
    place: PlaceArgs,
}

/// The token file
#[derive(Clone, Debug, clap::Args)]
struct PlaceArgs {
    /// Data folder of the service, which contains tokens.json [default: ~/.config/isophote]
    #[arg(long, value_name = "DIR", conflicts_with = "tokens")]
    data: Option<PathBuf>,
    /// Token file, instead of tokens.json in a folder
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Role of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum RoleArgument {
    View,
    Operate,
    Admin,
}

impl From<RoleArgument> for Role {
    fn from(argument: RoleArgument) -> Role {
        match argument {
            RoleArgument::View => Role::View,
            RoleArgument::Operate => Role::Operate,
            RoleArgument::Admin => Role::Admin,
        }
    }
}

impl PlaceArgs {
    fn file(&self) -> Result<TokenFile, Failure> {
        TokenFile::of(self.tokens.as_deref(), self.data.as_deref()).map_err(failure)
    }
}

fn failure(error: TokenError) -> Failure {
    match error {
        TokenError::WrongName(_) | TokenError::NoPlace => Failure::Usage(error.to_string()),
        TokenError::Unknown(_) => Failure::NotFound(error.to_string()),
        other => Failure::Other(other.to_string()),
    }
}

/// `isophote token`.
pub fn run(command: &TokenCommand, out: &mut dyn Write) -> Result<(), Failure> {
    match command {
        TokenCommand::New(args) => new(args, out),
        TokenCommand::List(args) => list(args, out),
        TokenCommand::Revoke(args) => revoke(args, out),
    }
}

fn new(args: &NewTokenArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let file = args.place.file()?;
    let (record, secret) = file.add_for(&args.tenant, args.role.into(), args.name.as_deref()).map_err(failure)?;
    let token = secret.text();
    if args.place.json {
        let TokenRecord { name, role, tenant, created, .. } = record;
        let answer = json!({"name": name, "role": role, "tenant": tenant, "created": created, "token": token});
        return output::json(out, &answer);
    }
    writeln!(out, "{token}").map_err(Failure::output)?;
    let TokenRecord { name, role, tenant, .. } = record;
    eprintln!("`{name}`, role {role}, tenant {tenant}, in {}; keep it: it is shown this once", file.path().display());
    Ok(())
}

fn list(args: &ListTokensArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let tokens = args.place.file()?.read().map_err(failure)?;
    if args.place.json {
        return output::json(out, &json!({"items": tokens}));
    }
    let row = |token: &TokenRecord| {
        let TokenRecord { name, role, tenant, created, .. } = token;
        vec![name.clone(), role.to_string(), tenant.clone(), created.clone()]
    };
    let rows: Vec<Vec<String>> = tokens.iter().map(row).collect();
    output::table(out, &["NAME", "ROLE", "TENANT", "CREATED"], &rows)
}

fn revoke(args: &RevokeArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let revoked = args.place.file()?.revoke(&args.name).map_err(failure)?;
    if args.place.json { output::json(out, &json!({"revoked": revoked.name})) } else { Ok(()) }
}
