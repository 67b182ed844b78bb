//! Verdicts: whether a fit is the target, in cold starts in cluttered frames, with and without a target. Writes tables
//! and the file of the verdict's weights.
//!
//! Each kind of object, and each document, is also judged by weights learned without it.

pub mod logistic;
pub mod report;
pub mod scene;
pub mod things;

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{CONFIDENCE_MIN, Compiled, Estimate, Signs, TrackState, Tracker, TrackerOptions};

use super::shared_out;
use crate::tracked::subject::camera;
use logistic::{Logistic, TrainingExample};
use scene::{Document, Truth, scene};
use things::Kind;

/// Tolerance of a correct fit, px.
const RIGHT_PX: f64 = 2.0;
/// Tolerance of a correct fit as a share of the size; the larger tolerance counts.
const RIGHT_SHARE: f64 = 1.0 / 7.0;
/// Tolerance of the size of a correct fit, as a factor.
const RIGHT_SIZE: f64 = 1.5;

/// The outcome of a frame.
pub struct Example {
    /// Index of its document.
    pub document: usize,
    /// Kind of the other objects.
    pub kind: Kind,
    /// Signal-to-noise ratio of the target, if there is one.
    pub snr: Option<f64>,
    /// The likeliest fit, if it has signs.
    pub fit: Option<JudgedFit>,
    /// The object with the state `tracking` by default options, if any.
    pub accepted: Option<AcceptedFit>,
}

/// An object with the state `tracking`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct AcceptedFit {
    /// Whether it is the target.
    pub is_right: bool,
    /// Whether it was accepted as a lone object, with a confidence below the limit.
    pub is_lone: bool,
}

/// A fit, and whether it is right.
pub struct JudgedFit {
    /// Features of the fit.
    pub signs: Signs,
    /// Confidence of the product.
    pub confidence: f64,
    /// Whether it is the target.
    pub is_right: bool,
}

/// The documents: shipped ones, and variants of `spot` with other profiles.
pub fn documents() -> Vec<Document> {
    let shipped = |name: &str, profile: fn(f64, f64) -> f64, extra: [f64; 2], same: Option<Kind>| Document {
        name: name.to_string(),
        text: crate::text(name),
        profile,
        extra,
        same,
    };
    let edited = |formula: &str, profile: fn(f64, f64) -> f64| Document {
        name: formula.to_string(),
        text: crate::edited(formula),
        profile,
        extra: [0.0; 2],
        same: None,
    };
    vec![
        shipped(
            "spot",
            |s, _| if s > 1.0 { 0.0 } else { 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s.powi(3) },
            [0.0; 2],
            None,
        ),
        shipped("gaussian", |s, _| (-2.0 * s).exp(), [0.0; 2], None),
        shipped("moffat", |s, b| (1.0 + s).powf(-b), [2.0, 5.0], None),
        shipped("ring", |s, e| (-((s - 1.0) / e).powi(2)).exp(), [0.25, 0.9], Some(Kind::Ring)),
        shipped("bright-disc", |s, e| 0.5 * (1.0 - ((s - 1.0) / e).tanh()), [0.12, 0.7], Some(Kind::Disc)),
        edited("exp(-s^2)", |s, _| (-s * s).exp()),
        edited("1/(1 + s^2)", |s, _| 1.0 / (1.0 + s * s)),
        edited("if(s <= 1, (1 - s)^2, 0)", |s, _| if s > 1.0 { 0.0 } else { (1.0 - s).powi(2) }),
    ]
}

/// Runs that many frames of each document, from number `first` on.
pub fn examples(frames: usize, first: u64) -> Vec<Example> {
    let documents = documents();
    let seen = documents.iter().enumerate().map(|(number, document)| {
        let model = Arc::new(Model::from_toml(&document.text).unwrap());
        let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
        let begin = std::time::Instant::now();
        let parts = shared_out(frames, |frame| example((number, document), &compiled, first + frame));
        eprintln!("{}: {:.0} s", document.name, begin.elapsed().as_secs_f64());
        parts.into_iter().flatten().collect::<Vec<Example>>()
    });
    seen.flatten().collect()
}

fn example((number, document): (usize, &Document), compiled: &Arc<Compiled>, frame: u64) -> Example {
    // A quarter of the frames contain only a target, or noise.
    let kind = match frame % 4 {
        0 => Kind::Nothing,
        _ => Kind::ALL[1 + (frame - frame / 4) as usize % (Kind::ALL.len() - 1)],
    };
    let scene = scene(document, kind, frame + 1_000_003 * number as u64);
    let is_target = |estimate: &Estimate| scene.target.is_some_and(|truth| is_right(&document.name, &truth, estimate));
    let options = || TrackerOptions { camera: camera(), ..TrackerOptions::default() };
    let mut any = Tracker::new(compiled.clone(), TrackerOptions { confidence_min: 0.0, ..options() }).unwrap();
    let likeliest = any.track(&scene.frame);
    let is_tracking = likeliest.state == TrackState::Tracking;
    let signs = is_tracking.then(|| any.signs(&scene.frame, &likeliest)).flatten();
    let usual = is_tracking.then(|| Tracker::new(compiled.clone(), options()).unwrap().track(&scene.frame));
    let accepted = usual.filter(|estimate| estimate.state == TrackState::Tracking);
    Example {
        document: number,
        kind,
        snr: scene.target.map(|truth| truth.snr),
        fit: signs.zip(likeliest.confidence).map(|(signs, confidence)| JudgedFit {
            signs,
            confidence,
            is_right: is_target(&likeliest),
        }),
        accepted: accepted.map(|estimate| AcceptedFit {
            is_right: is_target(&estimate),
            is_lone: estimate.confidence.is_some_and(|confidence| confidence < CONFIDENCE_MIN),
        }),
    }
}

/// Whether an estimate matches the target's position and size.
fn is_right(document: &str, truth: &Truth, estimate: &Estimate) -> bool {
    let &[bx, by, a1, a2, a3, extra, ..] = &estimate.parameters[..] else { return false };
    let (size, mut own) = ((truth.half[0] * truth.half[1]).sqrt(), (a1 * a3 - a2 * a2).powf(-0.25));
    if document == "moffat" {
        // Outline and exponent are correlated: use the half width at half maximum as the size.
        let half = |b: f64| (2.0_f64.powf(1.0 / b) - 1.0).sqrt();
        own *= half(extra) / half(truth.extra);
    }
    let off = (bx - truth.centre[0]).hypot(by - truth.centre[1]);
    off < RIGHT_PX.max(RIGHT_SHARE * size) && (own / size).ln().abs() < RIGHT_SIZE.ln()
}

/// Cross-validation: the probability of each fit by weights learned from the other groups, with the first `numbers`
/// features.
fn crossed<G: PartialEq>(fits: &[(&Example, &JudgedFit)], numbers: usize, group: impl Fn(&Example) -> G) -> Vec<f64> {
    let mut found = vec![f64::NAN; fits.len()];
    for first in 0..fits.len() {
        if !found[first].is_nan() {
            continue;
        }
        let own = group(fits[first].0);
        let others = fits.iter().filter(|(one, _)| group(one) != own);
        let line = Logistic::fit(&others.map(|(_, fit)| learnt(fit, numbers)).collect::<Vec<TrainingExample>>());
        for ((_, fit), found) in fits.iter().zip(&mut found).filter(|((one, _), _)| group(one) == own) {
            *found = line.probability(&fit.signs.numbers()[..numbers], fit.signs.noise);
        }
    }
    found
}

fn learnt(JudgedFit { signs, is_right, .. }: &JudgedFit, numbers: usize) -> TrainingExample {
    TrainingExample { numbers: signs.numbers()[..numbers].to_vec(), beside: signs.noise, is_right: *is_right }
}

/// The source file of the weights learned from these frames.
pub fn learned(examples: &[Example], [frames, first]: [usize; 2]) -> String {
    let all: Vec<TrainingExample> =
        examples.iter().filter_map(|one| Some(learnt(one.fit.as_ref()?, Signs::NAMES.len()))).collect();
    let line = Logistic::fit(&all);
    let right = all.iter().filter(|one| one.is_right).count();
    let mut text = format!(
        "//! Learned: `cargo bench -p isophote-benches --bench verdict -- --learn {frames} {first}` writes this file.\n//!\n\
         //! From {} fits, {right} of which are right, in rendered scenes with documents of these digests:\n",
        all.len()
    );
    for document in documents() {
        let model = Model::from_toml(&document.text).unwrap();
        text += &format!("//! - {} {}\n", model.digest(), document.name);
    }
    text += "\n/// ln odds of the target against another thing, where all numbers are 0.\n";
    text += &format!("pub(super) const PRIOR: f64 = {:.3};\n", line.prior);
    text += "/// The weight of each of [`super::Signs::numbers`].\n";
    let weights: Vec<String> = line.weights.iter().map(|weight| format!("{weight:.3}")).collect();
    text + &format!("pub(super) const WEIGHTS: [f64; {}] = [{}];\n", weights.len(), weights.join(", "))
}
