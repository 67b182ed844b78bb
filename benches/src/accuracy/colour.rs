//! A red spot in a colour camera with cross-talk of 25 % and 10 %: the error of its brightness from an unmixed
//! picture, where a pixel is dropped if any channel clips, against raw channels, each censored by itself.

use std::fmt::Write;
use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Camera, Compiled, Frame, InTurn, Plane, TrackState, Tracker, TrackerOptions};

use super::condition::{Condition, condition};
use super::run::each;
use super::scene::{Beside, Scene};
use super::sensor::{FULL, Random};

/// Response of red, green and blue to the red light.
const RED: [f64; 3] = [1.0, 0.25, 0.10];
/// DN
const GROUND: f64 = 20.0;
/// Common to both documents.
const SPOT: &str = r#"
coordinates = ["x", "y"]
channels = ["r", "g", "b"]
[constants]
gain = 0.051
read_noise = 0.765
[roles]
centre = ["bx", "by"]
shape = ["a1", "a2", "a3"]
brightness = "v1"
[definitions]
d = "[x - bx, y - by]"
s = "d' * [[a1, a2], [a2, a3]] * d"
u = "v1 * if(s <= 1, 1 - 1.5*s + 0.5*s^3, 0)"
"variance(mean)" = "read_noise^2 + 1/12 + gain * max(mean, 0)"
"#;
const PARAMETERS: &str = r#"
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a1 = { start = "extent.xx", min = 0.0 }
a2 = { start = "extent.xy" }
a3 = { start = "extent.yy", min = 0.0 }
v1 = { start = "amplitude", min = 0.0 }
"#;
/// Uses the first row of the inverse of [[1, 0.1, 0.25], [0.25, 1, 0.1], [0.1, 0.25, 1]], which sums to 1/1.35.
const UNMIXED: &str = r#"
v0 = { start = 14.8 }
[model]
observed = "(0.975*r - 0.0375*g - 0.24*b) / 0.941625"
intensity = "v0 + u"
domain = "s <= 2.2"
constraint = "a1*a3 - a2^2 > 0"
noise = "(0.975^2 * variance(20 + u) + 0.0375^2 * variance(20 + 0.25*u) + 0.24^2 * variance(20 + 0.10*u)) / 0.941625^2"
saturated = "dropped"
quadrature = 2
"#;
const RAW: &str = r#"
v0r = { start = 20.0 }
v0g = { start = 20.0 }
v0b = { start = 20.0 }
[model]
observed = "[r, g, b]"
intensity = "u * [1, 0.25, 0.10] + [v0r, v0g, v0b]"
domain = "s <= 2.2"
constraint = "a1*a3 - a2^2 > 0"
noise = "variance(intensity)"
saturated = "censored"
quadrature = 2
"#;

/// Relative errors of one document at one exposure.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Mean.
    pub bias: f64,
    /// Root mean square.
    pub rms: f64,
    /// Frames without an answer.
    pub lost: usize,
}

/// One exposure.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Share of the spot's area at the red channel's limit.
    pub saturated: f64,
    /// Unmixed and dropped, then raw and censored.
    pub errors: [Errors; 2],
}

/// The rows of the table, each over that many frames.
pub fn measure(frames: usize) -> Vec<Row> {
    let documents = [UNMIXED, RAW].map(compiled);
    [("colour S30", 0.3), ("colour S60", 0.6), ("colour S80", 0.8)]
        .map(|(name, saturated)| {
            let condition = Condition { name, saturated, ..condition("S30") };
            let errors = each(frames, |number| {
                let (scene, frame) = shot(condition, number);
                documents.each_ref().map(|document| answer(document, &frame, &scene))
            });
            let of = |which: usize| Errors::of(&errors.iter().map(|both| both[which]).collect::<Vec<_>>());
            Row { saturated, errors: [of(0), of(1)] }
        })
        .to_vec()
}

/// The table.
pub fn table(rows: &[Row], frames: usize) -> String {
    let mut text = String::from(
        "| red clips over | unmixed, dropped: error of the brightness, % (bias) | raw, censored: error, % (bias) | ratio |\n|---|---|---|---|\n",
    );
    for Row { saturated, errors: [unmixed, raw] } in rows {
        let cell = |errors: &Errors| {
            let lost = if errors.lost > 0 { format!(", {} without an answer", errors.lost) } else { String::new() };
            format!("{:.3} ({:+.3}){lost}", 100.0 * errors.rms, 100.0 * errors.bias)
        };
        let ratio = unmixed.rms / raw.rms;
        writeln!(text, "| {:.0} % | {} | {} | {ratio:.1} |", 100.0 * saturated, cell(unmixed), cell(raw)).unwrap();
    }
    write!(text, "\n{frames} frames a row, of 96 × 96 px.").unwrap();
    text
}

impl Errors {
    fn of(errors: &[Option<f64>]) -> Errors {
        let found: Vec<f64> = errors.iter().flatten().copied().collect();
        let mean = |value: &dyn Fn(f64) -> f64| found.iter().map(|e| value(*e)).sum::<f64>() / found.len() as f64;
        Errors { bias: mean(&|e| e), rms: mean(&|e| e * e).sqrt(), lost: errors.len() - found.len() }
    }
}

fn compiled(part: &str) -> Arc<Compiled> {
    let text = format!("name = \"red\"{SPOT}{PARAMETERS}{}", part.trim_start());
    let model = Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}", faults[0].render("red")));
    let compiled = Compiled::new(Arc::new(model), Precision::F32).unwrap();
    compiled.warm(PixelFormat::U8, &InTurn).unwrap();
    Arc::new(compiled)
}

fn shot(condition: Condition, number: usize) -> (Scene, Frame) {
    let mut random = Random::of(condition.name, number);
    let scene = Scene::draw(condition, &mut random);
    let side = condition.side_px;
    let light = scene.light(&scene.unknowns(Beside::Even));
    let planes = RED.map(|share| {
        let seen: Vec<f64> = light.iter().map(|value| GROUND + share * (value - GROUND)).collect();
        Plane::owned(PixelFormat::U8, random.exposed(&seen), side)
    });
    (scene, Frame::new(&[side, side], planes.to_vec()).unwrap())
}

/// The relative error of the brightness, from a start with errors of 8 % and 20 %.
fn answer(document: &Arc<Compiled>, frame: &Frame, scene: &Scene) -> Option<f64> {
    let ([bx, by], [a1, a2, a3]) = (scene.centre, scene.shape);
    let start = [("bx", bx + 0.7), ("by", by - 0.7), ("a1", 1.08 * a1), ("a2", a2), ("a3", 1.08 * a3)];
    let start = start.into_iter().chain([("v1", 0.8 * scene.brightness)]);
    let options = TrackerOptions {
        start: start.map(|(name, value)| (name.to_string(), value)).collect(),
        camera: Camera { saturation: Some(FULL), ..Camera::default() },
        ..TrackerOptions::default()
    };
    let estimate = Tracker::new(document.clone(), options).unwrap().track(frame);
    let brightness = document.model().parameter("v1").unwrap();
    let answer = estimate.parameters.get(brightness.index()).filter(|_| estimate.state == TrackState::Tracking);
    answer.map(|value| value / scene.brightness - 1.0)
}
