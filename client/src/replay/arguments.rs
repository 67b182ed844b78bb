//! Arguments of `isophote replay`.

use std::path::PathBuf;

/// Repeat the fits of a recording, and print one line per estimate
#[derive(Clone, Debug, clap::Args)]
pub struct ReplayArgs {
    /// Recording written by `isophote record`
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Check that the fits equal the recorded ones bit for bit; exit status 0 only if all do
    #[arg(long, conflicts_with = "model")]
    pub verify: bool,
    /// Compare this document (TOML; JSON if named *.json) with the models of the recording, on the same frames
    #[arg(long, value_name = "MODEL")]
    pub model: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
