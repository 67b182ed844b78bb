//! Scenes: synthetic sources change while they run.

use serde_json::{Value, json};

use crate::client::{Folder, Running, Socket, session, synthetic};

const SCENE: &str = "/v1/sources/stage/scene";

/// A source that loses no frame, and a session on it.
fn staged(service: &Running) -> Socket {
    service.put("/v1/sources/stage", &synthetic("fit", 0.0)).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "stage", "model": "spot"})).expect(201);
    service.socket("one", "mode=all")
}

/// The next estimates, up to that frame.
fn until(socket: &mut Socket, frame: u64) -> Vec<Value> {
    let mut found: Vec<Value> = Vec::new();
    while found.last().is_none_or(|last| last["frame"].as_u64().unwrap() < frame) {
        found.push(socket.next().unwrap());
    }
    found
}

#[test]
fn scenes_change_between_frames_without_resetting_time() {
    let service = Running::start();
    let mut socket = staged(&service);
    let before = socket.next().unwrap()["frame"].as_u64().unwrap();
    let set = json!({"a1": 0.01, "a2": 0.0, "a3": 0.015625, "v0": 20, "v1": 90});
    let scene = service.put(SCENE, &json!({"set": set})).expect(200);
    let since = scene["since_frame"].as_u64().unwrap();
    assert!(since > before, "{scene}");
    assert_eq!((&scene["set"]["v1"], &scene["motion"]), (&json!(90.0), &synthetic("fit", 0.0)["motion"]), "{scene}");
    assert_eq!(service.get(SCENE).expect(200), scene);
    let estimates = until(&mut socket, since + 20);
    for estimate in &estimates {
        let frame = estimate["frame"].as_u64().unwrap();
        assert_eq!(estimate["truth"]["v1"], if frame < since { 150.0 } else { 90.0 }, "{frame} of {since}");
        // The motion is unchanged and does not restart: with `rate_hz` 0 time advances at 60 Hz.
        let turned = std::f64::consts::PI * frame as f64 / 60.0;
        let off = estimate["truth"]["bx"].as_f64().unwrap() - (32.0 + 3.0 * turned.sin());
        assert!(off.abs() < 1e-9, "{estimate}");
        assert_eq!(estimate["dropped"], 0, "{estimate}");
    }
    assert!(estimates.windows(2).all(|pair| pair[1]["frame"].as_u64() == pair[0]["frame"].as_u64().map(|n| n + 1)));
    // All other keys at once.
    let rest = json!({"motion": {"bx": "30 + t*0", "by": "24 + min(t, 0)"}, "exposure": 0.5, "gain": "2 + 0*t", "full_well_e": 5000,
                      "read_noise_e": 15, "light": {"glare": [{"x": 5.0, "y": 5.0, "sigma_px": 3.0, "height": 30.0}], "defocus_px": 0.5}});
    let scene = service.put(SCENE, &rest).expect(200);
    for key in ["motion", "gain", "light"] {
        assert_eq!(scene[key], rest[key], "{key}");
    }
    assert_eq!(scene["set"]["v1"], 90.0, "what is not named is as it was");
    let since = scene["since_frame"].as_u64().unwrap();
    let last = until(&mut socket, since + 1).pop().unwrap();
    assert_eq!((last["truth"]["bx"].as_f64(), last["truth"]["v1"].as_f64()), (Some(30.0), Some(90.0)));
    // The view of the source shows the scene in force.
    let view = service.get("/v1/sources/stage").expect(200);
    assert_eq!((&view["light"], &view["gain"]), (&rest["light"], &rest["gain"]), "{view}");
    service.stop();
}

#[test]
fn newest_scenes_win_and_frames_never_go_back() {
    let service = Running::start();
    service.put("/v1/sources/stage", &synthetic("realtime", 50.0)).expect(201);
    // Without sessions the first frame has it.
    assert_eq!(service.put(SCENE, &json!({"exposure": 0.9})).expect(200)["since_frame"], 0);
    service.put("/v1/sessions/one", &json!({"source": "stage", "model": "spot"})).expect(201);
    let mut since = 0;
    for n in 1..=200u32 {
        let scene = service.put(SCENE, &json!({"exposure": f64::from(n) / 200.0})).expect(200);
        assert!(scene["since_frame"].as_u64().unwrap() >= since, "{scene} after {since}");
        since = scene["since_frame"].as_u64().unwrap();
    }
    let view = service.wait_for("one", |view| view["last"]["frame"].as_u64() >= Some(since));
    assert_eq!(view["last"]["truth"]["v1"], 150.0, "the last of all that were put");
    service.stop();
}

#[test]
fn wrong_scenes_are_rejected_and_change_nothing() {
    let service = Running::start();
    let mut socket = staged(&service);
    let before = service.get(SCENE).expect(200);
    let wrong = [
        (json!({"width": 320}), "width", "unknown field"),
        (json!({"model": "gaussian"}), "model", "unknown field"),
        (json!({"light": {"glare": [{"sigma": 3, "height": 1}]}}), "light.glare[0].sigma", "unknown field"),
        (json!({"motion": {"bx": "32 + "}}), "motion.bx", "formula"),
        (json!({"motion": {"bz": "32"}}), "motion.bz", "no parameter named"),
        (json!({"set": {"bq": 1}}), "set.bq", "no parameter or constant named"),
        (json!({"exposure": -1}), "exposure", "must be positive"),
        (json!({"exposure": 2, "gain": "x"}), "gain", "formula of t"),
        (json!({"read_noise_e": -3}), "read_noise_e", "0 or positive"),
        (json!({"row_noise_e": -3}), "row_noise_e", "0 or positive"),
        (json!({"light": {"blind": [{"x": 1, "soft_px": "sqrt("}]}}), "light.blind[0].soft_px", "formula"),
        (json!({"motion": {"bx": "sqrt(-1 - t)"}}), "", "next frame"),
        (json!({"light": {"defocus_px": "-1 - t"}}), "", "next frame"),
    ];
    for (document, key, words) in wrong {
        let problem = service.put(SCENE, &document).expect(422);
        assert_eq!(problem["diagnostics"][0]["key"], key, "{document}: {problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{document}: {problem}");
        assert_eq!(service.get(SCENE).expect(200), before, "{document}");
    }
    let frame = socket.next().unwrap()["frame"].as_u64().unwrap();
    assert_eq!(until(&mut socket, frame + 5).pop().unwrap()["truth"]["v1"], 150.0);

    service.put("/v1/sources/pushed", &json!({"kind": "pushed", "width": 64, "height": 48})).expect(201);
    for method in ["GET", "PUT"] {
        let ask = |path: &str| service.request(method, path, &[("content-type", "application/json")], b"{}");
        let problem = ask("/v1/sources/pushed/scene").expect(409);
        assert!(problem["detail"].as_str().unwrap().contains("pushed source has no scene"), "{problem}");
        ask("/v1/sources/absent/scene").expect(404);
    }
    service.stop();
}

#[test]
fn restarts_use_the_declared_scene() {
    let folder = Folder::new("scenes-kept");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/sources/stage", &synthetic("fit", 0.0)).expect(201);
    service.put(SCENE, &json!({"gain": 2.0})).expect(200);
    assert_eq!(service.get("/v1/sources/stage").expect(200)["gain"], 2.0);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    let begin = std::time::Instant::now();
    // Sources open after the service has begun to answer.
    while service.get(SCENE).status == 409 {
        assert!(begin.elapsed() < crate::client::DEADLINE);
        std::thread::yield_now();
    }
    assert_eq!(service.get(SCENE).expect(200)["gain"], 1.0);
    service.stop();
}

#[test]
fn the_demo_has_a_scene_and_playback_under_its_name() {
    let service = Running::start_with(None, true);
    let scene = service.put("/v1/sources/demo/scene", &json!({"light": {"defocus_px": 2.0}})).expect(200);
    let since = scene["since_frame"].as_u64().unwrap();
    service.wait_for("demo", |view| view["last"]["frame"].as_u64() >= Some(since));
    assert_eq!(service.put("/v1/sources/demo/playback", &json!({"paused": true})).expect(200)["paused"], true);
    // A session's own source has no name.
    service.put("/v1/sessions/own", &session("fit", 0.0)).expect(201);
    service.get("/v1/sources/own/scene").expect(404);
    service.stop();
}
