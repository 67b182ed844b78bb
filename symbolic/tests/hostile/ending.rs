//! What becomes of a document: read, and derived and lowered for each of its stages.

use isophote_symbolic::{Diagnostics, Model};

use crate::documents::Hostile;

/// What stops it, if anything does; reading alone, then all that follows.
pub fn read(hostile: &Hostile) -> Result<Model, Diagnostics> {
    if hostile.is_json { Model::from_json(&hostile.text) } else { Model::from_toml(&hostile.text) }
}

/// Derives and lowers for each stage.
pub fn derive(model: &Model) -> Result<(), Diagnostics> {
    for stage in model.stages() {
        model.objective(&stage.parameters, stage.method)?.program(Default::default())?;
    }
    Ok(())
}
