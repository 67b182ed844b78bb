//! The model documents built into the program.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_jit::KernelCache;
use isophote_symbolic::Model;

use super::entry::{Media, ModelEntry};
use crate::name::Name;

/// The shipped documents.
pub const SHIPPED: [&str; 26] = [
    include_str!("../../../models/bead.toml"),
    include_str!("../../../models/blob-3d.toml"),
    include_str!("../../../models/blob-4d.toml"),
    include_str!("../../../models/bright-disc.toml"),
    include_str!("../../../models/dark-disc.toml"),
    include_str!("../../../models/gaussian-pixel.toml"),
    include_str!("../../../models/gaussian.toml"),
    include_str!("../../../models/laser-beam.toml"),
    include_str!("../../../models/moffat.toml"),
    include_str!("../../../models/profile-1d.toml"),
    include_str!("../../../models/raised-spot-pose.toml"),
    include_str!("../../../models/rational-spot.toml"),
    include_str!("../../../models/ring.toml"),
    include_str!("../../../models/spot-lobe.toml"),
    include_str!("../../../models/spot-motion.toml"),
    include_str!("../../../models/spot-plane.toml"),
    include_str!("../../../models/spot-pose.toml"),
    include_str!("../../../models/spot-psf.toml"),
    include_str!("../../../models/spot-quadratic.toml"),
    include_str!("../../../models/spot.toml"),
    include_str!("../../../models/thesis-spot.toml"),
    include_str!("../../../models/three-spots-pose-lens.toml"),
    include_str!("../../../models/three-spots-pose-raw.toml"),
    include_str!("../../../models/three-spots-pose.toml"),
    include_str!("../../../models/three-spots-raw.toml"),
    include_str!("../../../models/three-spots.toml"),
];

/// The shipped models by name, each as version 1.
pub fn shipped(cache: &Arc<KernelCache>) -> BTreeMap<Name, Arc<ModelEntry>> {
    let mut models = BTreeMap::new();
    for text in SHIPPED {
        match Model::from_toml(text) {
            Ok(model) => {
                if let Some(name) = Name::parse(model.name()) {
                    let entry = ModelEntry::new(name.clone(), 1, model, Media::Toml, text, cache.clone());
                    models.insert(name, Arc::new(entry));
                }
            }
            Err(faults) => {
                let first = faults.first().map(|fault| fault.message.as_str());
                refused("a shipped model", first.unwrap_or_default());
            }
        }
    }
    models
}

/// Logs a fault of a shipped or stored document.
pub fn refused(what: &str, why: &str) {
    tracing::warn!("{what} is refused: {why}");
}
