//! The pixel loop with vectors.

use crate::export::{ExportError, Source};

pub(super) fn file(_source: &Source<'_>) -> Result<String, ExportError> {
    Err(ExportError::NotInLanes("vectors"))
}
