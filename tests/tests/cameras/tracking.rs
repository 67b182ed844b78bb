//! Frames of cameras are tracked as accurately as the same pictures from files.

use std::path::Path;

use isophote_capture::encode_png;
use isophote_jit::PixelFormat;
use isophote_tests::loopback::Film;
use isophote_tests::program;
use isophote_tests::rig::{LOOPBACK, Rig, WEBCAM, in_rig};
use serde_json::{Value, json};

use crate::faults::{loop_back, stop};
use crate::{LARGE, PICTURES, SMALL, TestSystem, circling, nearest, rms, session};

/// Errors of the centre by picture, px, and the ages of the frames at the start of their fits, µs.
fn follow(system: &TestSystem, name: &str, truths: &[[f64; 2]], estimates: usize) -> (Vec<(usize, f64)>, Vec<i64>) {
    let mut socket = system.client.socket(name, "mode=all");
    let (mut errors, mut ages, mut last) = (Vec::new(), Vec::new(), None);
    while errors.len() < estimates {
        let estimate = socket.next().unwrap();
        let frame = estimate["frame"].as_u64().unwrap();
        if let Some(last) = last {
            assert_eq!(frame - last, 1 + estimate["dropped"].as_u64().unwrap(), "what is missing is told");
        }
        last = Some(frame);
        // A busy machine may cut a fit short, which its ending reports.
        if estimate["state"] == "tracking" && estimate["ending"] != "budget" {
            let (picture, error) = nearest(truths, &estimate);
            errors.push((picture, error));
            ages.push(estimate["timing_us"]["wait"].as_i64().unwrap());
        }
    }
    (errors, ages)
}

fn truths(film: &Film) -> Vec<[f64; 2]> {
    film.truths.iter().map(|truth| [truth["bx"], truth["by"]]).collect()
}

/// Fits the film from PNG files.
fn from_files(system: &TestSystem, film: &Film, truths: &[[f64; 2]]) -> Vec<(usize, f64)> {
    let folder = std::env::temp_dir().join("film");
    std::fs::create_dir_all(&folder).unwrap();
    for (number, picture) in film.pictures.iter().enumerate() {
        let png = encode_png(film.size[0], film.size[1], PixelFormat::U8, picture).unwrap();
        std::fs::write(folder.join(format!("{number:03}.png")), png).unwrap();
    }
    let source = json!({"kind": "recording", "path": folder, "pace": "fit", "rate_hz": 0, "loop": true});
    system.client.put("/v1/sessions/files", &session(source)).expect(201);
    let (errors, _) = follow(system, "files", truths, PICTURES);
    assert_eq!(system.client.delete("/v1/sessions/files").status, 204);
    errors
}

/// A fit starts with the newest frame, so its age is at most one frame time plus the previous fit.
fn print_ages(what: &str, ages: &[i64]) {
    let mut sorted = ages.to_vec();
    sorted.sort_unstable();
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize] as f64 / 1000.0;
    eprintln!(
        "{what}: age at the start of the fit: median {:.1} ms, 95 % {:.1} ms, {:.1} ms at most",
        at(0.5),
        at(0.95),
        at(1.0)
    );
}

fn compare(what: &str, camera: &[(usize, f64)], files: &[(usize, f64)]) {
    let camera_px = rms(&camera.iter().map(|(_, error)| *error).collect::<Vec<_>>());
    // Compare the same pictures: a camera repeats some and skips some.
    let of = |picture: usize| files.iter().find(|(other, _)| *other == picture).map(|(_, error)| *error);
    let files_px = rms(&camera.iter().map(|(picture, _)| of(*picture).unwrap()).collect::<Vec<_>>());
    eprintln!("{what}: error of the centre {camera_px:.4} px, from files {files_px:.4} px");
    assert!(files_px < 0.05, "the film is easy: {files_px}");
    assert!(camera_px < 1.1 * files_px, "{what}: {camera_px} px, from files {files_px} px");
}

#[test]
#[ignore = "long proof"]
fn frames_of_a_loopback_device_are_tracked_as_well_as_from_files() {
    program().unwrap(); // build it outside the rig, where there is a compiler
    in_rig(Rig { loopback: Some(LOOPBACK), timeout_s: 150, ..Rig::default() }, || {
        let film = Film::render(circling(SMALL), PICTURES, *b"GREY").unwrap();
        let truths = truths(&film);
        let system = TestSystem::start();
        let files = from_files(&system, &film, &truths);
        let playing = film.play(Path::new("/dev/video0"), 10.0).unwrap();
        system.client.put("/v1/sessions/one", &session(json!({"kind": "camera", "device": "/dev/video0"}))).expect(201);
        let (camera, ages) = follow(&system, "one", &truths, 2 * PICTURES);
        print_ages("v4l2loopback, 10 Hz", &ages);
        compare("v4l2loopback", &camera, &files);
        // The view shows the camera's frames, numbered by the driver.
        let view = system.client.get("/v1/sessions/one").expect(200);
        assert_eq!(view["state"], "running");
        assert_eq!(view["source"]["device"], "/dev/video0");
        drop(playing);
    });
}

/// vivid loops its output to its own input: 60 pictures per second, not synchronised with the writer.
#[test]
#[ignore = "long proof"]
fn frames_of_vivids_own_loop_are_tracked_as_well_as_from_files() {
    program().unwrap();
    in_rig(Rig { vivid: Some(WEBCAM), timeout_s: 150, ..Rig::default() }, || {
        let film = Film::render(circling(LARGE), PICTURES, *b"GREY").unwrap();
        let truths = truths(&film);
        let system = TestSystem::start();
        let files = from_files(&system, &film, &truths);
        let writer = loop_back(&film);
        system
            .client
            .put("/v1/sessions/one", &session(json!({"kind": "camera", "device": "/dev/video0", "format": "GREY"})))
            .expect(201);
        let (camera, ages) = follow(&system, "one", &truths, 2 * PICTURES);
        print_ages("vivid's loop", &ages);
        compare("vivid's loop", &camera, &files);
        stop(writer);
    });
}

/// A fit of many frame times starts with the newest frame, not with the next of a queue: the frame's age does not grow
/// with the fit time.
#[test]
#[ignore = "long proof"]
fn slow_fits_start_with_the_newest_frame() {
    program().unwrap();
    in_rig(Rig { loopback: Some(LOOPBACK), timeout_s: 150, ..Rig::default() }, || {
        let film = Film::render(circling(SMALL), PICTURES, *b"GREY").unwrap();
        let system = TestSystem::start();
        // The profile as a mean of ten nearly identical ones.
        let slow = crate::plain_spot().replace(
            "sum(k[i] * s^i, i, 0, 3), 0)",
            "sum(sum(k[i] * (s * (1 + 1e-9 * sin(j * s)))^i, i, 0, 3), j, 0, 9) / 10, 0)",
        );
        assert_ne!(slow, crate::plain_spot());
        system.client.put_text("/v1/models/slow-spot", "application/toml", &slow).expect(201);
        let playing = film.play(Path::new("/dev/video0"), 50.0).unwrap();
        let mut document = session(json!({"kind": "camera", "device": "/dev/video0"}));
        document["model"] = json!("slow-spot");
        system.client.put("/v1/sessions/one", &document).expect(201);
        let mut socket = system.client.socket("one", "mode=all");
        socket.next().unwrap(); // includes compilation
        let (mut ages, mut fits, mut dropped) = (Vec::new(), Vec::new(), 0);
        while ages.len() < 12 {
            let estimate = socket.next().unwrap();
            ages.push(estimate["timing_us"]["wait"].as_i64().unwrap());
            fits.push(estimate["timing_us"]["fit"].as_i64().unwrap());
            dropped += estimate["dropped"].as_u64().unwrap();
        }
        drop(playing);
        fits.sort_unstable();
        let fit = fits[fits.len() / 2];
        print_ages(&format!("50 Hz, fits of {:.0} ms", fit as f64 / 1000.0), &ages);
        ages.sort_unstable();
        assert!(dropped > 12, "fits take several frame times: {fit} µs, {dropped} dropped");
        assert!(ages[ages.len() / 2] < fit / 2, "{ages:?} {fit}");
    });
}

/// Lists cameras and sets controls by the command line.
#[test]
#[ignore = "long proof"]
fn cameras_are_listed_and_set_by_the_command_line() {
    program().unwrap();
    in_rig(Rig { vivid: Some(WEBCAM), timeout_s: 150, ..Rig::default() }, || {
        let system = TestSystem::start();
        let table = system.isophote(&["cameras"]);
        eprintln!("{}", table.stdout);
        assert_eq!(table.status, Some(0), "{}", table.stderr);
        for word in ["/dev/video0", "vivid-platform-vivid-000", "640x480", "GREY", "gain_automatic", "0 to 255"] {
            assert!(table.stdout.contains(word), "no {word} in\n{}", table.stdout);
        }
        let listed: Value = serde_json::from_str(&system.isophote(&["cameras", "--json"]).stdout).unwrap();
        let gain = |listed: &Value| {
            let controls = listed["items"][0]["controls"].as_array().unwrap().clone();
            controls.iter().find(|control| control["name"] == "gain").unwrap().clone()
        };
        assert_eq!((&gain(&listed)["minimum"], &gain(&listed)["maximum"]), (&json!(0), &json!(255)));
        // vivid ignores a gain while gain is automatic, so automatic gain is switched off first.
        let set = system.isophote(&["camera", "set", "/dev/video0", "gain=9999", "brightness=17"]);
        assert_eq!(set.stdout, "brightness 17\ngain 255 (asked for 9999)\n", "{}", set.stderr);
        let set = system.isophote(&["camera", "set", "vivid-platform-vivid-000", "gain=33", "--json"]);
        assert_eq!(set.stdout, "{\"controls\":{\"gain\":33}}\n", "{}", set.stderr);
        let listed: Value = serde_json::from_str(&system.isophote(&["cameras", "--json"]).stdout).unwrap();
        assert_eq!(gain(&listed)["value"], 33);
        let wrong = system.isophote(&["camera", "set", "/dev/video0", "gian=33"]);
        assert_eq!(wrong.status, Some(6));
        assert!(wrong.stderr.contains("gain_automatic, gain,"), "{}", wrong.stderr);
        // A streaming camera is exclusive, and says so. Colour bars are full of edges: a small window suffices.
        let document = |source: Value| {
            let mut document = session(source);
            document["window"] = json!({"x": 300, "y": 200, "width": 32, "height": 24});
            document
        };
        let eye = json!({"kind": "camera", "device": "/dev/video0"});
        system.client.put("/v1/sessions/one", &document(eye.clone())).expect(201);
        system.until("one", "running", |view| view["frames"].as_u64() > Some(3));
        let two = system.client.put("/v1/sessions/two", &document(eye));
        assert!(two.expect(409)["detail"].as_str().unwrap().contains("in use"));
        // The same session may reopen it, and keeps it when its new document is invalid.
        let with = |format: &str| document(json!({"kind": "camera", "device": "/dev/video0", "format": format}));
        system.client.put("/v1/sessions/one", &with("YUYV")).expect(200);
        system.until("one", "running", |view| view["source"]["format"] == "YUYV" && view["frames"].as_u64() > Some(3));
        system.client.put("/v1/sessions/one", &with("H264")).expect(422);
        let frames = system.client.get("/v1/sessions/one").expect(200)["frames"].as_u64();
        system.until("one", "running still", |view| view["frames"].as_u64() > frames);
    });
}
