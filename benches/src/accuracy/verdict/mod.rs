//! Whether something that was fitted is the target: what a verdict says of fits in frames that it was not learned from, beside the
//! confidence of the product.
//!
//! What comes in: documents and numbers of frames. What goes out: tables, and the weights. Each kind of thing, and each document, is
//! judged by weights that were learned without it.

pub mod logistic;
pub mod scene;
pub mod things;

use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Ending, Estimate, TrackState, Tracker, TrackerOptions};

use crate::accuracy::clutter::shared_out;
use crate::tracked::subject::camera;
use logistic::{Logistic, area_under_curve, log_loss, wrong_at};
use scene::{Document, Truth, scene};
use things::Kind;

/// A fit is right within this, px, …
const RIGHT_PX: f64 = 2.0;
/// … or this share of the size, …
const RIGHT_SHARE: f64 = 1.0 / 7.0;
/// … and where its size is right but for this factor.
const RIGHT_SIZE: f64 = 1.5;
/// The confidence from which the product takes a fit.
const TAKEN: f64 = 0.4;

/// What is known of a fit.
pub struct Example {
    /// The number of its document.
    pub document: usize,
    /// What was beside the target.
    pub kind: Kind,
    /// See [`NUMBERS`].
    pub numbers: Vec<f64>,
    /// ln of the number of fits in noise, a frame, that are as significant.
    pub noise: f64,
    /// The product's.
    pub confidence: f64,
    /// It is the target.
    pub is_right: bool,
    /// Signal-to-noise ratio of the target, where there is one.
    pub snr: f64,
}

/// Names of [`Example::numbers`].
pub const NUMBERS: [&str; 7] = ["evidence", "ended", "cut off", "hidden", "saturated", "covered", "others"];

/// The documents: as shipped, and others with a profile of their own in the place of `spot`'s.
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

/// Fits of so many frames of each document, those that are one.
pub fn examples(frames: usize, first: u64) -> Vec<Example> {
    let documents = documents();
    let fitted = documents.iter().enumerate().map(|(number, document)| {
        let model = Arc::new(Model::from_toml(&document.text).unwrap());
        let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
        let begin = std::time::Instant::now();
        let parts = shared_out(frames, |frame| example((number, document), &compiled, first + frame));
        let parts: Vec<Example> = parts.into_iter().flatten().flatten().collect();
        eprintln!("{}: {} fits, {:.0} s", document.name, parts.len(), begin.elapsed().as_secs_f64());
        parts
    });
    fitted.flatten().collect()
}

fn example((number, document): (usize, &Document), compiled: &Arc<Compiled>, frame: u64) -> Option<Example> {
    // A quarter of the frames have nothing but a target, or noise.
    let kind = match frame % 4 {
        0 => Kind::Nothing,
        _ => Kind::ALL[1 + (frame - frame / 4) as usize % (Kind::ALL.len() - 1)],
    };
    let scene = scene(document, kind, frame + 1_000_003 * number as u64);
    let options = TrackerOptions { camera: camera(), confidence_min: 0.0, ..TrackerOptions::default() };
    let mut tracker = Tracker::new(compiled.clone(), options).unwrap();
    let estimate = tracker.track(&scene.frame);
    if estimate.state != TrackState::Tracking {
        return None;
    }
    let signs = tracker.signs(&scene.frame, &estimate)?;
    let ended = f64::from(u8::from(estimate.ending != Ending::SmallStep));
    let hidden = estimate.substitute.map_or(0.0, |substitute| substitute.hidden);
    Some(Example {
        document: number,
        kind,
        numbers: vec![
            signs.evidence,
            ended,
            signs.cut_off,
            hidden,
            signs.saturated,
            signs.covered,
            signs.others.ln_1p(),
        ],
        noise: signs.noise,
        confidence: estimate.confidence?,
        is_right: scene.target.is_some_and(|truth| is_right(&document.name, &truth, &estimate)),
        snr: scene.target.map_or(0.0, |truth| truth.snr),
    })
}

/// Whether an estimate is of the target, in place and in size.
fn is_right(document: &str, truth: &Truth, estimate: &Estimate) -> bool {
    let &[bx, by, a1, a2, a3, extra, ..] = &estimate.parameters[..] else { return false };
    let (size, mut own) = ((truth.half[0] * truth.half[1]).sqrt(), (a1 * a3 - a2 * a2).powf(-0.25));
    if document == "moffat" {
        // Outline and exponent go together: the half width at half maximum says the size.
        let half = |b: f64| (2.0_f64.powf(1.0 / b) - 1.0).sqrt();
        own *= half(extra) / half(truth.extra);
    }
    let off = (bx - truth.centre[0]).hypot(by - truth.centre[1]);
    off < RIGHT_PX.max(RIGHT_SHARE * size) && (own / size).ln().abs() < RIGHT_SIZE.ln()
}

/// The probability of each example by weights that were learned from those of other groups.
pub fn crossed<G: PartialEq>(examples: &[Example], numbers: &[usize], group: impl Fn(&Example) -> G) -> Vec<f64> {
    let of = |example: &Example| numbers.iter().map(|i| example.numbers[*i]).collect::<Vec<f64>>();
    let mut found = vec![f64::NAN; examples.len()];
    for first in 0..examples.len() {
        if !found[first].is_nan() {
            continue;
        }
        let own = group(&examples[first]);
        let others: Vec<(Vec<f64>, f64, bool)> =
            examples.iter().filter(|one| group(one) != own).map(|one| (of(one), one.noise, one.is_right)).collect();
        let line = Logistic::fit(&others);
        for (example, found) in examples.iter().zip(&mut found).filter(|(one, _)| group(one) == own) {
            *found = line.probability(&of(example), example.noise);
        }
    }
    found
}

/// The tables.
pub fn report(examples: &[Example]) -> String {
    let documents = documents();
    let mut text = "| | fits | right | | AUC | log loss | wrong taken at the recall of confidence ≥ 0.4 | at 95 % |\n|---|---|---|---|---|---|---|---|\n".to_string();
    let numbers = [0, 1, 2, 4, 5, 6];
    let ways = [
        ("confidence", examples.iter().map(|one| one.confidence).collect::<Vec<f64>>()),
        ("kind left out", crossed(examples, &numbers, |one| one.kind)),
        ("document left out", crossed(examples, &numbers, |one| one.document)),
        ("hidden for covered", crossed(examples, &[0, 1, 2, 3, 4, 6], |one| one.kind)),
        ("without others", crossed(examples, &[0, 1, 2, 4, 5], |one| one.kind)),
        ("evidence alone", crossed(examples, &[0], |one| one.kind)),
    ];
    let mut line = |name: &str, is: &dyn Fn(&Example) -> bool| {
        for (way, told) in &ways {
            let own: Vec<(f64, bool)> =
                examples.iter().zip(told).filter(|(one, _)| is(one)).map(|(one, p)| (*p, one.is_right)).collect();
            let right = own.iter().filter(|(_, is)| *is).count();
            let taken = examples.iter().filter(|one| is(one) && one.is_right && one.confidence >= TAKEN).count();
            let recall = taken as f64 / right.max(1) as f64;
            text += &format!(
                "| {name} | {} | {:.2} | {way} | {:.3} | {:.3} | {:.1} % | {:.1} % |\n",
                own.len(),
                right as f64 / own.len().max(1) as f64,
                area_under_curve(&own),
                log_loss(&own),
                100.0 * wrong_at(&own, recall),
                100.0 * wrong_at(&own, 0.95),
            );
        }
    };
    line("all", &|_| true);
    for (number, document) in documents.iter().enumerate() {
        line(&document.name, &|one| one.document == number);
    }
    for kind in Kind::ALL {
        line(&kind.name(), &|one| one.kind == kind);
    }
    let all: Vec<(Vec<f64>, f64, bool)> =
        examples.iter().map(|one| (numbers.map(|i| one.numbers[i]).to_vec(), one.noise, one.is_right)).collect();
    let learned = Logistic::fit(&all);
    text += &format!("\nln odds = {:.2}", learned.prior);
    for (i, weight) in numbers.iter().zip(&learned.weights) {
        text += &format!(" {weight:+.3} {}", NUMBERS[*i]);
    }
    text + "\n"
}
