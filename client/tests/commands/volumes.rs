//! Stacks and series: rendered, fitted from TIFF and from folders of pictures, and what is said where they do not fit.

use std::path::Path;

use isophote_capture::{FrameSource, Recording, encode_png};
use serde_json::Value;

use crate::{failure, model, output, text};

/// The pages of a TIFF as pictures of a folder.
fn pictures(tiff: &Path, folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    let mut pages = Recording::open(tiff).unwrap();
    while let Some(page) = pages.next().unwrap() {
        let (frame, name) = (page.frame, format!("slice{}.png", pages.len()));
        let name = name.replace("slice", &format!("slice{}-", frame.sequence));
        let plane = &frame.planes()[0];
        let png = encode_png(frame.width(), frame.rows(), plane.format, plane.buffer.bytes()).unwrap();
        std::fs::write(folder.join(name), png).unwrap();
    }
}

/// Fits one frame; its parameters and file.
fn fit(model: &Path, frames: &Path, more: &[&str]) -> Value {
    let lines = output(&[&["fit", text(model), "--frames", text(frames), "--json"], more].concat());
    assert_eq!(lines.lines().count(), 1, "{lines}");
    let fit: Value = serde_json::from_str(&lines).unwrap();
    assert_eq!((&fit["state"], &fit["ending"]), (&Value::from("tracking"), &Value::from("small-step")), "{fit}");
    fit
}

fn close(fit: &Value, names: &[(&str, f64)], off: f64) {
    for (name, value) in names {
        let error = fit["parameters"][name].as_f64().unwrap() - value;
        assert!(error.abs() < off, "{name} is {error} off: {fit}");
    }
}

#[test]
fn a_stack_is_one_frame_as_tiff_and_as_a_folder_of_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let (blob, frames) = (model("blob-3d.toml"), folder.path().join("frames"));
    for bits in ["8", "12"] {
        let arguments = ["--size", "40x36x20", "--set", "bx=18.3,by=17.6,bz=9.2,axz=0.001", "--bits", bits];
        output(&[&["render", text(&blob), "--out", text(&frames), "--seed", "3"], &arguments[..]].concat());
        let tiff = frames.join("000000.tiff");
        let pages = folder.path().join(format!("pages{bits}"));
        pictures(&tiff, &pages);
        assert_eq!(std::fs::read_dir(&pages).unwrap().count(), 20);
        let whole = fit(&blob, &frames, &[]);
        assert_eq!((&whole["file"], &whole["truth"]["bz"]), (&Value::from("000000.tiff"), &Value::from(9.2)));
        close(&whole, &[("bx", 18.3), ("by", 17.6), ("bz", 9.2)], 0.01);
        for same in [fit(&blob, &tiff, &[]), fit(&blob, &pages, &[])] {
            assert_eq!(same["parameters"], whole["parameters"]);
            assert_eq!(same["covariance"], whole["covariance"]);
        }
        let part = fit(&blob, &tiff, &["--window", "5,4,2,30,30,16"]);
        close(&part, &[("bx", 18.3), ("by", 17.6), ("bz", 9.2)], 0.01);
        assert!(
            part["pixels"].as_u64().unwrap() < whole["pixels"].as_u64().unwrap() || part["pixels"] == whole["pixels"]
        );
    }
    // Two frames are two files.
    let frames = folder.path().join("two");
    output(&[
        "render",
        text(&blob),
        "--out",
        text(&frames),
        "--size",
        "24x24x12",
        "--frames",
        "2",
        "--motion",
        "bx=11+30*t",
    ]);
    let fits = output(&["fit", text(&blob), "--frames", text(&frames)]);
    assert!(fits.lines().count() == 2 && fits.contains("000001.tiff"), "{fits}");
}

#[test]
fn a_series_is_one_frame_as_folder_of_tiffs_and_of_folders() {
    let folder = tempfile::tempdir().unwrap();
    let (blob, frames) = (model("blob-4d.toml"), folder.path().join("frames"));
    let set = "bx=9.3,by=13.6,bz=5.2,ux=0.7,uy=-0.3,uz=0.2";
    output(&["render", text(&blob), "--out", text(&frames), "--size", "24x24x12x6", "--set", set]);
    let series = frames.join("000000");
    let folders = folder.path().join("folders");
    for volume in 0..6 {
        pictures(&series.join(format!("{volume:06}.tiff")), &folders.join(format!("t{volume}")));
    }
    let whole = fit(&blob, &frames, &[]);
    assert_eq!((&whole["file"], &whole["truth"]["ux"]), (&Value::from("000000"), &Value::from(0.7)));
    close(&whole, &[("bx", 9.3), ("by", 13.6), ("bz", 5.2), ("ux", 0.7), ("uy", -0.3), ("uz", 0.2)], 0.02);
    for same in [fit(&blob, &series, &[]), fit(&blob, &folders, &[])] {
        assert_eq!(same["parameters"], whole["parameters"]);
    }
    let early = fit(&blob, &series, &["--window", "0,0,0,0,24,24,12,3"]);
    close(&early, &[("ux", 0.7), ("uy", -0.3)], 0.05);
}

#[test]
fn pages_are_a_recording_for_two_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    output(&["render", text(&model("blob-3d.toml")), "--out", text(&frames), "--size", "40x36x8", "--set", "azz=1e-4"]);
    let fits = output(&["fit", text(&model("gaussian.toml")), "--frames", text(&frames.join("000000.tiff")), "--json"]);
    let fits: Vec<Value> = fits.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(fits.len(), 8);
    for (page, fit) in fits.iter().enumerate() {
        assert_eq!((&fit["frame"], &fit["file"]), (&Value::from(page), &Value::from(format!("000000.tiff#{page}"))));
        close(fit, &[("bx", 19.5), ("by", 17.5)], 0.01);
    }
}

#[test]
fn unsuitable_volumes_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (blob, series, spot) = (model("blob-3d.toml"), model("blob-4d.toml"), model("spot.toml"));
    let (stack, picture, overlays) = (path("stack"), path("picture"), path("overlays"));
    output(&["render", text(&blob), "--out", text(&stack), "--size", "24x24x12"]);
    output(&["render", text(&spot), "--out", text(&picture), "--size", "64x48"]);
    let (tiff, png) = (stack.join("000000.tiff"), picture.join("000000.png"));
    let out = path("out");
    let render = |model, size| ["render", model, "--out", text(&out), "--size", size];
    let cases: &[(&[&str], i32, &[&str])] = &[
        (
            &["fit", text(&blob), "--frames", text(&png)],
            1,
            &["one picture, but the document has 3 coordinates", "a TIFF of several pages, a folder of pictures"],
        ),
        (&["fit", text(&blob), "--frames", text(&picture)], 1, &["a folder of one picture"]),
        (
            &["fit", text(&series), "--frames", text(&tiff)],
            1,
            &["TIFF of 12 pages", "has 4 coordinates", "a folder of TIFFs"],
        ),
        (
            &["fit", text(&blob), "--frames", text(&tiff), "--overlay", text(&overlays)],
            2,
            &["--overlay", "two coordinates"],
        ),
        (
            &["fit", text(&blob), "--frames", text(&tiff), "--window", "0,0,12,4,4,4"],
            2,
            &["000000.tiff", "outside", "24×24×12"],
        ),
        (
            &["fit", text(&blob), "--frames", text(&tiff), "--window", "0,0,0"],
            2,
            &["four whole numbers", "x,y,z,w,h,d"],
        ),
        (&render(text(&blob), "64x48"), 2, &["--size 64x48 has 2 numbers, the model 3 coordinates: x, y, z"]),
        (&render(text(&spot), "64x48x8"), 2, &["has 3 numbers, the model 2 coordinates"]),
        (&render(text(&blob), "64x48x1"), 2, &["depth is 1", "2 to", "`z`"]),
        (&render(text(&blob), "4096x4096x64"), 2, &["1073741824", "1 to 67108864"]),
    ];
    for (arguments, status, words) in cases {
        let (found, message) = failure(arguments);
        assert_eq!(found, *status, "{arguments:?}: {message}");
        for word in *words {
            assert!(message.contains(word), "{arguments:?}: `{word}` is missing in: {message}");
        }
    }
    assert!(!overlays.exists(), "refused before anything is made");
}
