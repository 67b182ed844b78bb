//! `isophote serve`: the service in the foreground, until it is interrupted.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;

use isophote_server::{
    AccessOptions, HostName, Options, RecordingQuota, Server, Signals, StartError, StartFinding, Stopped, TlsFiles,
    check,
};
use serde_json::{Value, json};

use crate::arguments::VectorWidthArgument;
use crate::failure::Failure;
use crate::log::{Log, LogFormat, LogLevel};
use crate::output;

/// Run the service: models, sources, sessions and streams over HTTP
#[derive(Clone, Debug, clap::Args)]
pub struct ServeArgs {
    /// A TOML file with values for these options, `vector_width = "256"`; flags and the environment come before it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where to listen; off loopback with tokens and TLS; port 0 takes any free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7240")]
    pub listen: SocketAddr,
    /// Keep models, sources and sessions here; in memory only when absent
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Put the model documents of this folder under the names of their files (NAME.toml, NAME.json)
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// With a synthetic source and a running session, both named demo
    #[arg(long)]
    pub demo: bool,
    /// Bits of a vector; auto: what is fastest on this machine, measured at the start
    #[arg(long, value_enum, default_value_t = VectorWidthArgument::Auto)]
    pub vector_width: VectorWidthArgument,
    /// How the log on standard error looks
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    pub log: LogFormat,
    /// What it says
    #[arg(long, value_enum, default_value_t = LogLevel::Info)]
    pub log_level: LogLevel,
    /// Say whether the service could start, and start nothing: address, data folder, and whether code may be compiled and run
    #[arg(long)]
    pub check: bool,
    /// One JSON object: what --check found, or the settings of `config show`
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    access: AccessArgs,
}

/// Who may use the service, and how they reach it
#[derive(Clone, Debug, clap::Args)]
struct AccessArgs {
    /// Ask for a token on loopback, too; elsewhere that is always so
    #[arg(long)]
    require_token: bool,
    /// Ask for one of the tokens of this file [default: tokens.json in the data folder, else in ~/.config/isophote]
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Encrypt: the service's certificate, PEM
    #[arg(long, value_name = "FILE")]
    tls_cert: Option<PathBuf>,
    /// The certificate's key, PEM
    #[arg(long, value_name = "FILE")]
    tls_key: Option<PathBuf>,
    /// Off loopback without encryption, where a proxy or a tunnel encrypts
    #[arg(long)]
    insecure: bool,
    /// Another name under which the service answers
    #[arg(long = "host", value_name = "NAME[:PORT]")]
    hosts: Vec<HostName>,
    /// Sessions and sources may name recordings below this folder only, by their paths in it [default: none where tokens are asked for, else any]
    #[arg(long, value_name = "DIR")]
    recordings: Option<PathBuf>,
    /// All recordings together may take so many units of 10⁶ bytes, finished ones included [default: what --recordings-min-free-mb leaves]
    #[arg(long, value_name = "N")]
    recordings_max_mb: Option<u64>,
    /// Those of one tenant may take so many [default: an equal part of what all may take]
    #[arg(long, value_name = "N")]
    recordings_tenant_max_mb: Option<u64>,
    /// Recordings leave so many free on the disk [default: a twentieth of it, at most 1000]
    #[arg(long, value_name = "N")]
    recordings_min_free_mb: Option<u64>,
}

impl AccessArgs {
    /// Wherever the two come from, certificate and key go together.
    fn options(&self) -> Result<AccessOptions, Failure> {
        let files = self.tls_cert.clone().zip(self.tls_key.clone());
        if files.is_none() && (self.tls_cert.is_some() || self.tls_key.is_some()) {
            return Err(Failure::Usage("--tls-cert and --tls-key go together".into()));
        }
        Ok(AccessOptions {
            require_token: self.require_token,
            tokens: self.tokens.clone(),
            tls: files.map(|(certificate, key)| TlsFiles { certificate, key }),
            insecure: self.insecure,
            hosts: self.hosts.clone(),
            recordings: self.recordings.clone(),
            quota: RecordingQuota {
                tenant_mb: self.recordings_tenant_max_mb,
                all_mb: self.recordings_max_mb,
                free_mb: self.recordings_min_free_mb,
            },
        })
    }
}

/// Serves until SIGINT or SIGTERM; a second one ends it at once. The line on standard error is for people and programs: it names the real port.
pub fn run(args: &ServeArgs, out: &mut dyn Write) -> Result<(), Failure> {
    if args.json && !args.check {
        let message =
            "--json goes with --check: a service that runs prints nothing but its log, which is JSON with --log json";
        return Err(Failure::Usage(message.into()));
    }
    let width = args.vector_width.width()?;
    let access = args.access.options()?;
    let scheme = if access.tls.is_some() { "https" } else { "http" };
    let (data, models) = (args.data.clone(), args.models.clone());
    let options = Options { listen: args.listen, data, models, demo: args.demo, width, access };
    let no_log = |error| Failure::Other(format!("no thread for the log: {error}"));
    let _log = Log::start(args.log, args.log_level).map_err(no_log)?;
    if args.check {
        return checked(&options, args, out);
    }
    let server = Server::start(&options).map_err(|error| match error {
        StartError::Access(_) => Failure::Usage(error.to_string()),
        other => Failure::Other(other.to_string()),
    })?;
    let signals = Signals::handle().map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    let address = format!("{scheme}://{}", server.address());
    match args.log {
        LogFormat::Text => eprintln!("isophote: listening on {address}"),
        LogFormat::Json => tracing::info!(address, "listening"),
    }
    match server.run_until(signals) {
        Stopped::InOrder => Ok(()),
        Stopped::AtOnce => Err(Failure::Other("ended before everything had stopped".into())),
    }
}

/// One line a finding; the reasons are what it fails with.
fn checked(options: &Options, args: &ServeArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let findings = check(options);
    let reasons: Vec<&str> =
        findings.iter().filter_map(|finding| finding.result.as_ref().err()).map(String::as_str).collect();
    if args.json {
        let items: Vec<Value> = findings.iter().map(item).collect();
        output::json(out, &json!({ "would_start": reasons.is_empty(), "items": items }))?;
    } else {
        let rows = findings.iter().map(|finding| match &finding.result {
            Ok(found) => vec![finding.what.to_string(), "ok".into(), found.clone()],
            Err(reason) => vec![finding.what.to_string(), "no".into(), reason.clone()],
        });
        output::table(out, &["WHAT", "", "FOUND"], &rows.collect::<Vec<_>>())?;
    }
    if reasons.is_empty() {
        Ok(())
    } else {
        Err(Failure::Other(format!("the service would not start: {}", reasons.join("; "))))
    }
}

fn item(finding: &StartFinding) -> Value {
    match &finding.result {
        Ok(found) => json!({ "what": finding.what, "ok": true, "found": found }),
        Err(reason) => json!({ "what": finding.what, "ok": false, "reason": reason }),
    }
}
