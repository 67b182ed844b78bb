//! `isophote serve`: the service in the foreground, until it is interrupted.

use std::net::SocketAddr;
use std::path::PathBuf;

use isophote_server::{Options, Server, Signals, StartError, Stopped};

use crate::arguments::VectorWidthArgument;
use crate::failure::Failure;

/// Run the service: models, sources, sessions and streams over HTTP
#[derive(Clone, Debug, clap::Args)]
pub struct ServeArgs {
    /// A loopback address; port 0 takes any free one
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
}

/// Serves until SIGINT or SIGTERM; a second one ends it at once. The line on standard error is for people and programs: it names the real port.
pub fn run(args: &ServeArgs) -> Result<(), Failure> {
    let width = args.vector_width.width()?;
    let options = Options { listen: args.listen, data: args.data.clone(), demo: args.demo, width };
    let server = Server::start(&options).map_err(|error| match error {
        StartError::NotLoopback(_) => Failure::Usage(error.to_string()),
        other => Failure::Other(other.to_string()),
    })?;
    let signals = Signals::handle().map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    eprintln!("isophote: listening on http://{}", server.address());
    match server.run_until(signals) {
        Stopped::InOrder => Ok(()),
        Stopped::AtOnce => Err(Failure::Other("ended before everything had stopped".into())),
    }
}
