//! Recorded sessions: contents of the files, refusals, and the state after a kill.

use std::time::Instant;

use isophote_server::AccessOptions;
use isophote_tests::Service;
use serde_json::{Value, json};

use crate::client::{DEADLINE, Folder, Running, large, session, synthetic};
use crate::recorder::{RecordedMessage, doctor, expect_healthy, fits, of, read_messages, recorded};

/// A service that records below a folder of the test.
fn recording(name: &str) -> (Folder, Running) {
    let folder = Folder::new(name);
    let access = AccessOptions { recordings: Some(folder.0.clone()), ..AccessOptions::default() };
    (folder, Running::start_with_access(access))
}

#[test]
fn recordings_hold_all_frames_and_estimates() {
    let (folder, service) = recording("recorded");
    let mut estimates = Vec::new();
    let mut socket = None;
    let path = std::thread::scope(|scope| {
        let recording = scope.spawn(|| recorded(&service, &folder.0.join("recorded"), "one", 60));
        // Subscribe to the session while it is recorded.
        while socket.is_none() {
            socket = service.try_socket("one", "mode=all&credit=60000", "isophote.v1").ok();
        }
        let path = recording.join().unwrap();
        service.delete("/v1/sessions/one");
        while let Ok(estimate) = socket.as_mut().unwrap().next() {
            estimates.push(estimate);
        }
        path
    });
    let all = read_messages(&path);
    let session = of(&all, "isophote.Session");
    assert_eq!(
        (session.len(), &session[0].json["session"], &session[0].json["version"]),
        (1, &json!("one"), &json!(1))
    );
    let models: Vec<&Value> = of(&all, "isophote.Swap").iter().map(|swap| &swap.json["name"]).collect();
    assert_eq!(models, ["spot", "gaussian", "spot"]);
    assert!(of(&all, "isophote.Snapshot").len() >= 3, "at the begin and at each swap");
    let fits = of(&all, "isophote.Fit");
    let frames: Vec<u64> = fits.iter().map(|fit| fit.json["frame"].as_u64().unwrap()).collect();
    assert!(frames.windows(2).all(|two| two[1] == two[0] + 1), "every frame is fitted: {frames:?}");
    assert!(fits.iter().all(|fit| fit.json["has_pixels"] == true), "{frames:?}");
    let pictures = of(&all, "foxglove.RawImage");
    assert!(pictures.len() >= fits.len() && pictures.iter().all(|one| one.pixels.as_ref().unwrap().len() == 64 * 48));
    // The streamed estimates equal the recorded ones; each has the time of its picture.
    let mut compared = 0;
    for recorded in of(&all, "isophote.Estimate") {
        let at = |one: &&RecordedMessage| one.log_time == recorded.log_time;
        assert!(pictures.iter().any(at) && fits.iter().any(at));
        let streamed = estimates.iter().find(|one| one["frame"] == recorded.json["frame"]);
        let Some(streamed) = streamed else { continue };
        assert_eq!(streamed["parameters"], recorded.json["parameters"]);
        assert_eq!(streamed["covariance"], recorded.json["covariance"]);
        compared += 1;
    }
    assert!(compared > 10, "{compared} of {} estimates", estimates.len());
    assert_eq!(of(&all, "foxglove.ImageAnnotations").len(), fits.len());
    expect_healthy(&path, fits.len());
    // The recording is listed, downloaded unchanged, usable as a source, and deleted.
    let list = service.get("/v1/recordings").expect(200);
    assert_eq!(list["items"][0]["file"], "one-0001.mcap", "{list}");
    let mut sent = ureq::get(format!("{}/v1/recordings/one-0001.mcap", service.url)).call().unwrap();
    assert_eq!(sent.body_mut().with_config().limit(1 << 30).read_to_vec().unwrap(), std::fs::read(&path).unwrap());
    let source = json!({"kind": "recording", "path": "recorded/one-0001.mcap", "rate_hz": 1000, "pace": "fit"});
    service.put("/v1/sessions/two", &json!({"source": source, "model": "spot"})).expect(201);
    let view = service.wait_for("two", |view| view["state"] == "stopped");
    assert_eq!(view["frames"], pictures.len(), "{view}");
    assert_eq!(service.delete("/v1/recordings/one-0001.mcap").status, 204);
    let problem = service.delete("/v1/recordings/one-0001.mcap").expect(404);
    assert_eq!(problem["detail"], "there is no recording `one-0001.mcap`");
    assert_eq!(service.get("/v1/recordings").expect(200)["items"], json!([]));
    service.stop();
}

#[test]
fn clients_choose_neither_folders_nor_other_files() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    let answer = service.put("/v1/sessions/one/recording", &json!({})).expect(409);
    assert!(answer["detail"].as_str().unwrap().contains("--recordings DIR or --data DIR"), "{answer}");
    assert_eq!(service.get("/v1/recordings").expect(200)["items"], json!([]));
    service.stop();

    let (folder, service) = recording("recorded-refused");
    std::fs::write(folder.0.join("secret.mcap"), "secret").unwrap();
    let at = "/v1/sessions/one/recording";
    service.put("/v1/sessions/none/recording", &json!({})).expect(404);
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.get(at).expect(404);
    service.delete(at).expect(404);
    for (document, key) in [
        (json!({"path": "/tmp/a.mcap"}), "path"),
        (json!({"name": "../secret"}), "name"),
        (json!({"name": "a/b"}), "name"),
        (json!({"name": "-a"}), "name"),
        (json!({"name": ""}), "name"),
        (json!({"name": "a".repeat(65)}), "name"),
        (json!({"frames": "gif"}), "frames"),
        (json!({"disk_budget_mb": 0}), "disk_budget_mb"),
        (json!({"rotate_mb": 0}), "rotate_mb"),
        (json!({"rotate_s": 2_000_000}), "rotate_s"),
    ] {
        let answer = service.put(at, &document).expect(422);
        assert_eq!(answer["diagnostics"][0]["key"], key, "{document}: {answer}");
    }
    service.put(at, &json!({"name": "mine"})).expect(201);
    let answer = service.put(at, &json!({})).expect(409);
    assert!(answer["detail"].as_str().unwrap().contains("DELETE"), "{answer}");
    service.recording("one", |view| fits(view) > 3);
    service.delete("/v1/recordings/mine-0001.mcap").expect(409);
    service.get("/v1/recordings/mine-0001.mcap").expect(404);
    assert_eq!(service.delete(at).status, 204);
    let answer = service.put(at, &json!({"name": "mine"})).expect(409);
    assert!(answer["detail"].as_str().unwrap().contains("another name"), "{answer}");
    std::os::unix::fs::symlink("../secret.mcap", folder.0.join("recorded/link.mcap")).unwrap();
    for file in ["link.mcap", "..%2Fsecret.mcap", "secret.mcap", "mine-0001.part.mcap", "%2Fetc%2Fpasswd", "mine-0001"]
    {
        service.get(&format!("/v1/recordings/{file}")).expect(404);
        if file != "link.mcap" {
            service.delete(&format!("/v1/recordings/{file}")).expect(404);
        }
    }
    assert_eq!(std::fs::read(folder.0.join("secret.mcap")).unwrap(), b"secret");
    service.stop();
}

/// Frames of 3 kB, so that a file of a megabyte holds some 300.
#[test]
fn files_are_rotated_and_budgets_kept() {
    let (folder, service) = recording("recorded-budget");
    let document = json!({"source": synthetic("fit", 1000.0), "model": "spot"});
    service.put("/v1/sessions/one", &document).expect(201);
    let at = "/v1/sessions/one/recording";
    let files = |view: &Value| view["files"].as_array().unwrap().len();
    service.put(at, &json!({"name": "ring", "disk_budget_mb": 4, "rotate_mb": 1, "csv": true})).expect(201);
    let view = service.recording("one", |view| !view["files"].as_array().unwrap().contains(&json!("ring-0001.mcap")));
    assert!(view["state"] == "recording" && files(&view) <= 4, "{view}");
    assert_eq!(service.delete(at).status, 204);
    let left = service.get("/v1/recordings").expect(200);
    let left = left["items"].as_array().unwrap();
    // All files count, tables as well.
    let whole = std::fs::read_dir(folder.0.join("recorded")).unwrap();
    let whole: u64 = whole.map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    let files: u64 = left.iter().map(|one| one["bytes"].as_u64().unwrap()).sum();
    assert!(left.len() >= 2 && files < whole && whole <= 4_000_000, "{whole}: {left:?}");
    for one in left {
        // Each file can be replayed on its own.
        let path = folder.0.join("recorded").join(one["file"].as_str().unwrap());
        let all = read_messages(&path);
        let order: Vec<&str> =
            all.iter().map(|one| one.schema.as_str()).filter(|schema| schema.starts_with("isophote.")).collect();
        assert_eq!(order[..4], ["isophote.Session", "isophote.Swap", "isophote.Snapshot", "isophote.Fit"], "{one}");
        assert!(of(&all, "isophote.Fit").iter().all(|fit| fit.json["has_pixels"] == true), "{one}");
        let rows = std::fs::read_to_string(path.with_extension("csv")).unwrap();
        assert!(rows.starts_with("unix_ns,frame,target,state,model,"), "{rows}");
        assert_eq!(rows.lines().count(), 1 + of(&all, "isophote.Estimate").len(), "{one}");
    }
    service.put(at, &json!({"name": "short", "disk_budget_mb": 1})).expect(201);
    let view = service.recording("one", |view| view["state"] == "ended");
    assert!(
        view["reason"].as_str().unwrap().contains("budget of 1 MB") && view["bytes"].as_u64() <= Some(1_000_000),
        "{view}"
    );
    let all = read_messages(&folder.0.join("recorded/short-0001.mcap"));
    assert_eq!(of(&all, "isophote.Fit").len(), fits(&view) as usize);
    // A frame that exceeds the budget is not written.
    let document = json!({"source": large("fit", 100.0), "model": "spot"});
    service.put("/v1/sessions/large", &document).expect(201);
    service.put("/v1/sessions/large/recording", &json!({"name": "large", "disk_budget_mb": 1})).expect(201);
    let view = service.recording("large", |view| view["state"] == "ended");
    assert!(view["bytes"].as_u64() <= Some(1_000_000) && view["recorded_frames"] == 0, "{view}");
    service.delete("/v1/sessions/large").expect(204);
    // A recording that has ended is replaced by the next.
    service.put(at, &json!({"name": "packed", "frames": "jpeg"})).expect(201);
    service.recording("one", |view| fits(view) > 10);
    assert_eq!(service.delete(at).status, 204);
    assert!(!of(&read_messages(&folder.0.join("recorded/packed-0001.mcap")), "foxglove.CompressedImage").is_empty());
    service.stop();
}

/// Everything on the disk at the kill is kept, and the file gets its end.
#[test]
fn recordings_survive_kill_9() {
    let folder = Folder::new("recorded-kill");
    let program = isophote_tests::program().unwrap();
    let serve = || Service::start(&program, &["--data", folder.0.to_str().unwrap()], &folder.0).unwrap();
    let mut process = serve();
    let service = Running::at(process.address());
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.put("/v1/sessions/one/recording", &json!({"name": "cut"})).expect(201);
    let view = service.recording("one", |view| view["bytes"].as_u64() > Some(300_000) && fits(view) > 100);
    process.child().kill().unwrap();
    process.child().wait().unwrap();
    let recordings = folder.0.join("recordings");
    assert!(recordings.join("cut-0001.part.mcap").exists());
    let before = of(&read_messages(&recordings.join("cut-0001.part.mcap")), "isophote.Fit").len();
    if let Some(report) = doctor(&recordings.join("cut-0001.part.mcap")) {
        assert_eq!(report["messages"]["isophote.Fit"], before, "{report}");
        assert_eq!(report["faults"], json!(["it has no end"]), "{report}");
    }
    let process = serve();
    let service = Running::at(process.address());
    let start = Instant::now();
    while service.get("/v1/recordings").expect(200)["items"] == json!([]) {
        assert!(start.elapsed() < DEADLINE);
        std::thread::yield_now();
    }
    let list = service.get("/v1/recordings").expect(200);
    assert_eq!(list["items"][0]["file"], "cut-0001.mcap", "{list}");
    assert!(list["items"][0]["bytes"].as_u64() >= view["bytes"].as_u64(), "{list}: {view}");
    let all = read_messages(&recordings.join("cut-0001.mcap"));
    assert_eq!(of(&all, "isophote.Fit").len(), before);
    expect_healthy(&recordings.join("cut-0001.mcap"), before);
    let bytes = std::fs::read(recordings.join("cut-0001.mcap")).unwrap();
    assert!(bytes.ends_with(b"\x89MCAP0\r\n"), "it has its end");
}
