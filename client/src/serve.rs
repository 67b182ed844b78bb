//! `isophote serve`: runs the service in the foreground until interrupted.

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
    /// TOML file with values of these options, such as `vector_width = "256"`; flags and environment variables override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address to listen on (port 0: any free port); addresses other than loopback require tokens, and TLS or --insecure
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7240")]
    pub listen: SocketAddr,
    /// Store models, sources and sessions in this folder [default: in memory only]
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Load the model documents (NAME.toml, NAME.json) of this folder under their file names
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// Start with a synthetic source and a running session, both named demo
    #[arg(long)]
    pub demo: bool,
    /// Vector width in bits; auto: the fastest on this machine, measured at the start
    #[arg(long, value_enum, default_value_t = VectorWidthArgument::Auto)]
    pub vector_width: VectorWidthArgument,
    /// Format of the log on standard error
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    pub log: LogFormat,
    /// Minimum level to log
    #[arg(long, value_enum, default_value_t = LogLevel::Info)]
    pub log_level: LogLevel,
    /// Check whether the service could start (address, data folder, models, running compiled code) without starting it
    #[arg(long)]
    pub check: bool,
    /// Print one JSON object: the findings of --check, or the settings of `config show`
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    access: AccessArgs,
}

/// Access to the service: tokens, TLS, host names, recordings
#[derive(Clone, Debug, clap::Args)]
struct AccessArgs {
    /// Require a token on loopback too; other addresses always require one
    #[arg(long)]
    require_token: bool,
    /// Require a token of this file, also on loopback [default: tokens.json in the data folder, else in ~/.config/isophote]
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// TLS certificate of the service, PEM
    #[arg(long, value_name = "FILE")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM
    #[arg(long, value_name = "FILE")]
    tls_key: Option<PathBuf>,
    /// Allow addresses other than loopback without TLS, for a service behind an encrypting proxy or tunnel
    #[arg(long)]
    insecure: bool,
    /// Additional host name under which clients reach the service
    #[arg(long = "host", value_name = "NAME[:PORT]")]
    hosts: Vec<HostName>,
    /// Folder of the recordings that sessions and sources may name, by their paths in it [default: none if tokens are required, else any path]
    #[arg(long, value_name = "DIR")]
    recordings: Option<PathBuf>,
    /// Maximum size of all recordings, finished ones included, in units of 10⁶ bytes [default: the disk space beyond --recordings-min-free-mb]
    #[arg(long, value_name = "N")]
    recordings_max_mb: Option<u64>,
    /// Maximum size of one tenant's recordings, in units of 10⁶ bytes [default: an equal share of the total for each tenant]
    #[arg(long, value_name = "N")]
    recordings_tenant_max_mb: Option<u64>,
    /// Disk space that recordings leave free, in units of 10⁶ bytes [default: a twentieth of the file system, at most 1000]
    #[arg(long, value_name = "N")]
    recordings_min_free_mb: Option<u64>,
}

impl AccessArgs {
    /// Certificate and key are required together, wherever each is set.
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

/// Serves until SIGINT or SIGTERM; a second one exits at once. The line on standard error, for people and programs,
/// names the real port.
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

/// Prints one line per finding; fails with the reasons.
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
