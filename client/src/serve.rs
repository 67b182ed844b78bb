//! `isophote serve`: the service in the foreground, until it is interrupted.

use std::net::SocketAddr;
use std::path::PathBuf;

use isophote_server::{AccessOptions, HostName, Options, Server, Signals, StartError, Stopped, TlsFiles};

use crate::arguments::VectorWidthArgument;
use crate::failure::Failure;

/// Run the service: models, sources, sessions and streams over HTTP
#[derive(Clone, Debug, clap::Args)]
pub struct ServeArgs {
    /// Where to listen; off loopback with tokens and TLS; port 0 takes any free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7240")]
    pub listen: SocketAddr,
    /// Keep models here; in memory only when absent
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// With a synthetic source and a running session, both named demo
    #[arg(long)]
    pub demo: bool,
    /// Bits of a vector; auto: what is fastest on this machine, measured at the start
    #[arg(long, value_enum, default_value_t = VectorWidthArgument::Auto)]
    pub vector_width: VectorWidthArgument,
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
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// The certificate's key, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
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
}

impl AccessArgs {
    fn options(&self) -> AccessOptions {
        let files = self.tls_cert.clone().zip(self.tls_key.clone());
        AccessOptions {
            require_token: self.require_token,
            tokens: self.tokens.clone(),
            tls: files.map(|(certificate, key)| TlsFiles { certificate, key }),
            insecure: self.insecure,
            hosts: self.hosts.clone(),
            recordings: self.recordings.clone(),
        }
    }
}

/// Serves until SIGINT or SIGTERM; a second one ends it at once. The line on standard error is for people and programs: it names the real port.
pub fn run(args: &ServeArgs) -> Result<(), Failure> {
    let width = args.vector_width.width()?;
    let access = args.access.options();
    let scheme = if access.tls.is_some() { "https" } else { "http" };
    let options = Options { listen: args.listen, data: args.data.clone(), demo: args.demo, width, access };
    let server = Server::start(&options).map_err(|error| match error {
        StartError::Access(_) => Failure::Usage(error.to_string()),
        other => Failure::Other(other.to_string()),
    })?;
    let signals = Signals::handle().map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    eprintln!("isophote: listening on {scheme}://{}", server.address());
    match server.run_until(signals) {
        Stopped::InOrder => Ok(()),
        Stopped::AtOnce => Err(Failure::Other("ended before everything had stopped".into())),
    }
}
