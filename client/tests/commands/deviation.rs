//! `calibrate model`: the deviation of a target from the document's formula, which then counts for its confidence.

use crate::{failure, isophote, lines, model, output, text};

#[test]
fn the_deviation_of_a_target_is_measured_and_raises_its_confidence() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (wavy, stating, own, other) = (path("wavy.toml"), path("stating.toml"), path("own"), path("other"));
    let spot = std::fs::read_to_string(model("spot.toml")).unwrap();
    std::fs::write(&wavy, spot.replace("v0 + v1 * f", "v0 + v1 * f * (1 + 0.25 * sin(9 * s))")).unwrap();
    let set = "a1=0.005,a2=0.001,a3=0.007,k1=-0.5,k2=-0.3,v0=20,v1=150";
    let motion = "bx=60.2+t*17,by=42.6+t*11";
    for (document, out) in [(&model("spot.toml"), &own), (&wavy, &other)] {
        let noise = ["--size", "120x90", "--frames", "6", "--full-well-e", "5000", "--saturation", "255"];
        let render = ["render", text(document), "--out", text(out), "--set", set, "--motion", motion];
        output(&[&render[..], &noise].concat());
    }
    let line = |frames| output(&["calibrate", "model", text(&model("spot.toml")), "--frames", text(frames)]);
    let value = |line: &str| line.split_whitespace().nth(2).unwrap().parse::<f64>().unwrap();
    let [small, large] = [&own, &other].map(|frames| value(&line(frames)));
    assert!(small < 0.01 && (0.03..0.2).contains(&large), "{small} {large}");

    std::fs::write(&stating, spot.replace("[model]\n", &format!("[model]\n{}", line(&other)))).unwrap();
    let confidences = |document| -> Vec<f64> {
        let fitted = output(&["fit", text(document), "--frames", text(&other), "--cold", "--json"]);
        lines(&fitted).iter().map(|estimate| estimate["confidence"].as_f64().unwrap()).collect()
    };
    let (without, with) = (confidences(&model("spot.toml")), confidences(&stating));
    assert!(with.iter().zip(&without).all(|(with, without)| with > without), "{with:?} {without:?}");
}

#[test]
fn pictures_without_the_target_and_deviations_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, file) = (folder.path().join("dark"), folder.path().join("model.toml"));
    let spot = model("spot.toml");
    let set = "bx=30,by=30,a1=0.01,a3=0.01,k1=-0.5,k2=-0.3,v0=20,v1=0";
    let noise = ["--size", "80x60", "--full-well-e", "5000", "--saturation", "255"];
    output(&[&["render", text(&spot), "--out", text(&frames), "--set", set], &noise[..]].concat());
    let (status, error) = failure(&["calibrate", "model", text(&spot), "--frames", text(&frames)]);
    assert!(status == 1 && error.contains("none of the pictures"), "{status} {error}");

    let document = std::fs::read_to_string(&spot).unwrap();
    std::fs::write(&file, document.replace("[model]\n", "[model]\ndeviation = 0.5\n")).unwrap();
    let error = String::from_utf8(isophote(&["model", "check", text(&file)]).stderr).unwrap();
    assert!(error.contains("bad-range") && error.contains("0.001 to 0.2"), "{error}");
}
