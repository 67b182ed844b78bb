//! `isophote token new|list|revoke`: the tokens of a service on this machine. They work on its file; a running service sees the
//! change within a second.

use std::io::Write;
use std::path::PathBuf;

use clap::Subcommand;
use isophote_server::{Role, TokenError, TokenFile, TokenRecord};
use serde_json::json;

use crate::failure::Failure;
use crate::output;

/// What is done with tokens.
#[derive(Clone, Debug, Subcommand)]
pub enum TokenCommand {
    New(NewTokenArgs),
    List(ListTokensArgs),
    Revoke(RevokeArgs),
}

/// Make a token; it is printed this once, and nobody can find it out again
#[derive(Clone, Debug, clap::Args)]
pub struct NewTokenArgs {
    /// What it may do: view; operate, which runs sessions and sources as well; admin, which puts models as well
    #[arg(long, value_enum, default_value = "admin")]
    role: RoleArgument,
    /// To revoke it by [default: its role and a number]
    #[arg(long)]
    name: Option<String>,
    /// Whose it is: tenants have models, sources and sessions of their own, and do not see each other's
    #[arg(long, value_name = "NAME", default_value = "default")]
    tenant: String,
    #[command(flatten)]
    place: PlaceArgs,
}

/// List the tokens: names, roles, whose they are, since when
#[derive(Clone, Debug, clap::Args)]
pub struct ListTokensArgs {
    #[command(flatten)]
    place: PlaceArgs,
}

/// Revoke a token: a running service takes it no more within a second, and ends the streams that it opened
#[derive(Clone, Debug, clap::Args)]
pub struct RevokeArgs {
    /// The token's name
    name: String,
    #[command(flatten)]
    place: PlaceArgs,
}

/// Where tokens are kept
#[derive(Clone, Debug, clap::Args)]
struct PlaceArgs {
    /// The data folder of the service: tokens.json in it [default: ~/.config/isophote]
    #[arg(long, value_name = "DIR", conflicts_with = "tokens")]
    data: Option<PathBuf>,
    /// A file of its own
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What a token may do.
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

/// Does it.
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
