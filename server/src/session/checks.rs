//! Checks that a session's document, a model and a source's frames fit together, before anything starts.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_tracker::{Compiled, PoseMismatch, TrackError, Tracker, TrackerOptions};
use isophote_wire::SessionDocument;

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::source::FrameShape;

/// Rejects what this build cannot honour instead of ignoring it.
pub(super) fn check_document(document: &SessionDocument) -> Result<(), Problem> {
    if let Some(window) = document.window {
        let slices = window.depth.unwrap_or(1).saturating_mul(window.length.unwrap_or(1));
        let pixels = window.width.saturating_mul(window.height).saturating_mul(slices);
        if pixels == 0 || pixels > LIMITS.window_pixels {
            let message = format!("a window has 1 to {} pixels", LIMITS.window_pixels);
            return Err(Problem::wrong_key("out-of-range", "window", message));
        }
    }
    let finite = |key: &str, numbers: &BTreeMap<String, f64>| {
        let wrong = numbers.iter().find(|(_, value)| !value.is_finite());
        wrong.map_or(Ok(()), |(name, _)| {
            Err(Problem::wrong_key("out-of-range", &format!("{key}.{name}"), "not a finite number"))
        })
    };
    finite("constants", &document.constants)?;
    finite("start", &document.start)
}

/// Checks that a model can fit such frames.
pub(super) fn check_shape(model: &isophote_symbolic::Model, shape: &FrameShape) -> Result<(), String> {
    let (coordinates, channels) = (model.coordinates().len(), model.channels().len());
    if let Some(dimensions) = shape.dimensions.filter(|dimensions| *dimensions != coordinates) {
        return Err(format!(
            "the model `{}` has {coordinates} coordinates, the source's frames have {dimensions}",
            model.name()
        ));
    }
    // Columns are found by name; extra columns are allowed.
    if let Some(columns) = &shape.columns {
        let missing = model.channels().iter().find(|channel| !columns.contains(channel));
        return missing.map_or(Ok(()), |channel| {
            let (count, model) = (columns.len(), model.name());
            Err(format!("none of the {count} columns is named `{channel}`, which the model `{model}` reads"))
        });
    }
    if let Some(planes) = shape.planes.filter(|planes| *planes != channels && !(*planes == 3 && channels == 1)) {
        return Err(format!(
            "the model `{}` has {channels} channels, the source's frames have {planes} planes",
            model.name()
        ));
    }
    Ok(())
}

/// A tracker for such frames.
pub(super) fn tracker(
    compiled: Arc<Compiled>,
    options: TrackerOptions,
    shape: &FrameShape,
) -> Result<Tracker, TrackError> {
    if let Some(size) = &shape.size {
        options.check_size(compiled.model(), size)?;
    }
    Tracker::new(compiled, options)
}

/// Maps a tracker's error to the key of the wrong option.
pub(super) fn wrong_options(document: &SessionDocument, entry: &ModelEntry, error: &TrackError) -> Problem {
    let parameter = document.start.keys().find(|name| entry.model.parameter(name).is_none());
    let constant = document.constants.keys().find(|name| entry.model.constant(name).is_none());
    let key = match (parameter, constant, error) {
        (_, _, TrackError::Range { name, .. }) => match name.split_once('.') {
            Some(("camera" | "constants", _)) => name.to_string(),
            _ => format!("options.{name}"),
        },
        (_, _, TrackError::OutsideBounds { name, .. }) => format!("start.{name}"),
        (_, _, TrackError::OutsideNumbers { name, .. }) => format!("constants.{name}"),
        (Some(name), _, _) => format!("start.{name}"),
        (None, Some(name), _) => format!("constants.{name}"),
        (None, None, TrackError::Window { .. }) => "window".to_string(),
        (None, None, TrackError::Target(_)) => "target".to_string(),
        (None, None, TrackError::Pose(PoseMismatch::Size { .. })) => "camera.intrinsics".to_string(),
        (None, None, TrackError::Pose(_)) => "target".to_string(),
        (None, None, TrackError::DefectMap(_)) => "camera.defect_map".to_string(),
        (None, None, TrackError::Response(_)) => "camera.response".to_string(),
        (None, None, TrackError::Intrinsics(_)) => "camera.intrinsics".to_string(),
        (None, None, _) => "model".to_string(),
    };
    Problem::wrong_key("wrong-value", &key, error.to_string())
}
