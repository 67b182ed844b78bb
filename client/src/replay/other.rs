//! Compares another model on the frames of a recording with the recorded estimates.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use isophote_machine::Threads;
use isophote_symbolic::Model;
use isophote_tracker::{Compiled, Preparing, TrackState, Tracker, TrackerOptions};
use isophote_wire::{EstimateView, options_known};

use super::arguments::ReplayArgs;
use super::log::{Recorded, RecordedLog};
use super::refit;
use crate::compare::{MeasuredModel, error_px, measured_json, measured_table};
use crate::failure::Failure;
use crate::{model_files, offline};

/// Adds the estimate of one more frame.
fn take(
    measured: &mut MeasuredModel,
    (model, estimate): (&Model, &EstimateView),
    truth: Option<&BTreeMap<String, f64>>,
    time_us: f64,
) {
    let centres = model.roles().iter().flat_map(|roles| &roles.centre);
    let value = |name: &str| estimate.parameters.get(name);
    let place: Option<Vec<f64>> = centres.map(|id| value(&model.parameters()[id.index()].name)).collect();
    let place = place.filter(|_| estimate.state == TrackState::Tracking);
    if let Some(place) = &place {
        measured.chi_squares.extend(estimate.reduced_chi_square);
        measured.errors_px.extend(truth.and_then(|truth| error_px(model, truth, place)));
    }
    measured.times_us.push(time_us);
    measured.places.push(place);
}

/// `isophote replay --model`.
pub fn run(args: &ReplayArgs, path: &Path, mut log: RecordedLog, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(path)?;
    let document = log.session.document.clone();
    let compiled = Compiled::with_cache(model.clone(), document.options.precision, Arc::default(), &Threads);
    let compiled = Arc::new(compiled.map_err(|failure| offline::refused(path, &failure))?);
    let options = TrackerOptions { preparing: Preparing::AtOnce, ..options_known(&document, &model) };
    let mut tracker = Tracker::new(compiled, options).map_err(|error| Failure::Usage(error.to_string()))?;
    let file = args.file.display().to_string();
    let mut recorded = MeasuredModel { file, ..MeasuredModel::default() };
    let (name, file) = (model.name().to_string(), path.display().to_string());
    let mut other = MeasuredModel { name, file, ..MeasuredModel::default() };
    let mut names: Vec<String> = Vec::new();
    let mut fitting = None;
    while let Some(happened) = log.next()? {
        match happened {
            Recorded::Swap(swap) => {
                if !names.contains(&swap.name) {
                    names.push(swap.name.clone());
                }
                fitting = Some(refit::model(&swap)?);
            }
            Recorded::Snapshot(_) => {}
            Recorded::Fit(fit) => {
                let (Some(before), Some(estimate)) = (&fitting, fit.estimates.first()) else { continue };
                let Some(frame) = refit::frame(&fit)? else { continue };
                let truth: Option<BTreeMap<String, f64>> = estimate
                    .truth
                    .as_ref()
                    .map(|truth| truth.iter().map(|(name, value)| (name.to_string(), value)).collect());
                let time_us = estimate.timing_us.map_or(f64::NAN, |timing| timing.fit as f64);
                take(&mut recorded, (before, estimate), truth.as_ref(), time_us);
                let begin = Instant::now();
                let estimate = tracker.track(&frame);
                let time_us = begin.elapsed().as_nanos() as f64 / 1e3;
                let view = EstimateView::new(&model, "", frame.sequence, &estimate);
                take(&mut other, (&model, &view), truth.as_ref(), time_us);
            }
        }
    }
    if other.places.is_empty() {
        return Err(Failure::Other(format!("{}: no frame that was fitted has its pixels", args.file.display())));
    }
    recorded.name = format!("{} (recorded)", names.join(", "));
    match args.json {
        true => measured_json(&[recorded, other], out),
        false => measured_table(&[recorded, other], out),
    }
}
