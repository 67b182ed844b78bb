//! A cold start tries the numbers that a document lists.
#![allow(clippy::unwrap_used)]
use super::*;
use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

const FRINGES: &str = r#"
name = "fringes"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
v0 = { start = 100.0 }
v1 = { start = 50.0, min = 0.0 }
angle = { start = LIST }
phase = { start = PHASES }
[model]
intensity = "v0 + v1 * cos(0.5 * (x * cos(angle) + y * sin(angle)) + phase)"
"#;

/// Fringes at 81° and a phase of 1.
fn frame() -> Frame {
    let (angle, phase) = (81.0_f64.to_radians(), 1.0);
    let value = |i: usize| {
        let (x, y) = ((i % 64) as f64, (i / 64) as f64);
        110.0 + 60.0 * (0.5 * (x * angle.cos() + y * angle.sin()) + phase).cos()
    };
    Frame::new(
        &[64, 48],
        vec![Plane::owned(PixelFormat::U8, (0..64 * 48).map(|i| value(i).round() as u8).collect(), 64)],
    )
    .unwrap()
}

fn fitted(list: &str, phases: &str, given: Option<f64>) -> Estimate {
    let document = FRINGES.replace("LIST", list).replace("PHASES", phases);
    let compiled = Compiled::new(Arc::new(Model::from_toml(&document).unwrap()), Precision::F32).unwrap();
    let start = given.map(|angle| ("angle".to_string(), angle)).into_iter().collect();
    let options = TrackerOptions { start, ..TrackerOptions::default() };
    Tracker::new(Arc::new(compiled), options).unwrap().track(&frame())
}

#[test]
fn the_best_fit_of_the_listed_starts_is_taken() {
    let found = fitted("[0.0, 0.7, 1.4, 2.1]", "[0.0, 2.0, 4.0]", None);
    assert!((found.parameters[2] - 81.0_f64.to_radians()).abs() < 1e-3, "{found:?}");
    assert!((found.parameters[3] - 1.0).abs() < 1e-2, "{found:?}");
    // The first of them alone leads to another minimum, and so does a given number that overrides the list.
    for (list, given) in [("0.0", None), ("[0.0, 0.7, 1.4, 2.1]", Some(0.0))] {
        let alone = fitted(list, "0.0", given);
        assert!((alone.parameters[2] - 81.0_f64.to_radians()).abs() > 0.1, "{alone:?}");
    }
}
