//! `isophote compare --live`: runs another model beside that of a session, on the same frames, as the session's
//! shadow.
//!
//! The shadow is removed when the command ends, however it ends.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use isophote_symbolic::Model;
use isophote_tracker::TrackState;
use isophote_tracker::tune::figures;
use isophote_wire::{EstimateView, SessionView, ShadowDocument, ShadowView};
use serde::Serialize;

use crate::compare::{CompareArgs, ModelFigures, significant, table};
use crate::failure::Failure;
use crate::http::{self, RemoteService, segment};
use crate::output;

/// Default of `--count`.
const FRAMES: u64 = 200;

/// Result of the comparison.
#[derive(Clone, Debug, Serialize)]
struct LiveComparison {
    session: String,
    /// The session's model, then the other one.
    models: Vec<ModelFigures>,
    /// Frames of the session that the other model skipped.
    #[serde(skip_serializing_if = "Option::is_none")]
    dropped: Option<u64>,
    /// Root mean square distance of the centres.
    #[serde(skip_serializing_if = "Option::is_none")]
    centre_px: Option<f64>,
    /// Differences of the parameters that both models have, by name.
    parameters: BTreeMap<String, ShiftSummary>,
}

/// One parameter over all frames: the other model's value less the session's.
#[derive(Clone, Copy, Debug, Serialize)]
struct ShiftSummary {
    /// Median.
    difference: f64,
    /// Root mean square of the differences in standard deviations of both.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviations: Option<f64>,
}

/// Runs until `--count` frames were seen, the session ends, or Ctrl-C.
pub fn run(args: &CompareArgs, session: &str, out: &mut dyn Write) -> Result<(), Failure> {
    let model = match args.models.as_slice() {
        [one] if one.extension().is_none() => one.display().to_string(),
        [one] => {
            let name = one.display();
            let message =
                format!("--live takes a model of the service; `isophote model push {name}` makes one of a file");
            return Err(Failure::Usage(message));
        }
        _ => return Err(Failure::Usage("--live takes one model: a session has one shadow".into())),
    };
    let (service, path) = (Arc::new(RemoteService::new(&args.service)?), format!("/v1/sessions/{}", segment(session)));
    let view: SessionView = service.get(&path)?;
    if let Some(shadow) = view.shadow {
        let message = format!(
            "the session `{session}` has a shadow already, `{}`; drop it first: isophote session shadow {session} --drop",
            shadow.model
        );
        return Err(Failure::Refused(message));
    }
    let shadow = BorrowedShadow { service, path: format!("{path}/shadow") };
    let document = ShadowDocument { model: model.clone(), constants: BTreeMap::new() };
    let is_interrupted = interrupted(&shadow)?;
    let begun: ShadowView = shadow.service.put(&shadow.path, &document)?;
    if is_interrupted.load(Ordering::SeqCst) {
        return Err(Failure::Other("interrupted before there was anything to see".into()));
    }
    let pairs = shadow.pairs(&path, args.count.unwrap_or(FRAMES))?;
    // The shadow may be gone by now.
    let last: Option<ShadowView> = shadow.service.get(&shadow.path).ok();
    let dropped = last.map(|last| last.dropped);
    let centres = |name: &str, digest: &str| shadow.centres(name, digest);
    let own = row(&view.active_model, centres(&view.active_model, &view.active_digest), pairs.iter());
    let others = pairs.iter().filter_map(|pair| pair.shadow.as_ref().map(|shadow| (&*shadow.estimate, pair)));
    let others: Vec<EstimateView> =
        others.map(|(one, pair)| EstimateView { truth: pair.truth.clone(), ..one.clone() }).collect();
    let other = row(&model, centres(&model, &begun.digest), others.iter());
    drop(shadow);
    let comparison = compared(session, vec![own, other], dropped, &pairs);
    match args.service.json {
        true => output::json(out, &comparison),
        false => shown(out, &comparison),
    }
}

/// Parameter names of a model's centres.
struct Centres {
    targets: usize,
    names: Vec<String>,
}

/// Removes the shadow on drop.
struct BorrowedShadow {
    service: Arc<RemoteService>,
    path: String,
}

impl Drop for BorrowedShadow {
    fn drop(&mut self) {
        // An interrupt has removed it already; a session that ended took it along.
        self.service.delete(&self.path).ok();
    }
}

impl BorrowedShadow {
    /// Estimates of frames that both models have fitted.
    fn pairs(&self, session: &str, count: u64) -> Result<Vec<EstimateView>, Failure> {
        let path = format!("{session}/estimates?mode=all&shadow=1&credit={count}");
        let mut estimates = self.service.websocket(&path)?;
        let mut pairs = Vec::new();
        while (pairs.len() as u64) < count {
            let Some(text) = estimates.next()? else { break };
            pairs.push(http::read(&text)?);
        }
        if pairs.is_empty() {
            return Err(Failure::Other("no frame was fitted by both models; is the session's source running?".into()));
        }
        Ok(pairs)
    }

    /// Names of the model's centres; `None` if the name now means another document.
    fn centres(&self, name: &str, digest: &str) -> Option<Centres> {
        let text = self.service.get_text(&format!("/v1/models/{}", segment(name)), "application/json").ok()?;
        let mut document: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text).ok()?;
        let is_same = document.remove("digest").is_some_and(|found| found == digest);
        document.remove("version");
        let model = Model::from_json(&serde_json::to_string(&document).ok()?).ok().filter(|_| is_same)?;
        let targets = model.roles().iter().map(|roles| &roles.centre).filter(|centre| !centre.is_empty());
        let names = targets.clone().flatten().map(|id| model.parameters()[id.index()].name.clone()).collect();
        Some(Centres { targets: targets.count(), names }).filter(|centres| centres.targets > 0)
    }
}

/// Ctrl-C removes the shadow, which ends the stream; the frames seen so far are reported.
#[cfg(feature = "serve")]
fn interrupted(shadow: &BorrowedShadow) -> Result<Arc<AtomicBool>, Failure> {
    let mut signals = isophote_server::Signals::handle()
        .map_err(|error| Failure::Other(format!("signals cannot be handled: {error}")))?;
    let (service, path) = (shadow.service.clone(), shadow.path.clone());
    let is_interrupted = Arc::new(AtomicBool::new(false));
    let flag = is_interrupted.clone();
    let listen = move || {
        signals.wait();
        flag.store(true, Ordering::SeqCst);
        // If the service does not answer, the stream has ended as well.
        service.delete(&path).ok();
    };
    let thread = std::thread::Builder::new().name("interrupts".into()).spawn(listen);
    thread.map(|_| is_interrupted).map_err(|error| Failure::Other(format!("no thread for signals: {error}")))
}

/// Without the service feature signals are not handled: Ctrl-C leaves the shadow.
#[cfg(not(feature = "serve"))]
fn interrupted(_shadow: &BorrowedShadow) -> Result<Arc<AtomicBool>, Failure> {
    eprintln!("compare: interrupt this, and the shadow stays until the session ends or somebody drops it");
    Ok(Arc::default())
}

/// One model's figures.
fn row<'a>(
    model: &str,
    centres: Option<Centres>,
    estimates: impl Iterator<Item = &'a EstimateView> + Clone,
) -> ModelFigures {
    let is_tracked = |estimate: &&EstimateView| estimate.state == TrackState::Tracking;
    let tracked = estimates.clone().filter(is_tracked).count();
    let place = |estimate: &EstimateView| -> Option<Vec<f64>> {
        let known = centres.as_ref().filter(|_| is_tracked(&estimate))?;
        known.names.iter().map(|name| estimate.parameters.get(name)).collect()
    };
    let error = |estimate: &EstimateView| -> Option<f64> {
        let truth = estimate.truth.as_ref()?;
        let known = centres.as_ref()?;
        let is: Vec<f64> = known.names.iter().map(|name| truth.get(name)).collect::<Option<_>>()?;
        let squares: f64 = is.iter().zip(place(estimate)?).map(|(is, found)| (found - is).powi(2)).sum();
        Some((squares / known.targets as f64).sqrt())
    };
    let places: Vec<Option<Vec<f64>>> = estimates.clone().map(place).collect();
    let errors: Vec<f64> = estimates.clone().filter_map(error).collect();
    let chi_squares: Vec<f64> =
        estimates.clone().filter(is_tracked).filter_map(|estimate| estimate.reduced_chi_square).collect();
    let times: Vec<f64> =
        estimates.clone().filter_map(|estimate| estimate.timing_us).map(|timing| timing.fit as f64).collect();
    ModelFigures {
        model: model.to_string(),
        file: None,
        frames: places.len(),
        tracked,
        failures: places.len() - tracked,
        rmse_px: figures::rms(&errors),
        reduced_chi_square: figures::median(&chi_squares),
        second_difference_px: figures::rms(&figures::second_differences(&places)),
        time_us: figures::median(&times),
        time_us_95: figures::quantile(&times, 0.95),
    }
}

fn compared(session: &str, models: Vec<ModelFigures>, dropped: Option<u64>, pairs: &[EstimateView]) -> LiveComparison {
    let apart = || pairs.iter().filter_map(|pair| pair.shadow.as_ref()).map(|shadow| &shadow.disagreement);
    let centres: Vec<f64> = apart().filter_map(|one| one.centre_px).collect();
    let mut shifts: BTreeMap<String, [Vec<f64>; 2]> = BTreeMap::new();
    for (name, shift) in apart().flat_map(|one| &one.parameters) {
        let [differences, deviations] = shifts.entry(name.clone()).or_default();
        differences.push(shift.difference);
        deviations.extend(shift.deviations);
    }
    let summary = |[differences, deviations]: &[Vec<f64>; 2]| {
        Some(ShiftSummary { difference: figures::median(differences)?, deviations: figures::rms(deviations) })
    };
    let parameters = shifts.iter().filter_map(|(name, all)| Some((name.clone(), summary(all)?))).collect();
    LiveComparison { session: session.to_string(), models, dropped, centre_px: figures::rms(&centres), parameters }
}

fn shown(out: &mut dyn Write, comparison: &LiveComparison) -> Result<(), Failure> {
    table(out, &comparison.models)?;
    let distance = comparison.centre_px.map_or("-".to_string(), significant);
    let dropped = comparison.dropped.map_or(String::new(), |dropped| format!("; {dropped} frames left out"));
    writeln!(out, "\ncentres {distance} px apart (root mean square){dropped}").map_err(Failure::output)?;
    let row = |(name, shift): (&String, &ShiftSummary)| {
        let sign = if shift.difference < 0.0 { "-" } else { "" };
        let difference = format!("{sign}{}", significant(shift.difference.abs()));
        vec![name.clone(), difference, shift.deviations.map_or("-".to_string(), significant)]
    };
    let rows: Vec<Vec<String>> = comparison.parameters.iter().map(row).collect();
    output::table(out, &["PARAMETER", "DIFFERENCE", "RMS/σ"], &rows)
}
