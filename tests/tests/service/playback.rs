//! Playback: recordings are paused, resumed, sought and sped up, while frame numbers keep growing.

use serde_json::{Value, json};

use crate::client::{Folder, Running, Socket, synthetic};
use crate::paths::png;

const PLAYBACK: &str = "/v1/sources/film/playback";

/// Ten pictures of a spot that moves 1 px per frame, as a source paused before its first frame, and a session on it.
fn film(service: &Running, name: &str) -> (Folder, Socket) {
    let folder = Folder::new(name);
    for n in 0..10 {
        png(&folder.0.join(format!("{n}.png")), 20.0 + f64::from(n));
    }
    let source = json!({"kind": "recording", "path": folder.0, "rate_hz": 200, "pace": "fit"});
    service.put("/v1/sources/film", &source).expect(201);
    let view = service.put(PLAYBACK, &json!({"paused": true})).expect(200);
    assert_eq!(view, json!({"paused": true, "length": 10, "speed": 1.0, "loop": false, "next_frame": 0}));
    service.put("/v1/sessions/one", &json!({"source": "film", "model": "spot"})).expect(201);
    (folder, service.socket("one", "mode=all"))
}

/// Frame number and file of the next estimate.
fn shown(socket: &mut Socket) -> (u64, String) {
    let estimate = socket.next().unwrap();
    assert_eq!(estimate["state"], "tracking", "{estimate}");
    let (frame, file) = (estimate["frame"].as_u64().unwrap(), estimate["file"].as_str().unwrap().to_string());
    // Skipped frames take no time.
    assert!((estimate["time_s"].as_f64().unwrap() - frame as f64 / 200.0).abs() < 1e-9, "{estimate}");
    let x: f64 = file.trim_end_matches(".png").parse().unwrap();
    assert!((estimate["parameters"]["bx"].as_f64().unwrap() - 20.0 - x).abs() < 0.05, "{estimate}");
    (frame, file)
}

#[test]
fn seeks_show_each_frame_once_and_numbers_grow() {
    let service = Running::start();
    let (_folder, mut socket) = film(&service, "playback-steps");
    let put = |document: Value| service.put(PLAYBACK, &document).expect(200);
    assert_eq!(put(json!({"frame": 0}))["paused"], true);
    assert_eq!(shown(&mut socket), (0, "0.png".into()));
    // A repeated request steps once.
    for _ in 0..3 {
        assert_eq!(put(json!({"paused": true, "frame": 1}))["frame"], 1);
        service.wait_for("one", |view| view["frames"] == 2);
    }
    assert_eq!(shown(&mut socket), (1, "1.png".into()));
    let view = service.wait_for("one", |view| view["frames"] == 2);
    assert_eq!((&view["state"], &view["reason"]), (&json!("running"), &json!("the source is paused")), "{view}");
    // Forward and back: positions jump, numbers do not, and the target is found where it is.
    let view = put(json!({"frame": 8}));
    assert_eq!((&view["frame"], &view["next_frame"]), (&json!(8), &json!(2)), "{view}");
    assert_eq!(shown(&mut socket), (2, "8.png".into()));
    put(json!({"frame": 3}));
    assert_eq!(shown(&mut socket), (3, "3.png".into()));
    put(json!({"frame": 1}));
    assert_eq!(shown(&mut socket), (4, "1.png".into()));
    put(json!({"frame": 2}));
    assert_eq!(shown(&mut socket), (5, "2.png".into()));
    let view = service.get("/v1/sources/film").expect(200);
    assert_eq!((&view["position"], &view["playback"]["next_frame"]), (&json!(2), &json!(6)), "{view}");
    // Plays on to its end.
    put(json!({"paused": false, "frame": 7, "loop": false, "speed": 16}));
    for (frame, file) in [(6, "7.png"), (7, "8.png"), (8, "9.png")] {
        assert_eq!(shown(&mut socket), (frame, file.into()));
    }
    service.wait_for("one", |view| view["state"] == "stopped");
    let problem = service.put(PLAYBACK, &json!({"frame": 0})).expect(409);
    assert!(problem["detail"].as_str().unwrap().contains("has ended"), "{problem}");
    service.stop();
}

/// Requests during playback take effect at once, and no frame arrives while paused.
#[test]
fn a_recording_that_plays_is_paused_and_sought() {
    let service = Running::start();
    let (_folder, mut socket) = film(&service, "playback-plays");
    let put = |document: Value| service.put(PLAYBACK, &document).expect(200);
    assert_eq!(service.get("/v1/sources/film").expect(200)["loop"], false);
    put(json!({"paused": false, "loop": true, "speed": 0.5}));
    assert_eq!(service.get("/v1/sources/film").expect(200)["loop"], true);
    let mut last = shown(&mut socket).0;
    for place in [5, 0, 9, 2] {
        put(json!({"frame": place}));
        // Frames already in flight come first.
        loop {
            let (frame, file) = shown(&mut socket);
            assert!(frame > last, "{frame} after {last}");
            last = frame;
            if file == format!("{place}.png") {
                break;
            }
        }
    }
    let paused = put(json!({"paused": true}));
    let number = paused["next_frame"].as_u64().unwrap();
    service.wait_for("one", |view| view["last"]["frame"].as_u64() == Some(number - 1));
    for _ in 0..20 {
        assert_eq!(service.get(PLAYBACK).expect(200), paused);
    }
    assert_eq!(service.get("/v1/sources/film").expect(200)["frames"].as_u64(), Some(number));
    put(json!({"paused": false}));
    service.wait_for("one", |view| view["last"]["frame"].as_u64() > Some(number));
    service.stop();
}

#[test]
fn paused_synthetic_sources_show_a_new_scene_at_the_next_frame() {
    let service = Running::start();
    service.put("/v1/sources/film", &synthetic("realtime", 100.0)).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "film", "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["frames"].as_u64() > Some(3));
    let paused = service.put(PLAYBACK, &json!({"paused": true, "speed": 2})).expect(200);
    let number = paused["next_frame"].as_u64().unwrap();
    assert_eq!(paused, json!({"paused": true, "frame": number - 1, "speed": 2.0, "next_frame": number}));
    service.wait_for("one", |view| view["last"]["frame"].as_u64() == Some(number - 1));
    // A frame rendered ahead is rendered again.
    let scene = loop {
        let scene = service.put("/v1/sources/film/scene", &json!({"exposure": 0.5})).expect(200);
        if scene["since_frame"].as_u64() <= Some(number) {
            break scene;
        }
    };
    assert_eq!(scene["since_frame"].as_u64(), Some(number), "{scene}");
    let view = service.wait_for("one", |view| {
        service.put(PLAYBACK, &json!({"frame": number})).expect(200);
        view["last"]["frame"].as_u64() == Some(number)
    });
    assert_eq!(service.get(PLAYBACK).expect(200)["next_frame"].as_u64(), Some(number + 1), "it has stepped once");
    assert_eq!(view["last"]["truth"]["v1"], 75.0, "{view}");
    let time_s = view["last"]["time_s"].as_f64().unwrap();
    assert!((time_s - number as f64 / 100.0).abs() < 1e-9, "the time of the scene goes on by frames: {view}");
    // At twice the speed fits have half the time.
    assert_eq!(view["frame_budget_ms"], 5.0, "{view}");
    for wrong in [json!({"frame": 0}), json!({"loop": true}), json!({"paused": false, "frame": number + 9})] {
        let problem = service.put(PLAYBACK, &wrong).expect(409);
        assert!(problem["detail"].as_str().unwrap().contains("synthetic"), "{problem}");
    }
    service.stop();
}

#[test]
fn invalid_playback_requests_are_rejected() {
    let service = Running::start();
    let (_folder, _socket) = film(&service, "playback-wrong");
    let wrong = [
        (json!({"frame": 10}), "frame", "10 frames, 0 to 9"),
        (json!({"step": 1}), "step", "unknown field"),
        (json!({"speed": 0}), "speed", "0.05 to 16"),
        (json!({"frame": -1}), "frame", "invalid value"),
        (json!({"positoin": 1}), "positoin", "unknown field"),
    ];
    let before = service.get(PLAYBACK).expect(200);
    for (document, key, words) in wrong {
        let problem = service.put(PLAYBACK, &document).expect(422);
        assert_eq!(problem["diagnostics"][0]["key"], key, "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{problem}");
        assert_eq!(service.get(PLAYBACK).expect(200), before);
    }
    service.put("/v1/sources/pushed", &json!({"kind": "pushed", "width": 64, "height": 48})).expect(201);
    for (path, status) in [("/v1/sources/pushed/playback", 409), ("/v1/sources/absent/playback", 404)] {
        service.get(path).expect(status);
        service.put(path, &json!({"paused": true})).expect(status);
    }
    service.stop();
}
