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
    let printed = output(&arguments[..6]);
    let (table, option) = printed.trim_end().rsplit_once('\n').unwrap();
    assert!(table.starts_with("CHANNEL  LIGHT r"), "{printed}");
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
fn errors_name_the_channel() {
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

/// The pose of coloured spots from raw channels in one fit, whatever these are called; the mixing stands in the target's document.
#[test]
fn poses_come_straight_from_raw_colours() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (document, frames, camera, target) =
        (model("three-spots-pose-raw.toml"), path("frames"), path("camera.json"), path("target.json"));
    let lens = r#"{"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}"#;
    std::fs::write(
        &camera,
        format!(r#"{{"saturation": 255, "electrons_per_dn": 19.6, "read_noise_e": 15, "intrinsics": {lens}}}"#),
    )
    .unwrap();
    let spot =
        |name: &str, x: f64, y: f64| format!(r#"{{"name": "{name}", "position_mm": [{x}, {y}, 0], "radius_mm": 30}}"#);
    let spots = [spot("red", 0.0, 80.0), spot("green", -70.0, -40.0), spot("blue", 70.0, -40.0)].join(", ");
    let mixing = "[[1, 0.3, 0.075], [0.25, 1, 0.3], [0.06, 0.21, 1]]";
    std::fs::write(&target, format!(r#"{{"name": "lamps", "spots": [{spots}], "mixing": {mixing}}}"#)).unwrap();
    let truth =
        [("tx", 60.0), ("ty", -30.0), ("tz", 1500.0), ("vr", 150.0), ("vg", 120.0), ("vb", 90.0), ("v0b", 12.0)];
    let set: Vec<String> = truth.iter().map(|(name, value)| format!("{name}={value}")).collect();
    let mixed = "m1=0.1,m2=-0.12,m3=0.3,blur=0.101,v0r=20,v0g=16,\
                 m_rg=0.3,m_rb=0.075,m_gr=0.25,m_gb=0.3,m_br=0.06,m_bg=0.21";
    let set = format!("{},{mixed}", set.join(","));
    let seen = ["--frames", "6", "--full-well-e", "5000", "--read-noise-e", "15"];
    output(&[&["render", text(&document), "--set", &set, "--out", text(&frames)], &seen[..]].concat());
    let fitted = |document: &Path| -> Vec<Value> {
        let seen = ["--camera", text(&camera), "--target", text(&target), "--json"];
        let printed = output(&[&["fit", text(document), "--frames", text(&frames)], &seen[..]].concat());
        printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let estimates = fitted(&document);
    for estimate in &estimates {
        assert_eq!((&estimate["state"], &estimate["pose"]["degrees_of_freedom"]), (&"tracking".into(), &6.into()));
        let order: Vec<&str> =
            estimate["order"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        for (name, truth) in truth {
            let at = order.iter().position(|other| *other == name).unwrap();
            let sigma = estimate["covariance"][at][at].as_f64().unwrap().sqrt();
            let off = estimate["parameters"][name].as_f64().unwrap() - truth;
            assert!(off.abs() < 5.0 * sigma && sigma < 0.01 * truth.abs().max(20.0), "{name}: {off} ± {sigma}");
        }
    }
    let renamed = path("renamed.toml");
    let old = std::fs::read_to_string(&document).unwrap();
    let names = |channels: &str| old.replace(r#"["r", "g", "b"]"#, channels).replace("[r, g, b]", "[one, two, three]");
    std::fs::write(&renamed, names(r#"["one", "two", "three"]"#)).unwrap();
    let again = fitted(&renamed);
    assert_eq!(estimates.len(), again.len());
    assert!(estimates.iter().zip(&again).all(|(one, other)| one["parameters"] == other["parameters"]));
}
