//! `isophote tune` and `isophote compare`, run as a user runs them. No time is asserted.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::{isophote, lines, model, output, text};

fn shipped(name: &str) -> String {
    text(&model(name)).to_string()
}

fn rendered(folder: &Path, frames: &str, motion: &str) -> PathBuf {
    let out = folder.join("frames");
    let noise = ["--full-well-e", "5000", "--read-noise-e", "15", "--size", "200x150", "--motion", motion];
    let head = ["render", &shipped("spot.toml"), "--out", out.to_str().unwrap(), "--frames", frames];
    output(&[&head[..], &noise[..]].concat());
    out
}

/// A schedule that ends too early cannot win, and the document keeps all but its stages.
#[test]
fn a_bad_schedule_is_replaced_by_one_that_finds_the_answer() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(shipped("spot.toml")).unwrap();
    // One iteration ends nowhere near the answer.
    let bad = text.replace("method     = \"levenberg-marquardt\"", "method     = \"newton\"\niterations = 1");
    let (document, tuned) = (folder.path().join("bad.toml"), folder.path().join("tuned.toml"));
    std::fs::write(&document, &bad).unwrap();
    let frames = rendered(folder.path(), "2", "bx=98+6*t");
    let (document, tuned) = (document.to_str().unwrap(), tuned.to_str().unwrap());
    let arguments = ["tune", document, "--frames", frames.to_str().unwrap(), "--starts", "3", "--json", "--out", tuned];
    let report = &lines(&output(&arguments))[0];
    let schedules = report["schedules"].as_array().unwrap();
    let rate = |name: &str| schedules.iter().find(|row| row["name"] == name).unwrap()["success_rate"].as_f64().unwrap();
    let chosen = report["chosen"].as_str().unwrap();
    let best = schedules.iter().map(|row| row["success_rate"].as_f64().unwrap()).fold(0.0, f64::max);
    assert!(rate("document") < 0.5 && rate("all by levenberg-marquardt") > 0.8, "{report}");
    assert!(chosen != "document" && rate(chosen) >= best - 0.01, "{report}");
    assert!(schedules.iter().all(|row| row["fits"] == 18), "two frames, three distances, three starts");
    assert!(report.get("document").is_none() && report["frames"] == 2);
    let written = std::fs::read_to_string(tuned).unwrap();
    let head = bad.split("[[stages]]").next().unwrap();
    assert!(written.starts_with(head) && written.contains("# isophote tune: "), "{written}");
    output(&["model", "check", tuned]);
    // Table 4.1: light is convex everywhere; centre, shape and light together are not.
    let convexity = report["convexity"].as_array().unwrap();
    let names: Vec<&str> = convexity.iter().map(|row| row["subset"].as_str().unwrap()).collect();
    assert_eq!(names, ["centre", "shape", "illumination", "all"]);
    assert_eq!(convexity[2]["share"], 1.0);
    assert!(convexity[3]["share"].as_f64().unwrap() < 1.0 && convexity[3]["negative_max"].as_u64().unwrap() > 0);
}

#[test]
fn the_same_seed_takes_the_same_steps_and_tables_leave_the_document_alone() {
    let line = shipped("profile-1d.toml");
    let steps = |report: &Value| {
        let rows = report["schedules"].as_array().unwrap();
        rows.iter().map(|row| (row["success_rate"].clone(), row["passes"].clone())).collect::<Vec<_>>()
    };
    let report = |seed: &str| lines(&output(&["tune", &line, "--starts", "2", "--seed", seed, "--json"]))[0].clone();
    let (one, again) = (report("5"), report("5"));
    assert_eq!((steps(&one), &one["convexity"]), (steps(&again), &again["convexity"]));
    assert_ne!(one["convexity"], report("6")["convexity"], "other noise, other starts");
    assert!(one["document"].as_str().unwrap().contains("[[stages]]"));
    let run = isophote(&["tune", &line, "--starts", "1"]);
    let (document, tables) = (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap());
    assert!(document.starts_with("#") && document.contains("name        = \"profile-1d\""), "{document}");
    assert!(tables.contains("SCHEDULE") && tables.contains("EIGENVALUES"), "{tables}");
}

#[test]
fn the_model_that_made_the_frames_is_the_most_right() {
    let folder = tempfile::tempdir().unwrap();
    let frames = rendered(folder.path(), "12", "bx=80+120*t,by=75+30*t");
    let plot = folder.path().join("compare.svg");
    let (spot, gaussian) = (shipped("spot.toml"), shipped("gaussian.toml"));
    let (frames, plot) = (frames.to_str().unwrap(), plot.to_str().unwrap());
    let rows = lines(&output(&["compare", &spot, &gaussian, "--frames", frames, "--json", "--plot", plot]));
    let number = |row: usize, key: &str| rows[row][key].as_f64().unwrap();
    assert!(rows[0]["tracked"] == 12 && rows[0]["failures"] == 0, "{rows:?}");
    // What is no Gaussian need not be taken for one.
    assert!(number(1, "tracked") >= 10.0 && number(1, "tracked") + number(1, "failures") == 12.0, "{rows:?}");
    assert!(number(0, "rmse_px") < 0.1 && number(0, "rmse_px") < number(1, "rmse_px"), "{rows:?}");
    assert!(number(0, "reduced_chi_square") < number(1, "reduced_chi_square"));
    assert!(number(0, "second_difference_px") < 0.3 && number(0, "time_us") <= number(0, "time_us_95"));
    let svg = std::fs::read_to_string(plot).unwrap();
    assert!(svg.matches("<circle").count() == 2 && svg.contains("RMSE") && svg.contains(">gaussian<"));
    // Without a truth no error is made up.
    std::fs::remove_file(Path::new(frames).join("truth.jsonl")).unwrap();
    let row = &lines(&output(&["compare", &spot, "--frames", frames, "--vector-width", "128", "--json"]))[0];
    assert!(row.get("rmse_px").is_none() && row["reduced_chi_square"].is_number(), "{row}");
    assert!(output(&["compare", &spot, "--frames", frames]).lines().nth(1).unwrap().contains("  -  "));
}

#[test]
fn failures_have_their_status() {
    let folder = tempfile::tempdir().unwrap();
    let spots = shipped("three-spots.toml");
    let nowhere = folder.path().join("nowhere");
    let (spot, nowhere) = (shipped("spot.toml"), nowhere.to_str().unwrap());
    let cases: [(&[&str], i32, &str); 6] = [
        (&["tune", &spots], 2, "--frames PATH"),
        (&["tune", &spot, "--starts", "0"], 2, "--starts"),
        (&["tune", &spot, "--frames", nowhere], 1, "no such file"),
        (&["tune", nowhere], 1, "cannot be read"),
        (&["compare", "--frames", nowhere], 2, "MODEL"),
        (&["compare", &spot, "--frames", nowhere], 1, "no such file"),
    ];
    for (arguments, status, word) in cases {
        let run = isophote(arguments);
        let message = String::from_utf8(run.stderr).unwrap();
        assert!(run.status.code() == Some(status) && message.contains(word), "{arguments:?}: {message}");
    }
}
