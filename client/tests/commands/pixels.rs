//! `calibrate pixels`, run as a user runs it: from frames with hot pixels to a camera document that the fit takes.

use std::path::Path;

use serde_json::{Value, json};

use crate::{failure, model, output, text};

/// 0.5 % of the pixels read 40 to 200 DN too much.
fn render(out: &Path, light: &Path, seed: &str, more: &[&str]) {
    std::fs::write(light, json!({"hot": [{"share": 0.005, "least": 40, "most": 200, "seed": 5}]}).to_string()).unwrap();
    let spot = model("spot.toml");
    let common = ["render", text(&spot), "--out", text(out), "--size", "160x120", "--light", text(light)];
    let camera = ["--full-well-e", "5000", "--read-noise-e", "15", "--samples", "4", "--seed", seed];
    output(&[&common[..], &camera[..], more].concat());
}

const MOVING: [&str; 6] = [
    "--frames",
    "40",
    "--set",
    "a1=0.0025,a3=0.004,k1=-0.5,k2=-0.3,v0=20,v1=160",
    "--motion",
    "bx=80+35*sin(2*pi*t/0.66),by=60+25*cos(2*pi*t/0.4)",
];

#[test]
fn a_running_scene_gives_a_camera_whose_fits_leave_hot_pixels_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, light, camera, known) = (path("frames"), path("light.json"), path("camera.json"), path("known.json"));
    render(&frames, &light, "1", &MOVING);
    std::fs::write(&known, json!({"saturation": 255, "electrons_per_dn": 19.608, "read_noise_e": 15}).to_string())
        .unwrap();
    let calibrate = ["calibrate", "pixels", text(&frames), "--camera", text(&known), "--out", text(&camera)];
    let printed = output(&calibrate);
    assert!(printed.starts_with("160 × 120 px, 40 frames: "), "{printed}");
    let answer: Value = serde_json::from_str(&output(&[&calibrate[..], &["--json"]].concat())).unwrap();
    let document: Value = serde_json::from_str(&std::fs::read_to_string(&camera).unwrap()).unwrap();
    assert_eq!((&answer["camera"], &document["saturation"]), (&document, &json!(255.0)));
    // Dark frames of the same camera show the same pixels: 96 ± 10.
    let (dark, of_dark) = (path("dark"), path("dark.json"));
    render(&dark, &light, "2", &["--frames", "12", "--set", "v0=5,v1=0"]);
    output(&["calibrate", "pixels", "--dark", "--frames", text(&dark), "--out", text(&of_dark)]);
    let dark: Value = serde_json::from_str(&std::fs::read_to_string(&of_dark).unwrap()).unwrap();
    let pixels = |document: &Value| document["defect_map"]["pixels"].as_array().unwrap().clone();
    let (running, dark) = (pixels(&document), pixels(&dark));
    assert!((60..135).contains(&dark.len()), "{}", dark.len());
    assert!(running.iter().all(|pixel| dark.contains(pixel)), "{running:?} of {dark:?}");
    assert!(running.len() as f64 >= 0.9 * dark.len() as f64, "{} of {}", running.len(), dark.len());

    // Other frames of the same camera.
    render(&frames, &light, "3", &MOVING);
    let spot = model("spot.toml");
    let fits = |camera: &Path| -> Vec<Value> {
        let printed = output(&["fit", text(&spot), "--frames", text(&frames), "--camera", text(camera), "--json"]);
        printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let off = |fit: &Value| {
        ["bx", "by"].map(|name| fit["parameters"][name].as_f64().unwrap() - fit["truth"][name].as_f64().unwrap())
    };
    let square = |fit: &Value| off(fit).iter().map(|off| off * off).sum::<f64>();
    let nees = |fit: &Value| {
        let [x, y] = off(fit);
        let c = |i: usize, j: usize| fit["covariance"][i][j].as_f64().unwrap();
        (c(1, 1) * x * x - 2.0 * c(0, 1) * x * y + c(0, 0) * y * y) / (c(0, 0) * c(1, 1) - c(0, 1) * c(0, 1))
    };
    let with = fits(&camera);
    assert!(with.iter().all(|fit| fit["state"] == "tracking"), "{with:?}");
    assert!(with.iter().any(|fit| fit["left_out"].as_u64().unwrap() > 2));
    let mean = with.iter().map(nees).sum::<f64>() / with.len() as f64;
    assert!((1.0..3.2).contains(&mean), "{mean}"); // 2 ± 4 · 2/√40
    let without = fits(&known);
    assert!(without.iter().all(|fit| fit.get("left_out").is_none()));
    // Without the map a robust fit leaves them out, and covariances are honest.
    let found: Vec<&Value> = without.iter().filter(|fit| fit["state"] == "tracking").collect();
    let mean_of = |of: &dyn Fn(&Value) -> f64| found.iter().map(|fit| of(fit)).sum::<f64>() / found.len() as f64;
    let square_with = with.iter().map(square).sum::<f64>() / with.len() as f64;
    let (square, nees) = (mean_of(&square), mean_of(&nees));
    assert!(found.len() > without.len() / 2, "{} of {}", found.len(), without.len());
    assert!(square < 2.0 * square_with && nees < 5.0, "{square} beside {square_with}, {nees}");
    let line = output(&["fit", text(&spot), "--frames", text(&frames), "--camera", text(&camera)]);
    assert!(line.contains(" defects left out"), "{line}");
}

#[test]
fn what_cannot_be_a_map_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, light, camera) = (path("frames"), path("light.json"), path("camera.json"));
    render(&frames, &light, "1", &["--frames", "2"]);
    assert!(failure(&["calibrate", "pixels"]).1.contains("FRAMES"));
    let (_, none) = failure(&["calibrate", "pixels", text(&frames), "--false-alarms", "0"]);
    assert!(none.contains("--false-alarms"), "{none}");
    let spot = model("spot.toml");
    let fit = ["fit", text(&spot), "--frames", text(&frames), "--camera", text(&camera)];
    for (map, printed) in [
        (json!({"width": 160, "height": 120, "pixels": [[160, 3]]}), "a pixel at [160, 3]"),
        (json!({"width": 120, "height": 160}), "120 × 160 px"),
        (json!({"width": 160, "height": 120, "colums": [3]}), "colums"),
    ] {
        std::fs::write(&camera, json!({ "defect_map": map }).to_string()).unwrap();
        let (_, error) = failure(&fit);
        assert!(error.contains(printed), "{error}");
    }
    // A map of other frames is told in the same words by all who read frames; rendered ones have no defects.
    std::fs::write(&camera, json!({"defect_map": {"width": 120, "height": 160, "rows": [3]}}).to_string()).unwrap();
    let (_, printed) = failure(&fit);
    for command in ["compare", "tune"] {
        let (_, error) = failure(&[&[command], &fit[1..]].concat());
        assert!(error.ends_with(&printed) && printed.contains("120 × 160 px"), "{command}: {error}, not {printed}");
    }
    output(&["tune", text(&spot), "--camera", text(&camera), "--starts", "1"]);
}
