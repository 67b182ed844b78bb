//! Poses by cold starts in other light: rims, colours and ellipses, uncertain lenses, spots partly out of the picture.
//! Each frame is a cold start, or the last one of a few.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::geometry::{Rigid, bounds};
use isophote_tracker::{Camera, Compiled, Estimate, Intrinsics, Target, TrackState, Tracker, TrackerOptions};

use super::bound::bound_of;
use super::light::Light;
use super::scene::{Random, Rim, SHARP, SOFT, STEEP, camera, lens, place, random_pose, target};
use super::tally::{PoseTally, WRONG_MM};

/// The document to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Document {
    /// `three-spots-pose`.
    Grey,
    /// The same, with pixels sampled at their centres.
    Centres,
    /// `three-spots-pose-raw`.
    Raw,
    /// `three-spots-raw`, with the pose from its ellipses.
    Ellipses,
}

impl Document {
    fn text(self) -> String {
        match self {
            Document::Grey => crate::text("three-spots-pose"),
            Document::Raw => crate::text("three-spots-pose-raw"),
            Document::Ellipses => crate::text("three-spots-raw"),
            Document::Centres => {
                let places = "v1 * shine";
                let text = crate::text("three-spots-pose");
                assert!(text.contains(places) && text.contains(", \"blur\"]"));
                text.replace(places, "v1 * at(0, 0)").replace(", \"blur\"]", "]")
            }
        }
    }

    fn is_coloured(self) -> bool {
        matches!(self, Document::Raw | Document::Ellipses)
    }
}

/// The difficulty of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Perturbation {
    Nothing,
    /// Relative standard deviation of the common focal length.
    Focal(f64),
    /// Relative standard deviation of each focal length, and that of the principal point, px.
    Lens(f64, f64),
    /// The first spot is out of the picture by this share of its width.
    Out(f64),
    /// The first spot is clipped almost up to its rim, at this brightness, DN.
    White(f64),
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    pub name: &'static str,
    pub document: Document,
    pub rim: Rim,
    pub saturated: f64,
    pub cross_talk: f64,
    pub distance_mm: (f64, f64),
    pub perturbation: Perturbation,
    /// Earlier frames, without difficulty, in which the target approaches its position.
    pub before: usize,
}

const FAR: (f64, f64) = (1500.0, 3000.0);
const NEAR: (f64, f64) = (900.0, 1100.0);

const fn rim(name: &'static str, document: Document, rim: Rim, saturated: f64) -> Row {
    Row {
        name,
        document,
        rim,
        saturated,
        cross_talk: 0.0,
        distance_mm: FAR,
        perturbation: Perturbation::Nothing,
        before: 0,
    }
}

const fn colours(name: &'static str, document: Document, rim: Rim, saturated: f64, cross_talk: f64) -> Row {
    Row { name, document, rim, saturated, cross_talk, distance_mm: FAR, perturbation: Perturbation::Nothing, before: 0 }
}

const fn perturbation(name: &'static str, document: Document, perturbation: Perturbation, before: usize) -> Row {
    let rim = SOFT;
    Row { name, document, rim, saturated: 0.0, cross_talk: 0.0, distance_mm: NEAR, perturbation, before }
}

/// All rows.
pub const ROWS: [Row; 25] = [
    rim("sharp rims, S0", Document::Grey, SHARP, 0.0),
    rim("sharp rims, S60", Document::Grey, SHARP, 0.6),
    rim("steep rims, S0", Document::Grey, STEEP, 0.0),
    rim("steep rims, S60", Document::Grey, STEEP, 0.6),
    rim("sharp rims, pixels as their centres, S0", Document::Centres, SHARP, 0.0),
    colours("raw colours, soft rims, no cross-talk", Document::Raw, SOFT, 0.0, 0.0),
    colours("raw colours, soft rims, 30 %", Document::Raw, SOFT, 0.0, 0.3),
    colours("raw colours, sharp rims, no cross-talk", Document::Raw, SHARP, 0.0, 0.0),
    colours("raw colours, sharp rims, 15 %", Document::Raw, SHARP, 0.0, 0.15),
    colours("raw colours, sharp rims, 30 %", Document::Raw, SHARP, 0.0, 0.3),
    colours("raw colours, sharp rims, 30 %, S60", Document::Raw, SHARP, 0.6, 0.3),
    colours("raw colours, soft rims, 30 %, S60", Document::Raw, SOFT, 0.6, 0.3),
    colours("ellipses of raw colours, no cross-talk", Document::Ellipses, SHARP, 0.0, 0.0),
    colours("ellipses of raw colours, 15 %", Document::Ellipses, SHARP, 0.0, 0.15),
    colours("ellipses of raw colours, 30 %", Document::Ellipses, SHARP, 0.0, 0.3),
    colours("ellipses of raw colours, 30 %, S60", Document::Ellipses, SHARP, 0.6, 0.3),
    Row { distance_mm: NEAR, ..colours("ellipses of raw colours, 15 %, at 1 m", Document::Ellipses, SHARP, 0.0, 0.15) },
    perturbation("focal length known to 1 %", Document::Grey, Perturbation::Focal(0.01), 0),
    perturbation(
        "focal lengths each to 0.3 %, principal point to 3 px",
        Document::Grey,
        Perturbation::Lens(0.003, 3.0),
        0,
    ),
    Row {
        rim: SHARP,
        ..perturbation("ellipses, focal length known to 1 %", Document::Ellipses, Perturbation::Focal(0.01), 0)
    },
    perturbation("half of one spot out of the picture, cold", Document::Grey, Perturbation::Out(0.5), 0),
    perturbation("half of one spot out of the picture, followed", Document::Grey, Perturbation::Out(0.5), 6),
    perturbation("one spot out of the picture, followed", Document::Grey, Perturbation::Out(1.2), 6),
    perturbation("one white spot, cold", Document::Grey, Perturbation::White(2e4), 0),
    perturbation("one white spot, followed", Document::Grey, Perturbation::White(2e4), 6),
];

/// The head of the table.
pub const HEAD: &str = "| condition | frames | `tracking` | of them wrong | without covariance | position / rotation, rms over bound | NEES | brightness, worst bias | next frame |\n|---|---|---|---|---|---|---|---|---|";

/// Motion per earlier frame, px.
const STEP_PX: f64 = 8.0;

/// Compiled documents.
#[derive(Default)]
pub struct ColdDocuments(BTreeMap<Document, Arc<Compiled>>);

impl ColdDocuments {
    fn get(&mut self, document: Document) -> Arc<Compiled> {
        let compile = || {
            let model = Model::from_toml(&document.text()).unwrap_or_else(|faults| panic!("{faults:?}"));
            Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap())
        };
        self.0.entry(document).or_insert_with(compile).clone()
    }
}

/// Results of a row.
#[derive(Clone, Debug, Default)]
pub struct ColdTally {
    tally: PoseTally,
    /// For each spot, the sum of measured over true brightness less 1.
    brightness: [f64; 3],
    brightness_of: usize,
    times_ms: Vec<f64>,
}

impl ColdTally {
    /// A row of the table.
    pub fn text(&self, name: &str) -> String {
        let [position, rotation] = self.tally.ratios();
        let PoseTally { frames, tracking, silent, .. } = self.tally;
        let (wrong, nees) = (self.tally.wrong(), self.tally.nees());
        let bias = self.brightness.map(|sum| 100.0 * sum / self.brightness_of.max(1) as f64);
        let bias = bias.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
        let mut times = self.times_ms.clone();
        times.sort_by(f64::total_cmp);
        let time = times.get(times.len() / 2).map_or("–".into(), |time| format!("{time:.1} ms"));
        let counts = format!("{frames} | {tracking} | {wrong} | {silent}");
        format!("| {name} | {counts} | {position} / {rotation} | {nees} | {bias:+.1} % | {time} |")
    }

    fn add_brightness(&mut self, model: &Model, estimate: &Estimate, light: &Light) {
        // The brightness of an unseen spot is arbitrary.
        let is_seen = estimate.pose.as_ref().is_some_and(|pose| pose.left_out.is_empty());
        if estimate.state != TrackState::Tracking || !is_seen {
            return;
        }
        let lights = model.roles().iter().filter(|roles| roles.name.is_some()).filter_map(|roles| roles.brightness);
        for (spot, parameter) in lights.enumerate() {
            self.brightness[spot] += estimate.parameters[parameter.index()] / light.brightness[spot] - 1.0;
        }
        self.brightness_of += 1;
    }
}

/// Runs a row.
pub fn run(documents: &mut ColdDocuments, row: Row, frames: usize, seed: u64) -> ColdTally {
    let compiled = documents.get(row.document);
    let (mut tally, mut done, mut number) = (ColdTally::default(), 0, 0_u64);
    while done < frames {
        number += 1;
        let mut random = Random::of(seed.wrapping_add(number));
        done += usize::from(one(&compiled, row, &mut random, &mut tally).is_some());
    }
    tally
}

fn one(compiled: &Arc<Compiled>, row: Row, random: &mut Random, tally: &mut ColdTally) -> Option<()> {
    let height = row.rim.brightness(row.saturated);
    let usual = match row.document.is_coloured() {
        true => Light::mixed(row.rim, height, row.cross_talk),
        false => Light { rim: row.rim, ..Light::grey(height, 3) },
    };
    let mut light = usual.clone();
    let mut target = target(0.0);
    target.mixing = row.document.is_coloured().then(|| Light::matrix(row.cross_talk));
    let distance = random.between(row.distance_mm.0, row.distance_mm.1);
    let mut truth = random_pose(random, distance, (10.0, 50.0));
    match row.perturbation {
        Perturbation::Out(share) => truth = aside(truth, &target, share)?,
        Perturbation::White(brightness) => light.brightness[0] = brightness,
        _ => {}
    }
    let is_out = matches!(row.perturbation, Perturbation::Out(_));
    if target.spots.iter().skip(usize::from(is_out)).any(|spot| place(&truth, spot).is_none()) {
        return None;
    }
    let (told_of, wrong_mm) = perturbed_camera(row.perturbation, random);
    let is_exact = wrong_mm == WRONG_MM;
    let mut tracker = tracker(compiled, &target, row.rim, told_of);
    for frame in (1..=row.before).rev() {
        let mut before = truth;
        before.translation.x += frame as f64 * STEP_PX * truth.translation.z / lens().fx;
        tracker.track(&usual.frame(&before, &target.spots, random));
    }
    let estimate = tracker.track(&light.frame(&truth, &target.spots, random));
    let bound = bound_of(&truth, &target, &light, &|_| true).filter(|_| is_exact);
    tally.tally.add(&truth, &estimate, bound, false, wrong_mm);
    tally.add_brightness(compiled.model(), &estimate, &light);
    let next = light.frame(&truth, &target.spots, random);
    let begin = Instant::now();
    tracker.track(&next);
    tally.times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
    Some(())
}

fn tracker(compiled: &Arc<Compiled>, target: &Target, rim: Rim, camera: Camera) -> Tracker {
    let mut options = TrackerOptions { camera, target: Some(target.clone()), ..TrackerOptions::default() };
    let profile =
        [("k1", rim.k1), ("k2", rim.k2)].into_iter().filter(|(name, _)| compiled.model().constant(name).is_some());
    options.constants = profile.map(|(name, value)| (name.to_string(), value)).collect();
    Tracker::new(compiled.clone(), options).unwrap()
}

/// The camera document given to the tracker, and the tolerance of a pose with it, mm.
fn perturbed_camera(perturbation: Perturbation, random: &mut Random) -> (Camera, f64) {
    let exact = lens();
    let variance = |share: f64| (share * exact.fx).powi(2);
    let (intrinsics, share) = match perturbation {
        Perturbation::Focal(share) => {
            let (factor, v) = (1.0 + share * random.normal(), variance(share));
            let covariance = vec![vec![v, v, 0.0, 0.0], vec![v, v, 0.0, 0.0], vec![0.0; 4], vec![0.0; 4]];
            (Intrinsics { fx: exact.fx * factor, fy: exact.fy * factor, covariance: Some(covariance), ..exact }, share)
        }
        Perturbation::Lens(share, px) => {
            let variances = [variance(share), variance(share), px * px, px * px];
            let row = |i: usize| (0..4).map(|j| if i == j { variances[i] } else { 0.0 }).collect();
            let covariance = Some((0..4).map(row).collect());
            let [fx, fy] = [exact.fx, exact.fy].map(|f| f * (1.0 + share * random.normal()));
            let [cx, cy] = [exact.cx, exact.cy].map(|c| c + px * random.normal());
            (Intrinsics { fx, fy, cx, cy, covariance, ..exact }, share)
        }
        _ => (exact, 0.0),
    };
    // Errors of the lens do not make a pose wrong: allow four standard deviations and more.
    let wrong_mm = if share > 0.0 { WRONG_MM + 6.0 * share * 1000.0 } else { WRONG_MM };
    (Camera { intrinsics: Some(intrinsics), ..camera() }, wrong_mm)
}

/// Shifts the pose to the left, so that the first spot is out of the picture by a share of its width; `None` if the
/// others would be as well.
fn aside(mut pose: Rigid, target: &Target, share: f64) -> Option<Rigid> {
    for _ in 0..3 {
        let [x, _, w, _] = bounds(&lens(), &pose, &target.spots[0])?;
        let wanted = (1.0 - 2.0 * share) * w;
        pose.translation.x += (wanted - x) * pose.apply(target.spots[0].position_mm.into()).z / lens().fx;
    }
    Some(pose)
}
