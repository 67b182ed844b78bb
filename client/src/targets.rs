//! Tables of targets: their number, a summary of a frame, and a row for each of them as text or CSV.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::str::FromStr;

use isophote_symbolic::{Model, ParameterId};
use isophote_tracker::{Estimate, TARGETS_MAX, TrackState};
use isophote_wire::{EstimateView, Rejection};

use crate::failure::Failure;
use crate::output::{self, with_deviation};

/// `N` or `all`: the number of targets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetCount {
    /// This many.
    Exactly(usize),
    /// As many as there are.
    All,
}

impl TargetCount {
    /// The number of targets to look for.
    pub fn most(self) -> usize {
        match self {
            TargetCount::Exactly(count) => count,
            TargetCount::All => TARGETS_MAX,
        }
    }
}

impl FromStr for TargetCount {
    type Err = String;
    fn from_str(text: &str) -> Result<TargetCount, String> {
        if text == "all" {
            return Ok(TargetCount::All);
        }
        let count = text.parse().ok().filter(|count| (1..=TARGETS_MAX).contains(count));
        count.map(TargetCount::Exactly).ok_or(format!("a number from 1 to {TARGETS_MAX}, or all"))
    }
}

/// A quantity and its standard deviation, by the name that tables of sources use.
struct Quantity {
    name: String,
    value: Option<f64>,
    error: Option<f64>,
}

/// Position, photometry and background of one target.
fn quantities(model: &Model, estimate: &Estimate) -> Vec<Quantity> {
    let roles = model.roles().first();
    let of_parameter = |name: &str, id: Option<ParameterId>| Quantity {
        name: name.into(),
        value: id.and_then(|id| estimate.parameters.get(id.index()).copied()),
        error: id.and_then(|id| estimate.deviation(id)),
    };
    let centre = |axis: usize| roles.and_then(|roles| roles.centre.get(axis).copied());
    let places = model.coordinates().iter().enumerate().map(|(axis, name)| of_parameter(name, centre(axis)));
    let photometry = estimate.photometry;
    let of_photometry = |name: &str, both: fn(&isophote_tracker::Photometry) -> (f64, Option<f64>)| {
        let both = photometry.as_ref().map(both);
        Quantity { name: name.into(), value: both.map(|(value, _)| value), error: both.and_then(|(_, error)| error) }
    };
    let light = [
        of_photometry("flux", |found| (found.flux, found.flux_err)),
        of_photometry("fwhm", |found| (found.fwhm, found.fwhm_err)),
        of_photometry("semi_major", |found| (found.semi_major, found.semi_major_err)),
        of_photometry("semi_minor", |found| (found.semi_minor, found.semi_minor_err)),
        of_photometry("angle_deg", |found| (found.angle_deg, found.angle_deg_err)),
        of_parameter("sky", roles.and_then(|roles| roles.background)),
    ];
    places.chain(light).collect()
}

/// The flux over its standard deviation; without photometry the brightness.
fn snr(model: &Model, estimate: &Estimate) -> Option<f64> {
    let flux = estimate.photometry.and_then(|found| Some(found.flux.abs() / found.flux_err?));
    let brightness = model.roles().first().and_then(|roles| roles.brightness);
    flux.or_else(|| {
        let id = brightness?;
        Some(estimate.parameters.get(id.index())?.abs() / estimate.deviation(id)?)
    })
}

/// The codes of a fit's shortcomings.
fn quality(view: &EstimateView) -> String {
    let code = |quality| Some(serde_json::to_value(quality).ok()?.get("code")?.as_str()?.to_string());
    view.quality.iter().filter_map(code).collect::<Vec<String>>().join(" ")
}

/// Word of a state or an ending on the wire.
fn word(value: impl serde::Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(str::to_string)).unwrap_or_default()
}

/// The targets that were ever found; the first one if none was.
pub fn found(all: &[(Estimate, EstimateView)]) -> Vec<&(Estimate, EstimateView)> {
    let found: Vec<_> = all.iter().filter(|(_, view)| view.state != TrackState::Searching).collect();
    if found.is_empty() { all.iter().take(1).collect() } else { found }
}

/// One line for a frame: its number, file, how many targets are in which state, and the time of their fits.
pub fn summary<'a>(views: impl Iterator<Item = &'a EstimateView> + Clone) -> String {
    let Some(first) = views.clone().next() else { return String::new() };
    let count = |state: TrackState| (views.clone().filter(|view| view.state == state).count(), word(state));
    let counts = [TrackState::Tracking, TrackState::Coasting, TrackState::Lost, TrackState::Searching].map(count);
    let counted = counts.iter().filter(|(count, _)| *count > 0).map(|(count, state)| format!("{count} {state}"));
    let counted: Vec<String> = counted.collect();
    let mut text = format!("{:>6}  {:<24}  {}", first.frame, first.file.as_deref().unwrap_or("-"), counted.join(", "));
    let unfound = views.filter(|view| !is_seen(view));
    let mut endings: BTreeMap<String, usize> = BTreeMap::new();
    unfound.for_each(|view| {
        let rejection = view.rejection.filter(|rejection| *rejection != Rejection::Ending);
        let reason = rejection.map_or(view.ending.name(), |rejection| rejection.name()).to_string();
        *endings.entry(reason).or_default() += 1;
    });
    if !endings.is_empty() {
        let reasons: Vec<String> = endings.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
        text += &format!("  ({})", reasons.join(", "));
    }
    let fit_us = first.timing_us.map_or(0, |timing| timing.fit);
    text + &format!("  {:.1} ms", fit_us as f64 / 1000.0)
}

fn is_seen(view: &EstimateView) -> bool {
    matches!(view.state, TrackState::Tracking | TrackState::Coasting)
}

/// A table of the targets that are seen or coasting.
pub fn table(out: &mut dyn Write, model: &Model, all: &[(Estimate, EstimateView)]) -> Result<(), Failure> {
    let mut head: Vec<String> = vec!["TRACK".into(), "STATE".into()];
    let mut rows = Vec::new();
    for (estimate, view) in all.iter().filter(|(_, view)| is_seen(view)) {
        let quantities = quantities(model, estimate);
        head.splice(2.., quantities.iter().map(|quantity| quantity.name.to_uppercase()));
        let cell = |quantity: &Quantity| quantity.value.map(|value| with_deviation(value, quantity.error));
        let mut row = vec![view.target.clone(), word(view.state)];
        row.extend(quantities.iter().map(|quantity| cell(quantity).unwrap_or_default()));
        row.push(snr(model, estimate).map_or_else(String::new, |snr| format!("{snr:.1}")));
        row.push(view.reduced_chi_square.map_or_else(String::new, |value| format!("{value:.2}")));
        row.push(quality(view));
        rows.push(row);
    }
    head.extend(["SNR", "χ²", "QUALITY"].map(String::from));
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    if rows.is_empty() { Ok(()) } else { output::table(out, &head, &rows) }
}

/// A CSV file with a row for each target of each frame that is seen or coasting.
pub struct TargetsFile {
    csv: csv::Writer<File>,
    has_head: bool,
}

impl TargetsFile {
    /// Creates the file; an existing one is replaced.
    pub fn create(path: &Path) -> Result<TargetsFile, Failure> {
        let file = File::create(path)
            .map_err(|error| Failure::Usage(format!("--csv {}: cannot be written: {error}", path.display())))?;
        Ok(TargetsFile { csv: csv::Writer::from_writer(file), has_head: false })
    }

    /// Adds the targets of a frame.
    pub fn write(&mut self, model: &Model, all: &[(Estimate, EstimateView)]) -> Result<(), Failure> {
        for (estimate, view) in all {
            let mut columns: Vec<(String, String)> = Vec::new();
            let number = |value: Option<f64>| {
                value.filter(|value| value.is_finite()).map_or_else(String::new, |v| v.to_string())
            };
            let mut column = |name: &str, text: String| columns.push((name.to_string(), text));
            column("frame", view.frame.to_string());
            column("file", view.file.clone().unwrap_or_default());
            column("time_s", number(view.time_s));
            column("track", view.target.clone());
            column("state", word(view.state));
            let own = |(index, parameter): (usize, &isophote_symbolic::Parameter)| Quantity {
                name: parameter.name.clone(),
                value: estimate.parameters.get(index).copied(),
                error: estimate.deviation(ParameterId(index as u32)),
            };
            let parameters = model.parameters().iter().enumerate().map(own);
            let quantities = quantities(model, estimate).into_iter();
            let pair = |columns: &mut dyn FnMut(&str, String), quantity: Quantity| {
                columns(&quantity.name, number(quantity.value));
                columns(&format!("{}_err", quantity.name), number(quantity.error));
            };
            quantities.for_each(|quantity| pair(&mut column, quantity));
            column("snr", number(snr(model, estimate)));
            column("reduced_chi_square", number(view.reduced_chi_square));
            column("confidence", number(view.confidence));
            column("quality", quality(view));
            parameters.for_each(|quantity| pair(&mut column, quantity));
            if !self.has_head {
                self.has_head = true;
                self.csv.write_record(columns.iter().map(|(name, _)| name)).map_err(Failure::other)?;
            }
            if is_seen(view) {
                self.csv.write_record(columns.iter().map(|(_, text)| text)).map_err(Failure::other)?;
            }
        }
        Ok(())
    }

    /// Writes all rows to the disk.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.csv.flush().map_err(Failure::other)
    }
}
