//! Arguments of `isophote tune`.

use std::path::PathBuf;

/// Find the best schedule of stages for a model by benchmarking many
#[derive(Clone, Debug, clap::Args)]
pub struct TuneArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Frames to benchmark on, of which at most 16 are used [default: four frames rendered from the model, with noise]
    #[arg(long, value_name = "PATH")]
    pub frames: Option<PathBuf>,
    /// Write the document to this file [default: standard output, with the tables on standard error]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// JSON document of the camera: saturation, electrons_per_dn, read_noise_e, row_noise_e, defects, defect_map
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Number of starts per frame at each of three distances
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub starts: u64,
    /// Seed of noise and starts; the same seed gives the same frames and starts
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object, which contains the document unless --out is given
    #[arg(long)]
    pub json: bool,
}
