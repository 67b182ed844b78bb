//! `calibrate response`, run as a user runs it: from an even field in several lights to a camera document by which fits are honest.

use std::path::Path;

use isophote_tracker::{CameraResponse, GainMap};
use serde_json::Value;

use crate::{failure, model, output, text};

const SIZE: [usize; 2] = [96, 80];
const SPOT: &str = "bx=48,by=40,a1=0.004,a2=0,a3=0.006,k1=-0.5,k2=-0.3,v0=20,v1=150";

/// A camera for screens, with a black level of 16 DN and pixels that differ by 2 %.
fn camera() -> Value {
    let mut state: u64 = 3;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    // Of twelve uniform numbers the sum is almost normally distributed, with a variance of 1.
    let mut gain = || 1.0 + 0.02 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
    let gains: Vec<f64> = (0..SIZE[0] * SIZE[1]).map(|_| gain()).collect();
    let response = CameraResponse { gamma: 0.45, gains: Some(GainMap::of(SIZE[0], SIZE[1], &gains)) };
    serde_json::json!({
        "black": 16, "saturation": 255, "electrons_per_dn": 20, "read_noise_e": 15, "response": response
    })
}

fn render(camera: &Path, out: &Path, document: &str, scene: &str, frames: &str, seed: &str) {
    let (document, size) = (model(document), format!("{}x{}", SIZE[0], SIZE[1]));
    let common = ["render", text(&document), "--camera", text(camera), "--out", text(out), "--size", &size];
    output(&[&common[..], &["--set", scene, "--frames", frames, "--seed", seed, "--samples", "4"]].concat());
}

fn even(light: f64) -> String {
    format!("bx=48,by=40,a1=0.01,a2=0,a3=0.01,v0={light},v1=0")
}

/// The mean of the square of the centre's error in standard deviations, 2 where it is honest, and the mean error of the brightness, %.
fn honesty(frames: &Path, more: &[&str]) -> [f64; 2] {
    let spot = model("spot.toml");
    let fitted = output(&[&["fit", text(&spot), "--frames", text(frames), "--json"], more].concat());
    let (mut nees, mut bias, mut count) = (0.0, 0.0, 0.0);
    for line in fitted.lines() {
        let estimate: Value = serde_json::from_str(line).unwrap();
        assert_eq!(estimate["state"], "tracking", "{line}");
        let of = |part: &Value, name: &str| part[name].as_f64().unwrap();
        let c = |row: usize, column: usize| estimate["covariance"][row][column].as_f64().unwrap();
        let [dx, dy] = [("bx", 48.0), ("by", 40.0)].map(|(name, truth)| of(&estimate["parameters"], name) - truth);
        let determinant = c(0, 0) * c(1, 1) - c(0, 1) * c(1, 0);
        nees += (dx * dx * c(1, 1) - 2.0 * dx * dy * c(0, 1) + dy * dy * c(0, 0)) / determinant;
        bias += of(&estimate["parameters"], "v1") / 150.0 - 1.0;
        count += 1.0;
    }
    [nees / count, 100.0 * bias / count]
}

#[test]
fn fits_through_a_measured_response_are_honest() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (truth, measured, frames) = (path("truth.json"), path("measured.json"), path("frames"));
    std::fs::write(&truth, camera().to_string()).unwrap();
    let noise = path("noise.json");
    std::fs::write(&noise, r#"{"saturation": 255, "electrons_per_dn": 20, "read_noise_e": 15}"#).unwrap();

    // An even field in six lights, in units of their own. Noise without light is clipped at 0, which says nothing of black.
    render(&truth, &path("dark"), "gaussian.toml", &even(0.0), "8", "1");
    let mut flats = Vec::new();
    for (number, light) in [20.0, 35.0, 60.0, 100.0, 150.0, 200.0].into_iter().enumerate() {
        let out = path(&format!("flat-{number}"));
        render(
            &truth,
            &out,
            "gaussian.toml",
            &even(light),
            if light == 200.0 { "16" } else { "4" },
            &format!("{number}"),
        );
        flats.extend(["--flat".to_string(), format!("{}={}", light / 40.0, text(&out))]);
    }
    let flats: Vec<&str> = flats.iter().map(String::as_str).collect();
    let (dark, noise) = (path("dark"), text(&noise));
    let calibrate = [&["calibrate", "response", "--dark", text(&dark), "--camera", noise], &flats[..]].concat();
    let printed = output(&[&calibrate[..], &["--json", "--out", text(&measured)]].concat());
    let answer: Value = serde_json::from_str(&printed).unwrap();
    let near = |name: &str, sigma: &str, truth: f64, most: f64| {
        let [value, sigma] = [name, sigma].map(|name| answer[name].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * sigma && sigma < most, "{name} {value} ± {sigma}");
    };
    near("gamma", "gamma_sigma", 0.45, 0.002);
    near("black", "black_sigma", 16.0, 0.5);
    near("nonuniformity", "nonuniformity_sigma", 0.02, 0.0005);
    assert!(answer["gain_sigma"].as_f64().unwrap() < 0.005 && answer["left_out"] == 0);
    let document: Value = serde_json::from_str(&std::fs::read_to_string(&measured).unwrap()).unwrap();
    assert_eq!(document, answer["camera"]);
    assert_eq!(document["electrons_per_dn"], 20.0);
    let sentence = output(&calibrate);
    assert!(sentence.contains("gamma 0.4") && sentence.contains("in 6 lights"), "{sentence}");

    render(&truth, &frames, "spot.toml", SPOT, "60", "9");
    let [nees, bias] = honesty(&frames, &["--camera", text(&measured)]);
    assert!((1.2..3.0).contains(&nees) && bias.abs() < 0.5, "{nees} {bias}");
    // Values taken for light are of another spot, and fits do not know it.
    let [nees, bias] = honesty(&frames, &["--camera", noise]);
    assert!(nees > 4.0 || bias.abs() > 5.0, "{nees} {bias}");

    // Saturated light is at least as much as where pixels clip, whatever their gain.
    render(&truth, &path("bright"), "spot.toml", &SPOT.replace("v1=150", "v1=400"), "20", "9");
    let spot = model("spot.toml");
    let fitted =
        output(&["fit", text(&spot), "--frames", text(&path("bright")), "--json", "--camera", text(&measured)]);
    for line in fitted.lines() {
        let estimate: Value = serde_json::from_str(line).unwrap();
        assert!((estimate["parameters"]["v1"].as_f64().unwrap() - 400.0).abs() < 12.0, "{line}");
        assert!(estimate["saturated"].as_f64().unwrap() > 0.1, "{line}");
    }

    // Gains are those of pixels of one size of frames.
    let small = path("small");
    output(&["render", text(&spot), "--out", text(&small), "--size", "64x64"]);
    let (status, message) = failure(&["fit", text(&spot), "--frames", text(&small), "--camera", text(&measured)]);
    assert!(status == 2 && message.contains("96 × 80 px, the frames are 64 × 64 px"), "{message}");
    let (status, message) = failure(&["render", text(&spot), "--out", text(&small), "--camera", text(&measured)]);
    assert!(status == 2 && message.contains("96 × 80 px, the frames are 640 × 480 px"), "{message}");
}

#[test]
fn fields_that_say_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let camera = path("camera.json");
    std::fs::write(&camera, r#"{"electrons_per_dn": 20, "read_noise_e": 15}"#).unwrap();
    for (name, light) in [("a", 20.0), ("b", 40.0), ("c", 80.0), ("d", 260.0)] {
        render(&camera, &path(name), "gaussian.toml", &even(light), "1", "1");
    }
    let flat = |light: &str, name: &str| format!("{light}={}", text(&path(name)));
    let [one, two, four, clipped] = [flat("1", "a"), flat("2", "b"), flat("4", "c"), flat("13", "d")];
    let refused = |flats: &[&str]| {
        let flats: Vec<&str> = flats.iter().flat_map(|flat| ["--flat", *flat]).collect();
        failure(&[&["calibrate", "response"], &flats[..]].concat())
    };
    assert!(refused(&[&one, &two]).1.contains("in 2 light(s)"));
    assert!(refused(&[&one, &two, &four, &clipped]).1.contains("clipped at 255; take less light"));
    let (status, message) = refused(&["bright"]);
    assert!(status == 2 && message.contains("LIGHT=PATH"), "{message}");
}
