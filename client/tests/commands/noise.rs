//! `calibrate noise`, run as a user runs it: from frames of a scene that stands still to a camera document that the fit takes.

use std::path::Path;

use serde_json::Value;

use crate::{failure, model, output, text};

fn render(out: &Path, scene: &str, frames: &str, seed: &str) {
    let plane = model("gaussian.toml");
    let common = ["render", text(&plane), "--out", text(out), "--size", "160x120", "--frames", frames, "--set", scene];
    let camera = ["--full-well-e", "5000", "--read-noise-e", "15", "--samples", "2", "--seed", seed];
    output(&[&common[..], &camera[..]].concat());
}

#[test]
fn a_scene_that_stands_still_gives_a_camera_whose_fits_are_honest() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (frames, camera, plane) = (path("frames"), path("camera.json"), model("gaussian.toml"));
    render(&frames, "bx=80,by=60,a1=0.0005,a2=0,a3=0.0005,v0=20,v1=160", "24", "7");
    let calibrate = ["calibrate", "noise", text(&frames), "--out", text(&camera)];
    let answer: Value = serde_json::from_str(&output(&[&calibrate[..], &["--json"]].concat())).unwrap();
    let near = |name: &str, truth: f64| {
        let of = |name: &str| answer[name].as_f64().unwrap();
        let sigma = of(&format!("{name}_sigma"));
        assert!((of(name) - truth).abs() < 4.0 * sigma && sigma < 0.05 * truth, "{answer}");
    };
    near("electrons_per_dn", 5000.0 / 255.0);
    near("read_noise_e", 15.0);
    let document: Value = serde_json::from_str(&std::fs::read_to_string(&camera).unwrap()).unwrap();
    assert_eq!(document, answer["camera"]);
    let printed = output(&calibrate);
    assert!(printed.contains("electrons per DN") && printed.contains("from 24 frames"), "{printed}");

    // A model with noise takes it from there: its fits of other frames explain what they scatter by.
    let (spot, frames) = (model("spot.toml"), path("others"));
    let scene = "bx=80,by=60,a1=0.0025,a2=0,a3=0.004,k1=-0.5,k2=-0.3,v0=20,v1=160";
    let common = ["render", text(&spot), "--out", text(&frames), "--size", "160x120", "--frames", "4", "--set", scene];
    output(
        &[&common[..], &["--full-well-e", "5000", "--read-noise-e", "15", "--samples", "4", "--seed", "8"]].concat(),
    );
    let fits = |more: &[&str]| -> Vec<f64> {
        let printed = output(&[&["fit", text(&spot), "--frames", text(&frames), "--json"], more].concat());
        let chi = |line: &str| serde_json::from_str::<Value>(line).unwrap()["reduced_chi_square"].as_f64().unwrap();
        printed.lines().map(chi).collect()
    };
    for chi in fits(&["--camera", text(&camera)]) {
        assert!((0.85..1.25).contains(&chi), "{chi}");
    }
    std::fs::write(&camera, r#"{"electrons_per_dn": 60, "read_noise_e": 15}"#).unwrap();
    assert!(fits(&["--camera", text(&camera)]).into_iter().all(|chi| chi > 1.5));

    // Rows that are off are measured beside the noise of pixels.
    let (off, known) = (path("off"), path("known.json"));
    let scene = "bx=80,by=60,a1=0.0005,a2=0,a3=0.0005,v0=20,v1=160";
    let common = ["render", text(&plane), "--out", text(&off), "--size", "160x120", "--frames", "24", "--set", scene];
    let camera = ["--full-well-e", "5000", "--read-noise-e", "15", "--row-noise-e", "40", "--samples", "2"];
    output(&[&common[..], &camera[..]].concat());
    let answer: Value =
        serde_json::from_str(&output(&["calibrate", "noise", text(&off), "--json", "--out", text(&known)])).unwrap();
    let rows = answer["camera"]["row_noise_e"].as_f64().unwrap();
    assert!((36.0..44.0).contains(&rows), "{answer}");

    let one = path("one");
    render(&one, "bx=80,by=60,a1=0.0005,a2=0,a3=0.0005,v0=20,v1=160", "1", "9");
    assert!(failure(&["calibrate", "noise", text(&one)]).1.contains("two and more"));
    render(&path("flat"), "bx=80,by=60,a1=0.0005,a2=0,a3=0.0005,v0=20,v1=0", "3", "9");
    let (_, narrow) = failure(&["calibrate", "noise", "--frames", text(&path("flat"))]);
    assert!(narrow.contains("too much alike") && narrow.contains("bright here and dark there"), "{narrow}");
}
