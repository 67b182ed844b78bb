//! Fits one frame as a session would, and keeps nothing.

use std::time::Instant;

use isophote_machine::Threads;
use isophote_tracker::{Frame, Preparing, TrackerOptions, Watch};
use isophote_wire::{EstimateView, SessionDocument, Timing};

use super::checks::{check_document, check_shape, tracker, wrong_options};
use super::swap;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::source::FrameShape;

/// Fits each target in the frame as the first of its track. Waits for preparations that a session runs beside its fits, as
/// `isophote fit` does: both give the same results.
///
/// # Errors
/// Those of starting a session with that document.
pub fn fit_once(
    entry: &ModelEntry,
    document: &SessionDocument,
    frame: &Frame,
    watch: &dyn Watch,
) -> Result<Vec<EstimateView>, Problem> {
    check_document(document)?;
    let shape = FrameShape::of(frame);
    check_shape(&entry.model, &shape).map_err(|message| Problem::wrong_key("wrong-model", "model", message))?;
    let compiled = entry.kernels(document.options.precision)?;
    if let Some(format) = shape.format_for(&entry.model) {
        compiled.warm(document.camera.seen_format(format), &Threads)?;
    }
    let options = TrackerOptions { preparing: Preparing::AtOnce, ..swap::options(document) };
    let tracker = tracker(compiled, options, &shape).map_err(|error| wrong_options(document, entry, &error));
    let start = Instant::now();
    let results = tracker?.track_all_while(frame, watch);
    let timing = Timing { wait: None, fit: start.elapsed().as_micros() as u64 };
    let id = entry.id();
    let view = |result| EstimateView {
        vector_width: Some(8 * entry.width().bytes()),
        timing_us: Some(timing),
        ..EstimateView::new(&entry.model, &id, frame.sequence, result)
    };
    Ok(results.iter().map(view).collect())
}
