//! Replay repeats fits bit for bit, swaps included, from the middle of a track on; differences are named.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use isophote_tests::{Finished, Service, finish, program, repository};
use isophote_tracker::{CameraResponse, GainMap};
use serde_json::{Value, json};

use crate::client::{Folder, Running, large, session};
use crate::recorder::{of, read_messages, recorded};

const LIMIT: Duration = Duration::from_secs(120);

fn run(arguments: &[&str]) -> Finished {
    let mut command = Command::new(program().unwrap());
    finish(command.args(arguments).current_dir(repository()), LIMIT).unwrap()
}

/// A service process, so that the replay runs the same build.
fn served(name: &str) -> (Folder, Service, Running) {
    let folder = Folder::new(name);
    let process =
        Service::start(&program().unwrap(), &["--recordings", folder.0.to_str().unwrap()], &folder.0).unwrap();
    let service = Running::at(process.address());
    (folder, process, service)
}

/// A copy of the file with some bytes of its messages changed and valid checksums.
fn changed(path: &Path, name: &str, mut change: impl FnMut(&str, u64, &mut Vec<u8>)) -> PathBuf {
    let bytes = std::fs::read(path).unwrap();
    let changed = path.with_file_name(name);
    let mut writer = mcap::Writer::new(std::fs::File::create(&changed).unwrap()).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let mut message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap().name.clone();
        let mut data = message.data.to_vec();
        change(&schema, message.log_time, &mut data);
        message.data = data.into();
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    changed
}

#[test]
fn fits_are_repeated_bit_for_bit_with_swaps_between_them() {
    let (folder, _process, service) = served("replayed");
    let path = recorded(&service, &folder.0.join("recorded"), "one", 150);
    let file = path.to_str().unwrap();
    let verified = run(&["replay", file, "--verify", "--json"]);
    assert_eq!(verified.status, Some(0), "{}{}", verified.stdout, verified.stderr);
    let verdict: Value = serde_json::from_str(&verified.stdout).unwrap();
    assert_eq!(
        (&verdict["swaps"], &verdict["is_equal"], &verdict["left_out"]),
        (&json!(2), &json!(true), &json!(0)),
        "{verdict}"
    );
    assert!(verdict["fits"].as_u64() >= Some(150) && verdict["reasons"].is_null(), "{verdict}");
    assert!(run(&["replay", file, "--verify"]).stdout.contains("2 swaps and"));

    // One pixel of the target in one frame.
    let mut pictures = 0;
    let mut at = None;
    let pixel = changed(&path, "pixel.mcap", |schema, log_time, data| {
        if schema == "foxglove.RawImage" {
            pictures += 1;
            if pictures == 40 {
                let place = data.len() - 64 * 48 + 24 * 64 + 30;
                data[place] ^= 0x40;
                at = Some(log_time);
            }
        }
    });
    let frame = read_messages(&pixel).into_iter().find(|one| one.schema == "isophote.Fit" && Some(one.log_time) == at);
    let frame = frame.unwrap().json["frame"].as_u64().unwrap();
    let verified = run(&["replay", pixel.to_str().unwrap(), "--verify"]);
    assert_eq!(verified.status, Some(1), "{}", verified.stdout);
    assert!(verified.stderr.contains(&format!("frame {frame} comes out otherwise")), "{}", verified.stderr);

    // One bit of one recorded parameter.
    let mut fits = 0;
    let changed_path = changed(&path, "said.mcap", |schema, _, data| {
        if schema == "isophote.Estimate" {
            fits += 1;
            if fits == 20 {
                let mut estimate: Value = serde_json::from_slice(data).unwrap();
                let by = estimate["parameters"]["by"].as_f64().unwrap();
                estimate["parameters"]["by"] = json!(f64::from_bits(by.to_bits() ^ 1));
                *data = estimate.to_string().into_bytes();
            }
        }
    });
    let verified = run(&["replay", changed_path.to_str().unwrap(), "--verify"]);
    assert!(verified.status == Some(1) && verified.stderr.contains("parameters.by was"), "{}", verified.stderr);

    // Recordings of another build are reported.
    let foreign = changed(&path, "foreign.mcap", |schema, _, data| {
        if schema == "isophote.Session" {
            let mut session: Value = serde_json::from_slice(data).unwrap();
            session["build"]["checksum"] = json!("crc32:00000000-1");
            *data = session.to_string().into_bytes();
        }
    });
    let verified = run(&["replay", foreign.to_str().unwrap(), "--verify"]);
    assert!(
        verified.status == Some(0) && verified.stdout.contains("another build"),
        "{}{}",
        verified.stdout,
        verified.stderr
    );

    // The estimates again, and another model on the same frames.
    let lines = run(&["replay", file, "--json"]);
    assert_eq!(lines.status, Some(0), "{}", lines.stderr);
    assert_eq!(lines.stdout.lines().count() as u64, verdict["fits"].as_u64().unwrap());
    let table = run(&["replay", file, "--model", "models/gaussian.toml", "--json"]);
    assert_eq!(table.status, Some(0), "{}", table.stderr);
    let rows: Vec<Value> = table.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(
        (rows.len(), &rows[0]["model"], &rows[1]["model"]),
        (2, &json!("spot, gaussian (recorded)"), &json!("gaussian"))
    );
    assert!(rows.iter().all(|row| row["frames"] == verdict["fits"] && row["rmse_px"].as_f64() < Some(2.0)), "{rows:?}");
}

/// Realtime frames: some are skipped, fits are ended by their budget, alternatives get ready meanwhile.
#[test]
fn budgets_and_alternatives_are_repeated() {
    let (folder, _process, service) = served("replayed-live");
    let mut document = session("realtime", 100.0);
    document["source"]["full_well_e"] = json!(5000);
    service.put("/v1/sessions/live", &document).expect(201);
    service.put("/v1/sessions/live/recording", &json!({"name": "live"})).expect(201);
    service.recording("live", |view| view["fits"].as_u64() > Some(150));
    assert_eq!(service.delete("/v1/sessions/live/recording").status, 204);
    let path = folder.0.join("recorded/live-0001.mcap");
    let verified = run(&["replay", path.to_str().unwrap(), "--verify"]);
    assert_eq!(verified.status, Some(0), "{}{}", verified.stdout, verified.stderr);
}

/// A fit ended by its budget is ended at the same pass.
#[test]
fn fits_ended_by_their_budget_are_repeated() {
    let (folder, _process, service) = served("replayed-budget");
    // A budget of 1 ms per frame, for fits that take longer.
    service.put("/v1/sessions/one", &json!({"source": large("realtime", 1000.0), "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["last"]["ending"] == "budget");
    service.put("/v1/sessions/one/recording", &json!({"name": "budget", "disk_budget_mb": 400})).expect(201);
    let over = || service.get("/v1/sessions/one").expect(200)["over_budget"].as_u64().unwrap();
    let before = over();
    service.recording("one", |view| view["fits"].as_u64() > Some(10) && over() > before + 5);
    service.delete("/v1/sessions/one/recording").expect(204);
    let path = folder.0.join("recorded/budget-0001.mcap");
    let all = read_messages(&path);
    let ended = of(&all, "isophote.Fit").iter().filter(|fit| fit.json["stopped"]["why"] == "budget").count();
    assert!(ended > 0);
    let verified = run(&["replay", path.to_str().unwrap(), "--verify"]);
    assert_eq!(verified.status, Some(0), "{}{}", verified.stdout, verified.stderr);
}

/// A promoted shadow brings its state, which is recorded.
#[test]
fn promoted_shadows_are_repeated() {
    let (folder, _process, service) = served("replayed-shadow");
    let mut document = session("fit", 100.0);
    document["source"]["full_well_e"] = json!(5000);
    service.put("/v1/sessions/one", &document).expect(201);
    service.put("/v1/sessions/one/recording", &json!({"name": "shadow"})).expect(201);
    service.put("/v1/sessions/one/shadow", &json!({"model": "gaussian"})).expect(201);
    service.wait_for("one", |view| view["shadow"]["frames"].as_u64() > Some(20));
    service.request("POST", "/v1/sessions/one/shadow:promote", &[], b"").expect(200);
    let now = service.recording("one", |_| true)["fits"].as_u64();
    service.recording("one", |view| view["fits"].as_u64() > now.map(|now| now + 40));
    service.delete("/v1/sessions/one/recording").expect(204);
    let path = folder.0.join("recorded/shadow-0001.mcap");
    let all = read_messages(&path);
    let swaps = of(&all, "isophote.Swap");
    assert_eq!((swaps.len(), &swaps[1].json["is_warm"]), (2, &json!(true)));
    let verified = run(&["replay", path.to_str().unwrap(), "--verify", "--json"]);
    assert_eq!(verified.status, Some(0), "{}{}", verified.stdout, verified.stderr);
    let verdict: Value = serde_json::from_str(&verified.stdout).unwrap();
    assert_eq!((&verdict["swaps"], &verdict["is_equal"]), (&json!(1), &json!(true)), "{verdict}");
}

/// Pixel values with a gamma are linearised before fits, in a session as in a replay.
#[test]
fn fits_through_a_response_are_repeated() {
    let (folder, _process, service) = served("replayed-response");
    let mut document = session("fit", 100.0);
    let steps: Vec<i8> = (0..64 * 48).map(|place: i32| (place * 37 % 41 - 20) as i8).collect();
    let gains = GainMap { width: 64, height: 48, step: 0.002, steps: steps.into() };
    let response = CameraResponse { gamma: 0.45, gains: Some(gains) };
    document["source"]["full_well_e"] = json!(5000);
    (document["source"]["black"], document["source"]["response"]) = (json!(16), json!(response));
    service.put("/v1/sessions/raw", &document).expect(201);
    document["camera"] = json!({"black": 16, "saturation": 255, "response": response});
    service.put("/v1/sessions/light", &document).expect(201);
    service.put("/v1/sessions/light/recording", &json!({"name": "light"})).expect(201);
    service.recording("light", |view| view["fits"].as_u64() > Some(40));
    assert_eq!(service.delete("/v1/sessions/light/recording").status, 204);
    let ground = |name: &str| {
        let view = service.wait_for(name, |view| view["last"]["state"] == "tracking");
        view["last"]["parameters"]["v0"].as_f64().unwrap()
    };
    assert!((ground("light") - 20.0).abs() < 1.0, "{}", ground("light"));
    assert!(ground("raw") > 60.0, "{}", ground("raw"));
    let verified = run(&["replay", folder.0.join("recorded/light-0001.mcap").to_str().unwrap(), "--verify"]);
    assert_eq!(verified.status, Some(0), "{}{}", verified.stdout, verified.stderr);
}

#[test]
fn unrepeatable_recordings_say_why() {
    let (folder, _process, service) = served("replayed-not");
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    for frames in ["jpeg", "none"] {
        service.put("/v1/sessions/one/recording", &json!({"name": frames, "frames": frames})).expect(201);
        service.recording("one", |view| view["fits"].as_u64() > Some(10));
        assert_eq!(service.delete("/v1/sessions/one/recording").status, 204);
        let path = folder.0.join(format!("recorded/{frames}-0001.mcap"));
        let verified = run(&["replay", path.to_str().unwrap(), "--verify"]);
        let reason = if frames == "jpeg" { "packed as JPEG" } else { "it has no pixels" };
        assert!(verified.status == Some(1) && verified.stderr.contains(reason), "{}", verified.stderr);
        let lines = run(&["replay", path.to_str().unwrap()]);
        assert!(lines.status == Some(0) && lines.stdout.lines().count() > 10, "{}", lines.stderr);
    }
    let foreign = run(&["replay", "models/spot.toml", "--verify"]);
    assert!(foreign.status == Some(1) && foreign.stderr.contains("no MCAP file"), "{}", foreign.stderr);
}

/// The command records, downloads the file, and leaves nothing behind.
#[test]
fn record_command_leaves_nothing_behind() {
    let (folder, process, service) = served("replayed-command");
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    let out = folder.0.join("mine.mcap");
    let url = process.url();
    let arguments = ["record", "one", "--out", out.to_str().unwrap(), "--count", "40", "--server", &url, "--json"];
    let finished = run(&arguments);
    assert_eq!(finished.status, Some(0), "{}", finished.stderr);
    let view: Value = serde_json::from_str(&finished.stdout).unwrap();
    assert!(view["fits"].as_u64() >= Some(40), "{view}");
    assert_eq!(service.get("/v1/recordings").expect(200)["items"], json!([]));
    let verified = run(&["replay", out.to_str().unwrap(), "--verify"]);
    assert_eq!(verified.status, Some(0), "{}", verified.stderr);
    // `fit` reads its pictures.
    let fitted = run(&["fit", "models/spot.toml", "--frames", out.to_str().unwrap(), "--json"]);
    assert!(fitted.status == Some(0) && fitted.stdout.lines().count() >= 40, "{}", fitted.stderr);
    let none = run(&["record", "none", "--out", out.to_str().unwrap(), "--seconds", "1", "--server", &url]);
    assert!(none.status == Some(5) && none.stderr.contains("none"), "{}", none.stderr);
}
