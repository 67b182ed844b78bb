//! `cargo bench -p isophote-benches --bench formulas [-- --confidence-min P]`: fits formulas that a user may write,
//! none of them exact, to frames of Isophote's spot: cold, and tracked. Twelve edits of `spot`'s profile, three
//! shipped models, three other documents. Recognition is off unless a confidence is given. The time of a cold fit is
//! the best of three, with compiled kernels.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::sync::Arc;
use std::time::Instant;

use isophote_benches::accuracy::condition::{Condition, condition};
use isophote_benches::accuracy::document::frame;
use isophote_benches::accuracy::scene::{Beside, Scene};
use isophote_benches::accuracy::sensor::Random;
use isophote_benches::tracked::subject::camera;
use isophote_benches::{edited, text};
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Estimate, Frame, TrackState, Tracker, TrackerOptions};

/// Profiles that replace that of `spot`.
const EDITS: [&str; 12] = [
    "exp(-s)",
    "exp(-2*s)",
    "1/(1 + s)^2",
    "1/(1 + s^2)",
    "1/cosh(2*s)",
    "exp(-s^2)",
    "1/(1 + exp((s - 1)/0.2))",
    "erfc(s)",
    "if(s <= 1, (1 - s)^2, 0)",
    "if(s <= 1, cos(pi*s/2)^2, 0)",
    "if(s <= 1, sqrt(1 - s), 0)",
    "if(s <= 1, (1 - s)^3, 0)",
];
const SHIPPED: [&str; 4] = ["spot", "gaussian", "moffat", "bright-disc"];
const OTHERS: [(&str, &str); 3] = [
    ("soft-ball", include_str!("../documents/soft-ball.toml")),
    ("stretched", include_str!("../documents/stretched.toml")),
    ("lorentz-plane", include_str!("../documents/lorentz-plane.toml")),
];
/// Tracked frames after the first.
const FOLLOWED: usize = 20;
/// Speed along x, px per frame.
const SPEED_PX: f64 = 0.3;
/// Tolerance of a correct fit, px.
const RIGHT_PX: f64 = 0.1;

fn off(estimate: &Estimate, scene: &Scene) -> f64 {
    let at = |axis: usize| estimate.parameters.get(axis).map_or(f64::NAN, |value| value - scene.centre[axis]);
    at(0).hypot(at(1))
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let asked = arguments.iter().position(|argument| argument == "--confidence-min");
    let confidence_min = asked.map_or(0.0, |at| arguments[at + 1].parse().unwrap());
    let documents = EDITS.iter().map(|formula| (formula.to_string(), edited(formula)));
    let documents = documents.chain(SHIPPED.iter().map(|name| (name.to_string(), text(name))));
    let documents = documents.chain(OTHERS.iter().map(|(name, text)| (name.to_string(), text.to_string())));
    println!(
        "| formula | size, px | state | ending | substitute: degree, hidden | centre off, px | χ²/ν | passes | cold, ms | followed, ms | right of {FOLLOWED} |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let (mut right, mut all) = (0, 0);
    for (name, text) in documents {
        let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap());
        for semi_axes_px in [[20.0, 14.0], [6.0, 4.5], [60.0, 42.0]] {
            let mut random = Random::of("formulas", 0);
            let what = Condition { semi_axes_px, side_px: 320, ..condition("S0") };
            let mut scene = Scene::draw(what, &mut random);
            let mut shot = |scene: &Scene| -> Frame {
                let light = scene.light(&scene.unknowns(Beside::Even));
                frame(random.exposed(&light), scene.condition.side_px)
            };
            let options = || TrackerOptions { camera: camera(), confidence_min, ..TrackerOptions::default() };
            let image = shot(&scene);
            let mut times = Vec::new();
            let mut best = None;
            for _ in 0..4 {
                let mut tracker = Tracker::new(compiled.clone(), options()).unwrap();
                let begin = Instant::now();
                let estimate = tracker.track(&image);
                times.push(begin.elapsed().as_secs_f64() * 1e3);
                best = Some((tracker, estimate));
            }
            let (mut tracker, estimate) = best.unwrap();
            let cold = times[1..].iter().copied().fold(f64::INFINITY, f64::min);
            let (mut followed, mut kept) = (Vec::new(), 0);
            let first = scene.centre[0];
            for number in 1..=FOLLOWED {
                scene.centre[0] = first + SPEED_PX * number as f64;
                let image = shot(&scene);
                let begin = Instant::now();
                let estimate = tracker.track(&image);
                followed.push(begin.elapsed().as_secs_f64() * 1e3);
                kept += u32::from(estimate.state == TrackState::Tracking && off(&estimate, &scene) <= RIGHT_PX);
            }
            scene.centre[0] = first;
            followed.sort_by(f64::total_cmp);
            let is_right = estimate.converged && off(&estimate, &scene) <= RIGHT_PX;
            (right, all) = (right + u32::from(is_right), all + 1);
            let passes: u32 = estimate.stages.iter().map(|stage| stage.passes).sum();
            let substitute =
                estimate.substitute.map_or(String::new(), |one| format!("{}, {:.0} %", one.degree, 100.0 * one.hidden));
            println!(
                "| `{name}` | {} × {} | {:?} | {} | {substitute} | {:.4} | {:.1} | {passes} | {cold:.1} | {:.2} | {kept} |",
                semi_axes_px[0],
                semi_axes_px[1],
                estimate.state,
                estimate.ending.name(),
                off(&estimate, &scene),
                estimate.reduced_chi_square.unwrap_or(f64::NAN),
                followed[FOLLOWED / 2],
            );
        }
    }
    println!("\nconverged and within {RIGHT_PX} px: {right} of {all}");
}
