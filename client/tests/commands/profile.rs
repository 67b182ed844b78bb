//! `calibrate profile`, run as a user runs it: which pixels it takes for light, and what it says of what it leaves out.

use std::path::Path;

use serde_json::json;

use crate::{isophote, model, output, outputs, text};

fn render(out: &Path, brightness: u32, more: &[&str]) {
    let (spot, set) = (model("spot.toml"), format!("a1=0.01,a3=0.014,k1=-0.5,k2=-0.3,v0=20,v1={brightness}"));
    let motion = "bx=32.2+t*17,by=27.6+t*11";
    let common = ["render", text(&spot), "--out", text(out), "--size", "64x56", "--frames", "8"];
    let light = ["--set", &set, "--motion", motion, "--full-well-e", "5000", "--samples", "4"];
    output(&[&common[..], &light, more].concat());
}

#[test]
fn defects_of_the_camera_are_no_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, dark, light, camera, out) =
        (path("frames"), path("dark"), path("light.json"), path("camera.json"), path("out.toml"));
    let hot = json!({"hot": [{"share": 0.01, "least": 60, "most": 70, "seed": 5}]});
    std::fs::write(&light, hot.to_string()).unwrap();
    render(&frames, 140, &["--light", text(&light)]);
    render(&dark, 0, &["--light", text(&light)]);
    output(&["calibrate", "pixels", "--dark", "--frames", text(&dark), "--out", text(&camera)]);
    let spot = model("spot.toml");
    let calibrate = ["calibrate", "profile", text(&spot), "--frames", text(&frames), "--out", text(&out)];
    let worst = |more: &[&str]| {
        let [printed, error] = outputs(&[&calibrate[..], more].concat());
        assert!(error.is_empty(), "{error}");
        printed.trim_end().rsplit_once(' ').unwrap().1.parse::<f64>().unwrap()
    };
    let (with, without) = (worst(&["--camera", text(&camera)]), worst(&[]));
    assert!(with < 0.5 * without, "{with} {without}");
}

#[test]
fn clipped_pixels_want_the_limit_of_the_camera() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, camera, out) = (path("frames"), path("camera.json"), path("out.toml"));
    render(&frames, 320, &["--saturation", "240"]);
    let spot = model("spot.toml");
    let calibrate = ["calibrate", "profile", text(&spot), "--frames", text(&frames), "--out", text(&out)];
    let refused = isophote(&calibrate);
    let error = String::from_utf8(refused.stderr).unwrap();
    assert!(refused.status.code() == Some(2) && error.contains("--camera with `saturation`"), "{error}");
    assert!(!out.exists());
    std::fs::write(&camera, json!({"saturation": 240}).to_string()).unwrap();
    output(&[&calibrate[..], &["--camera", text(&camera)]].concat());
    assert!(out.exists());
}

#[test]
fn a_noise_that_cannot_be_kept_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, file, out) = (path("frames"), path("model.toml"), path("out.toml"));
    render(&frames, 140, &[]);
    let document = std::fs::read_to_string(model("spot.toml")).unwrap();
    let defined = document
        .replace("[definitions]", "[definitions]\ndark = \"read_noise^2\"")
        .replace("\"read_noise^2 +", "\"dark +");
    for (document, is_kept) in [(document, true), (defined, false)] {
        std::fs::write(&file, document).unwrap();
        let [_, error] =
            outputs(&["calibrate", "profile", text(&file), "--frames", text(&frames), "--out", text(&out)]);
        let written = std::fs::read_to_string(&out).unwrap();
        assert_eq!(written.contains("\nnoise = "), is_kept, "{written}");
        assert_eq!(!written.contains("without its noise"), is_kept, "{written}");
        assert_eq!(!error.contains("has no `noise`"), is_kept, "{error}");
    }
}
