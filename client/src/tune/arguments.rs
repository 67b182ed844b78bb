//! What `isophote tune` is asked for.

use std::path::PathBuf;

/// Find the schedule of stages that suits a model by trying many
#[derive(Clone, Debug, clap::Args)]
pub struct TuneArgs {
    /// The model document (TOML; JSON if it is named *.json)
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Frames to try schedules on, at most 16 of them [default: four frames rendered from the model, with noise]
    #[arg(long, value_name = "PATH")]
    pub frames: Option<PathBuf>,
    /// Write the document there [default: standard output; the tables then go to standard error]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// A JSON document about the camera: saturation, electrons_per_dn, read_noise_e, row_noise_e, defects, defect_map
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Starts for each frame at each of three distances
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub starts: u64,
    /// Of noise and starts; same seed, same frames and starts
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// One JSON object; the document is in it where --out does not name a file
    #[arg(long)]
    pub json: bool,
}
