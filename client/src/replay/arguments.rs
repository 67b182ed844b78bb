//! What `isophote replay` is told.

use std::path::PathBuf;

/// Fit the frames of a recording again: one line an estimate
#[derive(Clone, Debug, clap::Args)]
pub struct ReplayArgs {
    /// What `isophote record` wrote
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Say whether fits come out as they were recorded, bit for bit; exit status 0 only if all do
    #[arg(long, conflicts_with = "model")]
    pub verify: bool,
    /// Compare this document (TOML; JSON if named *.json) with the models of the recording, on the same frames
    #[arg(long, value_name = "MODEL")]
    pub model: Option<PathBuf>,
    /// JSON
    #[arg(long)]
    pub json: bool,
}
