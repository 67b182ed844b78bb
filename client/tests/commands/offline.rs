//! The commands that need no service, run as a user runs them: render, fit, model check, model explain.

use std::path::Path;

use isophote_jit::{Processor, VectorWidth};
use serde_json::Value;

use crate::{failure, lines, model, output, outputs, text};

#[test]
fn rendered_frames_are_fitted_back_to_their_truth() {
    let folder = tempfile::tempdir().unwrap();
    let spot = model("spot.toml");
    let (frames, overlays) = (folder.path().join("frames"), folder.path().join("overlays"));
    output(&[
        "render",
        text(&spot),
        "--out",
        text(&frames),
        "--frames",
        "4",
        "--set",
        "by=231.4,v1=180,k1=-0.5",
        "--motion",
        "bx=340 + max(0, 30*sin(2*pi*5*t))",
    ]);
    let truth = lines(&std::fs::read_to_string(frames.join("truth.jsonl")).unwrap());
    assert_eq!(truth.len(), 4);
    assert_eq!((&truth[3]["frame"], &truth[3]["file"]), (&Value::from(3), &Value::from("000003.png")));
    assert_eq!(truth[0]["parameters"]["by"], 231.4);

    let fit = ["fit", text(&spot), "--frames", text(&frames), "--json"];
    // Two runs with the vectors that are fastest might not have the same.
    let narrow = [&fit[..], &["--vector-width", "128"]].concat();
    let fits = output(&[&narrow[..], &["--overlay", text(&overlays)]].concat());
    for (truth, fit) in truth.iter().zip(lines(&fits)) {
        assert_eq!((&fit["state"], &fit["ending"]), (&Value::from("tracking"), &Value::from("small-step")));
        assert_eq!((&fit["frame"], &fit["file"]), (&truth["frame"], &truth["file"]));
        assert_eq!((&fit["truth"], &fit["vector_width"]), (&truth["parameters"], &Value::from(128)));
        assert_eq!(
            (fit["time_s"].as_f64(), &fit["time_s"]),
            (Some(fit["frame"].as_f64().unwrap() / 60.0), &truth["t"])
        );
        for name in ["bx", "by"] {
            let error = fit["parameters"][name].as_f64().unwrap() - truth["parameters"][name].as_f64().unwrap();
            assert!(error.abs() < 0.01, "{name} is {error} px off");
        }
        assert_eq!(fit["order"].as_array().unwrap().len(), fit["covariance"].as_array().unwrap().len());
        assert!(fit.get("capture_ns").is_none() && fit.get("session").is_none());
        assert!(fit["timing_us"]["fit"].is_u64());
    }
    assert_eq!(std::fs::read_dir(&overlays).unwrap().count(), 4);
    if Processor::Host.has(VectorWidth::Bits256) {
        let wide = output(&[&fit[..], &["--vector-width", "256"]].concat());
        assert!(lines(&wide).iter().all(|fit| fit["vector_width"] == 256), "{wide}");
    }
    let fastest = lines(&output(&fit))[0]["vector_width"].as_u64().unwrap();
    let mut widths = VectorWidth::ALL.into_iter().filter(|width| Processor::Host.has(*width));
    assert!(widths.any(|width| 8 * width.bytes() as u64 == fastest), "{fastest}");
    let traced = lines(&output(&[&narrow[..], &["--trace"]].concat()));
    for (fit, plain) in traced.iter().zip(lines(&fits)) {
        assert_eq!((&fit["parameters"], plain.get("trace")), (&plain["parameters"], None), "a trace changes nothing");
        let trace = fit["trace"].as_array().unwrap();
        assert!(trace[0]["pass"] == 0 && trace[0].get("ratio").is_none() && trace.len() <= 256, "{trace:?}");
        let (first, last) =
            (trace[0]["objective"].as_f64().unwrap(), trace[trace.len() - 1]["objective"].as_f64().unwrap());
        assert!(trace.len() > 1 && last <= 1.001 * first, "F falls: {trace:?}");
    }
    let plain = output(&["fit", text(&spot), "--frames", text(&frames)]);
    assert_eq!(plain.lines().count(), 4);
    let first = plain.lines().next().unwrap();
    assert!(first.contains("000000.png") && first.contains("tracking") && first.contains("bx 340.0"), "{first}");
}

/// exp and cosh are infinite in f32 from 88 widths on, where a logistic edge and a sech² line are flat.
#[test]
fn edges_and_lines_are_fitted_far_beyond_the_range_of_their_exponentials() {
    let folder = tempfile::tempdir().unwrap();
    let (document, frames) = (folder.path().join("edge.toml"), folder.path().join("frames"));
    for (sign, profile) in [("", "1 / (1 + exp(u))"), ("-", "exp(u) / (exp(u) + 1)"), ("", "1 / cosh(u)^2")] {
        let written = format!(
            "name = \"edge\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n\
             b = {{ start = 159.0 }}\nw = {{ start = 1.5, min = 0.0 }}\nv0 = {{ start = 20.0 }}\nv1 = {{ start = 100.0 }}\n\
             [definitions]\nu = \"{sign}(x - b) / w\"\n[model]\nintensity = \"v0 + v1 * {profile}\"\n"
        );
        std::fs::write(&document, written).unwrap();
        let set = "b=160.4,w=1.2,v0=30,v1=120";
        output(&[
            "render",
            text(&document),
            "--out",
            text(&frames),
            "--set",
            set,
            "--size",
            "600x20",
            "--full-well-e",
            "20000",
        ]);
        for precision in ["f32", "f64"] {
            let fits = output(&["fit", text(&document), "--frames", text(&frames), "--precision", precision, "--json"]);
            let fit = &lines(&fits)[0];
            assert_eq!(
                (&fit["state"], &fit["ending"]),
                (&Value::from("tracking"), &Value::from("small-step")),
                "{fit}"
            );
            let error = fit["parameters"]["b"].as_f64().unwrap() - 160.4;
            assert!(error.abs() < 0.03, "{precision}, {profile}: {error} px off");
        }
    }
}

/// A lamp that goes out and a camera that is blind in a corner, at 12 bits and a gain of 2: as asked for, and the truth told.
#[test]
fn bad_light_is_rendered_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let (spot, out, light) = (model("spot.toml"), folder.path().join("out"), folder.path().join("light.json"));
    let document = r#"{"occluders": [{"value": "30 + 5*t", "from_s": 1}], "blind": [{"width": 3, "height": 2}]}"#;
    std::fs::write(&light, document).unwrap();
    let common = ["render", text(&spot), "--out", text(&out), "--light", text(&light), "--size", "64x48"];
    output(&[&common[..], &["--frames", "3", "--rate-hz", "1", "--bits", "12", "--gain", "1 + 1"]].concat());
    let pixels = |frame: u64| {
        let bytes = std::fs::read(out.join(format!("{frame:06}.png"))).unwrap();
        let frame = isophote_capture::decode(&bytes).unwrap();
        let plane = frame.plane_view(0);
        [plane.pixel(0, 0), plane.pixel(2, 1), plane.pixel(3, 1), plane.pixel(32, 24)]
    };
    assert_eq!([pixels(1), pixels(2)], [[4095.0, 4095.0, 70.0, 70.0], [4095.0, 4095.0, 80.0, 80.0]]);
    let background = (20.0 * 4095.0 / 255.0 * 2.0f64).round();
    assert_eq!(pixels(0), [4095.0, 4095.0, background, 4095.0]);
    let truth = lines(&std::fs::read_to_string(out.join("truth.jsonl")).unwrap());
    let truth_values = truth.iter().map(|line| line["parameters"]["v0"].as_f64().unwrap());
    assert!(truth_values.into_iter().all(|v0| (v0 - 20.0 * 4095.0 / 255.0 * 2.0).abs() < 1e-9));

    std::fs::write(&light, r#"{"blind": [{"width": -3}]}"#).unwrap();
    let (status, message) = failure(&common);
    assert!(status == 2 && message.contains("`light.blind[0].width` is -3; it must be 0 or positive"), "{message}");
    std::fs::write(&light, r#"{"blindness": []}"#).unwrap();
    let (status, message) = failure(&common);
    assert!(status == 2 && message.contains("light.json: unknown field `blindness`"), "{message}");
    let (status, message) = failure(&["render", text(&spot), "--out", text(&out), "--gain", "2*u"]);
    assert!(status == 2 && message.contains("`gain` is no formula of t"), "{message}");
    assert!(message.contains("only t is known"), "{message}");
    let (status, message) = failure(&["render", text(&spot), "--out", text(&out), "--exposure", "0"]);
    assert!(status == 2 && message.contains("`exposure` is 0; it must be positive"), "{message}");
    output(&["render", text(&spot), "--out", text(&out), "--size", "64x48", "--set", "v0=20", "--exposure", "1.5 + t"]);
    let truth = lines(&std::fs::read_to_string(out.join("truth.jsonl")).unwrap());
    assert_eq!(truth[0]["parameters"]["v0"], 30.0);
}

#[test]
fn the_same_seed_renders_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    let spot = model("spot.toml");
    let render = |name: &str, seed: &str| {
        let out = folder.path().join(name);
        let noise = ["--full-well-e", "5000", "--read-noise-e", "15", "--size", "160x120", "--bits", "12"];
        output(&[&["render", text(&spot), "--out", text(&out), "--seed", seed], &noise[..]].concat());
        std::fs::read(out.join("000000.png")).unwrap()
    };
    assert_eq!(render("a", "1"), render("b", "1"));
    assert_ne!(render("c", "1"), render("d", "2"));
    assert_eq!(render("e", "1")[24], 16, "12 bits are written as 16-bit PNG");
}

/// A lost frame is a line with its state, and the run goes on and succeeds.
#[test]
fn a_lost_target_is_a_line_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let spot = model("spot.toml");
    let render = |out: &Path, set: &str| {
        let noise = ["--full-well-e", "5000", "--read-noise-e", "15"];
        output(&[&["render", text(&spot), "--out", text(out), "--set", set, "--size", "320x240"], &noise[..]].concat());
    };
    let frames = folder.path().join("frames");
    render(&frames, "v1=150");
    render(&folder.path().join("dark"), "v1=0.001");
    std::fs::copy(folder.path().join("dark/000000.png"), frames.join("000001.png")).unwrap();
    std::fs::copy(frames.join("000000.png"), frames.join("000002.png")).unwrap();
    let fits = lines(&output(&["fit", text(&spot), "--frames", text(&frames), "--json"]));
    let states: Vec<&str> = fits.iter().map(|fit| fit["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["tracking", "lost", "tracking"]);
}

/// In a sequence another thing is not the target; pictures that are none are searched each anew.
#[test]
fn cold_fits_do_not_know_the_frame_before() {
    let folder = tempfile::tempdir().unwrap();
    let spot = model("spot.toml");
    let render = |out: &Path, count: &str, set: &str| {
        let noise = ["--full-well-e", "5000", "--read-noise-e", "15", "--size", "320x240", "--frames", count];
        output(&[&["render", text(&spot), "--out", text(out), "--set", set], &noise[..]].concat());
    };
    let (frames, other) = (folder.path().join("frames"), folder.path().join("other"));
    render(&frames, "4", "bx=100,by=120,a1=0.01,a3=0.01,v1=120");
    render(&other, "1", "bx=230,by=90,a1=0.0006,a3=0.0006,v1=100");
    std::fs::copy(other.join("000000.png"), frames.join("000004.png")).unwrap();
    let fit = ["fit", text(&spot), "--frames", text(&frames)];
    let last = |more: &[&str]| lines(&output(&[&fit[..], more].concat())).pop().unwrap();
    let followed = last(&["--json"]);
    assert_eq!((&followed["state"], &followed["candidate"]["rejection"]), (&"coasting".into(), &"unlike".into()));
    assert!((followed["candidate"]["parameters"]["bx"].as_f64().unwrap() - 230.0).abs() < 0.1, "{followed}");
    let line = output(&fit);
    assert!(line.contains("not taken at 230.0, 90.0: unlike the target that was followed, confidence 0.9"), "{line}");
    let cold = last(&["--json", "--cold"]);
    assert_eq!((&cold["state"], &cold["candidate"]), (&"tracking".into(), &Value::Null));
    assert_eq!(
        cold["parameters"],
        lines(&output(&["fit", text(&spot), "--frames", text(&other), "--json"]))[0]["parameters"]
    );
}

/// The formula of `gaussian.toml` at several places of one picture.
#[test]
fn all_targets_of_a_picture_are_fitted() {
    let folder = tempfile::tempdir().unwrap();
    let gaussian = std::fs::read_to_string(model("gaussian.toml")).unwrap();
    let second = "v1 * exp(-2 * s) + 90 * exp(-((x - 200.5)^2 + (y - 60)^2) / 18)";
    let both = folder.path().join("both.toml");
    let text_of_both = gaussian.replace("v1 * exp(-2 * s)", second).replace("domain     = \"s <= 4\"\n", "");
    std::fs::write(&both, text_of_both).unwrap();
    let frames = folder.path().join("frames");
    let set = "bx=90,by=120,a1=0.02,a2=0,a3=0.03,v0=20,v1=120";
    let noise = ["--full-well-e", "5000", "--read-noise-e", "15", "--size", "320x240", "--frames", "2"];
    output(&[&["render", text(&both), "--out", text(&frames), "--set", set], &noise[..]].concat());
    let (gaussian, csv) = (model("gaussian.toml"), folder.path().join("targets.csv"));
    let fit = ["fit", text(&gaussian), "--frames", text(&frames), "--targets"];
    let all = lines(&output(&[&fit[..], &["all", "--json", "--csv", text(&csv)]].concat()));
    let seen: Vec<[u64; 2]> = all
        .iter()
        .map(|one| [one["frame"].as_u64().unwrap(), one["target"].as_str().unwrap().parse().unwrap()])
        .collect();
    assert_eq!(seen, [[0, 0], [0, 1], [1, 0], [1, 1]]);
    // π/2 · height · semi-axes, and 2π · height · variance.
    let fluxes = [60.0 * std::f64::consts::PI / (0.02_f64 * 0.03).sqrt(), 180.0 * std::f64::consts::PI * 9.0];
    let table = std::fs::read_to_string(&csv).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    let column = |name: &str| rows[0].iter().position(|head| *head == name).unwrap();
    assert_eq!(rows.len(), 5);
    for (row, one) in rows[1..].iter().zip(&all) {
        let number = |name: &str| row[column(name)].parse::<f64>().unwrap();
        let expected = if number("x") < 150.0 { fluxes[0] } else { fluxes[1] };
        let off = (number("flux") - expected) / number("flux_err");
        assert!(off.abs() < 5.0 && (number("flux") / expected - 1.0).abs() < 0.03, "{row:?}: {expected}");
        assert_eq!(number("flux"), one["photometry"]["flux"].as_f64().unwrap());
        assert_eq!(number("bx"), one["parameters"]["bx"].as_f64().unwrap());
        assert!((number("snr") - number("flux") / number("flux_err")).abs() < 1e-9, "{row:?}");
    }
    let text = output(&[&fit[..], &["3", "--table"]].concat());
    let heads = text.lines().filter(|line| line.starts_with("TRACK")).count();
    assert!(text.contains("2 tracking, 1 searching") && heads == 2, "{text}");
}

#[test]
fn a_csv_file_is_a_curve_fit() {
    let folder = tempfile::tempdir().unwrap();
    let (document, data) = (folder.path().join("decay.toml"), folder.path().join("decay.csv"));
    let toml = "name = \"decay\"\ncoordinates = [\"i\"]\nchannels = [\"t\", \"y\"]\n[parameters]\na = { start = 1.0 }\nb = { start = 1.0 }\n\
                [model]\nobserved = \"y\"\nintensity = \"a*exp(-b*t)\"\n";
    std::fs::write(&document, toml).unwrap();
    let rows: String =
        (0..20).map(|i| f64::from(i) * 0.25).map(|t| format!("{t},{}\n", 3.0 * (-0.7 * t).exp())).collect();
    std::fs::write(&data, format!("t,y\n{rows}")).unwrap();
    let fit = &lines(&output(&["fit", text(&document), "--frames", text(&data), "--json"]))[0];
    assert!((fit["parameters"]["a"].as_f64().unwrap() - 3.0).abs() < 1e-9, "{fit}");
    assert!((fit["parameters"]["b"].as_f64().unwrap() - 0.7).abs() < 1e-9, "{fit}");
    let started = lines(&output(&["fit", text(&document), "--frames", text(&data), "--start", "a=2,b=0.5", "--json"]));
    assert_eq!(started[0]["converged"], true);
}

#[test]
fn a_row_whose_error_makes_no_weight_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (document, data) = (folder.path().join("line.toml"), folder.path().join("line.csv"));
    let toml = "name = \"line\"\ncoordinates = [\"i\"]\nchannels = [\"x\", \"y\", \"s\"]\n[parameters]\na = { start = 1.0 }\n\
                b = { start = 1.0 }\n[model]\nobserved = \"y\"\nintensity = \"a + b*x\"\nnoise = \"NOISE\"\n";
    let write = |noise: &str, third: &str| {
        std::fs::write(&document, toml.replace("NOISE", noise)).unwrap();
        std::fs::write(&data, format!("x,y,s\n# measured\n0,1,0.1\n1,3.1,0.1\n{third}\n3,6.9,0.1\n4,9,0.1\n")).unwrap();
    };
    let arguments = ["fit", text(&document), "--frames", text(&data), "--json"];
    for (noise, third) in
        [("s^2", "2,5,0"), ("s^2", "2,5,nan"), ("s", "2,5,-0.1"), ("1/s", "2,5,0"), ("s^2 - 0.005", "2,5,0.05")]
    {
        write(noise, third);
        let (_, error) = failure(&arguments);
        assert!(error.contains("line.csv: row 3 below the header: `noise` is "), "{noise}, {third}: {error}");
    }
    // Errors that leave a variance are taken, and so is a row without a value.
    for (noise, third) in [("s^2", "2,5,0.1"), ("0.01 + s^2", "2,5,0"), ("s^2", "2,nan,0")] {
        write(noise, third);
        let fits = lines(&output(&arguments));
        assert!((fits[0]["parameters"]["b"].as_f64().unwrap() - 2.0).abs() < 0.1, "{noise}, {third}: {}", fits[0]);
    }
}

#[test]
fn a_frame_of_another_size_than_the_one_before_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, other) = (folder.path().join("frames"), folder.path().join("other"));
    for (out, size, count) in [(&frames, "96x64", "2"), (&other, "80x64", "1")] {
        output(&["render", text(&model("gaussian.toml")), "--out", text(out), "--size", size, "--frames", count]);
    }
    std::fs::copy(other.join("000000.png"), frames.join("000002.png")).unwrap();
    let fit = |path: &Path| outputs(&["fit", text(&model("gaussian.toml")), "--frames", text(path), "--json"]);
    let [out, errors] = fit(&frames);
    assert_eq!((lines(&out).len(), errors.as_str()), (3, "000002.png has 80×64 px, the frame before it 96×64 px\n"));
    std::fs::remove_file(frames.join("000002.png")).unwrap();
    assert_eq!(fit(&frames)[1], "");
}

#[test]
fn failures_have_their_status_and_name_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let (spot, frames, wrong) = (model("spot.toml"), folder.path().join("frames"), folder.path().join("wrong.toml"));
    output(&["render", text(&spot), "--out", text(&frames), "--size", "64x48"]);
    std::fs::write(&wrong, std::fs::read_to_string(&spot).unwrap().replace("v0 + v1 * f", "v0 + v2 * f")).unwrap();
    let (spot, frames, wrong) = (text(&spot), text(&frames), text(&wrong));
    let camera = folder.path().join("camera.json");
    std::fs::write(&camera, "{\"saturatoin\": 253}").unwrap();
    let nowhere = folder.path().join("nowhere");
    let cases: &[(&[&str], i32, &[&str])] = &[
        (&["fit", wrong, "--frames", frames], 3, &["wrong.toml:", "model.intensity", "v2", "^"]),
        (&["model", "check", wrong], 3, &["wrong.toml:", "v2"]),
        (&["render", wrong, "--out", frames], 3, &["v2"]),
        (&["model", "check", text(&nowhere)], 1, &["nowhere", "cannot be read"]),
        (&["fit", spot, "--frames", text(&nowhere)], 1, &["nowhere", "no such file"]),
        (&["fit", spot], 2, &["--frames"]),
        (&["fit", spot, "--frames", frames, "--start", "bx"], 2, &["`bx` is not name=value"]),
        (&["fit", spot, "--frames", frames, "--start", "bxx=1"], 2, &["bxx", "`bx`"]),
        (&["fit", spot, "--frames", frames, "--constant", "gian=1"], 2, &["gian"]),
        (&["fit", spot, "--frames", frames, "--window", "100,0,5,5"], 2, &["outside", "64×48"]),
        (&["fit", spot, "--frames", frames, "--camera", text(&camera)], 2, &["camera.json", "saturatoin"]),
        (&["fit", spot, "--frames", frames, "--overlay", frames], 2, &["--overlay"]),
        (&["render", spot, "--out", frames, "--set", "b=1"], 2, &["`b`"]),
        (&["render", spot, "--out", frames, "--motion", "bx=3 + "], 2, &["--motion bx"]),
        (&["render", spot, "--out", frames, "--saturation", "256"], 2, &["at most 255"]),
        (&["model", "explain", spot, "--parameters", "bx,zz"], 2, &["zz"]),
    ];
    for (arguments, status, words) in cases {
        let (found, message) = failure(arguments);
        assert_eq!(found, *status, "{arguments:?}: {message}");
        for word in *words {
            assert!(message.contains(word), "{arguments:?}: `{word}` is missing in: {message}");
        }
    }
    std::fs::write(Path::new(frames).join("000000.png"), b"\x89PNG\r\n\x1a\nbroken").unwrap();
    let (status, message) = failure(&["fit", spot, "--frames", frames]);
    assert!(status == 1 && message.contains("000000.png: damaged"), "{message}");
}

#[test]
fn check_and_explain_give_the_same_figures() {
    let thesis = model("thesis-spot.toml");
    let report = &lines(&output(&["model", "check", text(&thesis), "--json"]))[0];
    assert_eq!(report["model"], "thesis-spot");
    assert!(report["digest"].as_str().unwrap().starts_with("sha256:"));
    let stage = &report["stages"][0];
    let explained =
        output(&["model", "explain", text(&thesis), "--parameters", "bx,by", "--show", "program", "--json"]);
    let explained = &lines(&explained)[0];
    for key in ["parameters", "method", "flops_per_pixel", "accumulators", "flops_per_row", "flops_per_pass"] {
        assert_eq!(explained[key], stage[key], "{key}");
    }
    for show in ["derivative", "sums", "program", "clif", "asm"] {
        let shown = output(&["model", "explain", text(&thesis), "--parameters", "bx,by", "--show", show]);
        assert!(shown.len() > 100, "{show}: {shown}");
    }
    assert!(output(&["model", "check", text(&thesis)]).contains("bx, by"));
}
