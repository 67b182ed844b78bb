//! Shadows: another model on the frames of a session, beside its own, until it is dropped or promoted.

use std::process::{Command, Stdio};
use std::time::Duration;

use isophote_tests::{finish, program};
use serde_json::{Value, json};

use crate::client::{Folder, Running, session, synthetic};
use crate::recorder::{fits, of, read_messages};

const SHADOW: &str = "/v1/sessions/one/shadow";
const MINUTE: Duration = Duration::from_secs(60);

fn put(service: &Running, model: &str) -> Value {
    let answer = service.put(SHADOW, &json!({"model": model}));
    assert!(answer.status == 200 || answer.status == 201, "{}", answer.text);
    answer.json()
}

/// Waits until both have fitted that many frames together.
fn wait_for_pairs(service: &Running, frames: u64) -> Value {
    let view = service.wait_for("one", |view| view["shadow"]["frames"].as_u64() >= Some(frames));
    view["shadow"].clone()
}

#[test]
fn both_estimates_stand_side_by_side() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    service.get(SHADOW).expect(404);
    service.delete(SHADOW).expect(404);
    assert_eq!(service.try_socket("one", "shadow=1", "isophote.v1").err(), Some(404));
    let begun = service.put(SHADOW, &json!({"model": "gaussian"})).expect(201);
    assert_eq!(begun["model"], "gaussian");
    assert_eq!(begun["carried"], json!(["bx", "by", "a1", "a2", "a3", "v0", "v1"]), "as with a swap");
    let mut socket = service.socket("one", "mode=all&shadow=1");
    for _ in 0..20 {
        let pair = socket.next().unwrap();
        let shadow = &pair["shadow"];
        assert!(pair["model"].as_str().unwrap().starts_with("spot@sha256:"), "{pair}");
        assert!(shadow["estimate"]["model"].as_str().unwrap().starts_with("gaussian@sha256:"), "{pair}");
        assert_eq!(shadow["estimate"]["frame"], pair["frame"]);
        for estimate in [&pair, &shadow["estimate"]] {
            assert_eq!(estimate["state"], "tracking", "{pair}");
            assert!(estimate["reduced_chi_square"].is_number() && estimate["timing_us"]["fit"].is_number(), "{pair}");
        }
        let difference = |name: &str| {
            shadow["estimate"]["parameters"][name].as_f64().unwrap() - pair["parameters"][name].as_f64().unwrap()
        };
        let shift = &shadow["parameters"]["bx"];
        assert!((shift["difference"].as_f64().unwrap() - difference("bx")).abs() < 1e-12, "{pair}");
        assert!(shift["deviations"].is_number(), "{pair}");
        let centre_px = difference("bx").hypot(difference("by"));
        assert!((shadow["centre_px"].as_f64().unwrap() - centre_px).abs() < 1e-9, "{pair}");
        assert!(shadow["parameters"].get("k1").is_none(), "only one of them has it: {pair}");
    }
    let view = wait_for_pairs(&service, 20);
    assert_eq!((&view["state"], &view["model"]), (&json!("running"), &json!("gaussian")), "{view}");
    assert!(view["cost_ms"].is_number() && view["last"]["centre_px"].is_number(), "{view}");
    assert_eq!(service.get(SHADOW).expect(200)["model"], "gaussian");
    // Only subscribers who ask for the shadow see it.
    assert!(service.socket("one", "mode=latest").next().unwrap().get("shadow").is_none());
    // A model that does not match the target finds nothing, and the session is unaffected.
    assert_eq!(service.put(SHADOW, &json!({"model": "dark-disc"})).expect(200)["model"], "dark-disc");
    while socket.next().is_ok() {}
    let view = wait_for_pairs(&service, 3);
    assert_ne!(view["last"]["estimate"]["state"], "tracking", "{view}");
    assert_eq!(view["last"]["parameters"], json!({}), "nothing to compare: {view}");
    let mut socket = service.socket("one", "mode=all&shadow=1");
    let session = service.get("/v1/sessions/one").expect(200);
    assert_eq!((&session["last"]["state"], &session["dropped"]), (&json!("tracking"), &json!(0)), "{session}");
    assert_eq!(service.delete(SHADOW).status, 204);
    let code = loop {
        match socket.next() {
            Ok(_) => {}
            Err(code) => break code,
        }
    };
    assert_eq!(code, 1000);
    service.get(SHADOW).expect(404);
    assert!(service.get("/v1/sessions/one").expect(200).get("shadow").is_none());
    service.stop();
}

#[test]
fn shadows_are_promoted_between_two_frames_with_their_state() {
    let folder = Folder::new("shadows-promoted");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let mut socket = service.socket("one", "mode=all");
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    service.request("POST", "/v1/sessions/one/shadow:promote", &[], b"").expect(404);
    put(&service, "gaussian");
    wait_for_pairs(&service, 5);
    let answer = service.request("POST", "/v1/sessions/one/shadow:promote", &[], b"").expect(200);
    let since = answer["active_since_frame"].as_u64().unwrap();
    assert_eq!((&answer["active_model"], &answer["reset"]), (&json!("gaussian"), &json!([])), "{answer}");
    assert!(answer["carried"].as_array().unwrap().contains(&json!("bx")), "{answer}");
    let mut last: Option<u64> = None;
    let mut found = false;
    while last.is_none_or(|last| last < since + 20) {
        let estimate = socket.next().unwrap();
        let frame = estimate["frame"].as_u64().unwrap();
        assert!(last.is_none_or(|last| last + 1 == frame), "no frame is lost: {frame} after {last:?}");
        let name = if frame < since { "spot@" } else { "gaussian@" };
        assert!(estimate["model"].as_str().unwrap().starts_with(name), "{since}: {estimate}");
        found |= estimate["state"] == "tracking";
        assert!(!found || estimate["state"] == "tracking", "it goes on where the shadow was: {estimate}");
        last = Some(frame);
    }
    let view = service.get("/v1/sessions/one").expect(200);
    assert!(view.get("shadow").is_none() && view["active_model"] == "gaussian" && view["dropped"] == 0, "{view}");
    // The promoted model is declared, a shadow is not.
    put(&service, "spot");
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    let view = service.wait_for("one", |view| view["last"]["state"] == "tracking");
    assert!(view.get("shadow").is_none() && view["active_model"] == "gaussian", "{view}");
    service.stop();
}

/// A shadow's constants stay with its model after promotion and a restart, whatever the session's document says.
#[test]
fn promoted_shadows_keep_their_constants() {
    let folder = Folder::new("shadows-constants");
    let service = Running::start_with(Some(&folder.0), false);
    let mut document = session("fit", 200.0);
    document["constants"] = json!({"gain": 0.06});
    service.put("/v1/sessions/one", &document).expect(201);
    service.put(SHADOW, &json!({"model": "spot", "constants": {"gain": 0.07}})).expect(201);
    wait_for_pairs(&service, 2);
    service.request("POST", "/v1/sessions/one/shadow:promote", &[], b"").expect(200);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["constants"]["gain"], 0.07);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    service.wait_for("one", |view| view["frames"].as_u64() > Some(2));
    assert_eq!(service.get("/v1/sessions/one").expect(200)["constants"]["gain"], 0.07);
    // The fits use them as well.
    service.put("/v1/sessions/one/recording", &json!({"name": "one"})).expect(201);
    service.recording("one", |view| fits(view) > 2);
    service.delete("/v1/sessions/one/recording").expect(204);
    let all = read_messages(&folder.0.join("recordings/one-0001.mcap"));
    assert_eq!(of(&all, "isophote.Swap")[0].json["constants"]["gain"], 0.07);
    // A swap restores the session's constants.
    service.put("/v1/sessions/one/model", &json!({"model": "spot"})).expect(200);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["constants"]["gain"], 0.06);
    service.stop();
}

#[test]
fn invalid_shadows_are_rejected() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    let wrong = [
        (json!({"model": "absent"}), 404),
        (json!({"model": "blob-3d"}), 409),
        (json!({"model": "gaussian", "constants": {"absent": 1}}), 422),
        (json!({"model": "gaussian", "constant": {}}), 422),
        (json!({}), 422),
    ];
    for (document, status) in wrong {
        service.put(SHADOW, &document).expect(status);
        service.get(SHADOW).expect(404);
    }
    service.put("/v1/sessions/absent/shadow", &json!({"model": "gaussian"})).expect(404);
    assert_eq!(service.get("/v1/sessions/one/estimates?shadow=2").status, 400);
    // A model used by a shadow cannot be removed.
    put(&service, "gaussian");
    let problem = service.delete("/v1/models/gaussian").expect(409);
    assert!(problem["detail"].as_str().unwrap().contains("`one`"), "{problem}");
    // The shadow ends with its session.
    let mut socket = service.socket("one", "mode=all&shadow=1");
    socket.next().unwrap();
    service.delete("/v1/sessions/one");
    while socket.next().is_ok() {}
    assert_eq!(service.delete("/v1/models/gaussian").status, 204);
    service.stop();
}

fn compare(service: &Running, arguments: &[&str]) -> Command {
    let mut command = Command::new(program().unwrap());
    command.arg("compare").args(arguments).env("ISOPHOTE_SERVER", &service.url);
    command
}

#[test]
fn compare_command_runs_on_a_live_session() {
    let service = Running::start();
    let mut source = synthetic("fit", 100.0);
    (source["full_well_e"], source["read_noise_e"]) = (json!(5000), json!(15));
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    let run = |arguments: &[&str]| finish(&mut compare(&service, arguments), MINUTE).unwrap();
    let compared = run(&["--live", "one", "gaussian", "--count", "30", "--json"]);
    assert_eq!(compared.status, Some(0), "{}", compared.stderr);
    let compared: Value = serde_json::from_str(&compared.stdout).unwrap();
    for (number, model) in ["spot", "gaussian"].iter().enumerate() {
        let row = &compared["models"][number];
        assert_eq!(
            (&row["model"], &row["frames"], &row["tracked"]),
            (&json!(model), &json!(30), &json!(30)),
            "{compared}"
        );
        assert!(row["time_us"].is_number() && row["reduced_chi_square"].is_number(), "{compared}");
        assert!(row["rmse_px"].as_f64().unwrap() < 0.5, "{compared}");
    }
    assert!(
        compared["centre_px"].as_f64().unwrap() < 0.5 && compared["parameters"]["bx"]["deviations"].is_number(),
        "{compared}"
    );
    service.get(SHADOW).expect(404);
    let compared = run(&["--live", "one", "gaussian", "--count", "5"]);
    assert!(compared.stdout.contains("gaussian") && compared.stdout.contains("PARAMETER"), "{}", compared.stdout);

    // An existing shadow is kept.
    put(&service, "gaussian");
    let compared = run(&["--live", "one", "gaussian"]);
    assert_eq!(compared.status, Some(6));
    assert!(compared.stderr.contains("has a shadow already"), "{}", compared.stderr);
    service.get(SHADOW).expect(200);
    service.delete(SHADOW);

    for wrong in [vec!["--live", "one", "gaussian", "spot"], vec!["--live", "one", "a.toml"], vec!["gaussian"]] {
        assert_eq!(run(&wrong).status, Some(2), "{wrong:?}");
    }
    // When interrupted, it removes the shadow and prints the results so far.
    let mut command = compare(&service, &["--live", "one", "gaussian", "--count", "10000", "--json"]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for_pairs(&service, 10);
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let compared = child.wait_with_output().unwrap();
    assert_eq!(compared.status.code(), Some(0), "{}", String::from_utf8_lossy(&compared.stderr));
    let compared: Value = serde_json::from_slice(&compared.stdout).unwrap();
    assert!(compared["models"][1]["frames"].as_u64() > Some(0), "{compared}");
    service.get(SHADOW).expect(404);
    service.stop();
}
