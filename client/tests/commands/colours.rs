//! `calibrate colours`, run as a user runs it: from rendered lights to constants that the fit takes.

use std::path::Path;

use serde_json::Value;

use crate::{failure, model, output, text};

const LIGHTS: &str =
    "xr=60,yr=50,xg=180,yg=55,xb=120,yb=130,vr=400,vg=150,vb=110,m_rg=0.25,m_gr=0.2,m_bg=0.15,m_br=0.1";

fn render(out: &Path, set: &str) {
    let raw = model("three-spots-raw.toml");
    let camera = ["--full-well-e", "5000", "--read-noise-e", "15", "--samples", "1"];
    output(&[&["render", text(&raw), "--out", text(out), "--set", set, "--size", "240x180"], &camera[..]].concat());
}

/// Red is clipped in its middle. The printed option goes into the fit as it is, whose brightnesses are then right.
#[test]
fn lights_become_constants_of_the_fit() {
    let folder = tempfile::tempdir().unwrap();
    let (raw, frames, file) =
        (model("three-spots-raw.toml"), folder.path().join("lights"), folder.path().join("colours.json"));
    render(&frames, LIGHTS);
    let arguments =
        ["calibrate", "colours", "--frames", text(&frames), "--model", text(&raw), "--out", text(&file), "--json"];
    let answer: Value = serde_json::from_str(&output(&arguments)).unwrap();
    assert_eq!(answer, serde_json::from_str::<Value>(&std::fs::read_to_string(&file).unwrap()).unwrap());
    let truth = [[1.0, 0.25, 0.03], [0.2, 1.0, 0.12], [0.1, 0.15, 1.0]];
    for (row, column) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        let value = answer["mixing"][row][column].as_f64().unwrap();
        let error = answer["standard_errors"][row][column].as_f64().unwrap();
        assert!((value - truth[row][column]).abs() <= 5.0 * error && error < 0.01, "{row}{column}: {answer}");
    }
    let told = output(&arguments[..6]);
    let (table, option) = told.trim_end().rsplit_once('\n').unwrap();
    assert!(table.starts_with("CHANNEL  LIGHT r"), "{told}");
    let constants = option.strip_prefix("--constant ").unwrap();
    let fitted = output(&["fit", text(&raw), "--frames", text(&frames), "--constant", constants, "--json"]);
    let line: Value = serde_json::from_str(fitted.trim_end()).unwrap();
    assert_eq!(line["state"], "tracking", "{line}");
    for name in ["vr", "vg", "vb", "xr", "yb"] {
        let (value, truth) = (line["parameters"][name].as_f64().unwrap(), line["truth"][name].as_f64().unwrap());
        assert!((value / truth - 1.0).abs() < 0.02, "{name}: {value} for {truth}");
    }
}

#[test]
fn what_is_wrong_is_told_with_the_channel() {
    let folder = tempfile::tempdir().unwrap();
    let (raw, frames) = (model("three-spots-raw.toml"), folder.path().join("lights"));
    render(&frames, &LIGHTS.replace("vg=150", "vg=0.001"));
    let of = |model: &Path| failure(&["calibrate", "colours", "--frames", text(&frames), "--model", text(model)]);
    let (status, message) = of(&raw);
    assert_eq!(status, 1, "{message}");
    assert!(message.contains("no light is brightest in the channel g (1 in r, 1 in b)"), "{message}");
    let (status, message) = of(&model("spot.toml"));
    assert_eq!(status, 2, "{message}");
    assert!(message.contains("has one channel, phi: there is nothing to mix"), "{message}");
    let mixed = model("three-spots.toml");
    let (status, message) = failure(&["render", text(&mixed), "--out", text(&folder.path().join("mixed"))]);
    assert_eq!(status, 3, "{message}");
    assert!(message.contains("`observed` mixes the channels r, g, b"), "{message}");
}
