//! Sources and sessions: life cycle, statuses, pushed frames, recordings.

use isophote_jit::{PixelFormat, Processor, VectorWidth};
use serde_json::json;

use crate::client::{Folder, Running, picture, session, synthetic};

#[test]
fn sessions_report_their_vector_width() {
    for width in VectorWidth::ALL.into_iter().filter(|width| Processor::Host.has(*width)) {
        let service = Running::start_of_width(None, false, width);
        let view = service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
        assert_eq!(view["vector_width"], 8 * width.bytes());
    }
}

#[test]
fn life_cycle() {
    let service = Running::start();
    let put = service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    assert!(["starting", "running"].contains(&put["state"].as_str().unwrap()));
    let view = service.wait_for("one", |view| view["frames"].as_u64().unwrap() > 5);
    assert_eq!(view["state"], "running");
    assert_eq!((&view["requested_model"], &view["active_model"]), (&json!("spot"), &json!("spot")));
    assert_eq!((&view["active_since_frame"], &view["dropped"]), (&json!(0), &json!(0)));
    assert_eq!(view["source"]["kind"], "synthetic");
    assert_eq!(view["options"]["precision"], "f32");
    assert!(view["rate_hz"].as_f64().unwrap() > 0.0);
    let last = &view["last"];
    assert_eq!((&last["session"], &last["state"]), (&json!("one"), &json!("tracking")));
    let error = last["parameters"]["bx"].as_f64().unwrap() - last["truth"]["bx"].as_f64().unwrap();
    assert!(error.abs() < 0.1, "{last}");
    assert!(last["capture_ns"].as_u64().unwrap() <= last["publish_ns"].as_u64().unwrap());

    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(200);
    assert_eq!(service.get("/v1/sessions").expect(200)["items"].as_array().unwrap().len(), 1);
    assert_eq!(service.delete("/v1/sessions/one").status, 204);
    service.get("/v1/sessions/one").expect(404);
    service.delete("/v1/sessions/one").expect(404);
    assert_eq!(service.get("/v1/sessions").expect(200), json!({"items": []}));
}

/// The document printed in the contract, verbatim.
const CONTRACT: &str = r#"
{"source": {"kind": "synthetic", "model": "spot", "set": {"bx": 320, "by": 240}, "motion": {"bx": "320 + 80*sin(2*pi*0.2*t)"}, "width": 640, "height": 480,
            "rate_hz": 60, "pace": "realtime", "bits": 8, "samples": 8, "full_well_e": 5000, "read_noise_e": 15, "saturation": 255, "seed": 1},
 "model": "spot", "constants": {}, "start": {}, "window": null, "camera": {}, "target": {},
 "options": {"precision": "f32", "exposure": {"goal": "centre", "control": false}}}"#;

#[test]
fn the_document_of_the_contract_is_accepted() {
    let service = Running::start();
    service.put_text("/v1/sessions/demo", "application/json", CONTRACT).expect(201);
    let view = service.wait_for("demo", |view| view["last"]["state"] == "tracking");
    let document: serde_json::Value = serde_json::from_str(CONTRACT).unwrap();
    for key in ["model", "constants", "start", "window", "target", "options"] {
        assert_eq!(view[key], document[key], "{key}");
    }
    for key in ["kind", "motion", "width", "pace", "seed"] {
        assert_eq!(view["source"][key], document["source"][key], "{key}");
    }
    let error = view["last"]["parameters"]["bx"].as_f64().unwrap() - view["last"]["truth"]["bx"].as_f64().unwrap();
    assert!(error.abs() < 0.05, "{view}");
}

#[test]
fn a_shared_source() {
    let service = Running::start();
    service.put("/v1/sources/bench", &synthetic("fit", 200.0)).expect(201);
    let idle = service.get("/v1/sources/bench").expect(200);
    assert_eq!((&idle["state"], &idle["frames"]), (&json!("idle"), &json!(0)));
    for (name, model) in [("one", "spot"), ("two", "gaussian")] {
        service.put(&format!("/v1/sessions/{name}"), &json!({"source": "bench", "model": model})).expect(201);
    }
    for name in ["one", "two"] {
        let view = service.wait_for(name, |view| view["frames"].as_u64().unwrap() > 5);
        assert_eq!((&view["dropped"], &view["source"]), (&json!(0), &json!("bench")));
    }
    service.delete("/v1/sources/bench").expect(409);
    service.put("/v1/sources/bench", &synthetic("fit", 100.0)).expect(409);
    for name in ["one", "two"] {
        service.delete(&format!("/v1/sessions/{name}"));
    }
    service.put("/v1/sources/bench", &synthetic("fit", 100.0)).expect(200);
    assert_eq!(service.get("/v1/sources").expect(200)["items"][0]["name"], "bench");
    assert_eq!(service.delete("/v1/sources/bench").status, 204);
    service.delete("/v1/sources/bench").expect(404);
    service.put("/v1/sessions/one", &json!({"source": "bench", "model": "spot"})).expect(404);
}

/// `spot` has one spot without a name.
fn two_spots() -> serde_json::Value {
    let spot = |name: &str| json!({"name": name, "position_mm": [0, 80, 0], "radius_mm": 30});
    json!({"spots": [spot("red"), spot("green")]})
}

/// A session whose lens was calibrated at a size other than its source's.
fn of_other_pictures() -> serde_json::Value {
    let mut document = session("fit", 100.0);
    document["target"] = json!({"spots": [{"name": "lamp", "position_mm": [0, 0, 0], "radius_mm": 30}]});
    document["camera"] = json!({"intrinsics": {"width": 12, "height": 9, "fx": 10, "fy": 10, "cx": 5.5, "cy": 4}});
    document
}

#[test]
fn wrong_documents_name_the_key() {
    let service = Running::start();
    let with = |key: &str, value: serde_json::Value| {
        let mut document = session("fit", 100.0);
        document[key] = value;
        document
    };
    let source = |key: &str, value: serde_json::Value| {
        let mut document = session("fit", 100.0);
        document["source"][key] = value;
        document
    };
    let cases = [
        (with("widnow", json!(null)), "widnow"),
        (with("start", json!({"bz": 1})), "start.bz"),
        (with("constants", json!({"amplification": 1})), "constants.amplification"),
        (with("start", json!({"a1": -1})), "start.a1"),
        (with("window", json!({"x": 0, "y": 0, "width": 0, "height": 5})), "window"),
        (with("target", json!({"name": "t"})), "target"),
        (with("target", two_spots()), "target"),
        (of_other_pictures(), "camera.intrinsics"),
        (with("options", json!({"precision": "f16"})), "options.precision"),
        (with("options", json!({"exposure": {"goal": "beauty"}})), "options.exposure.goal"),
        (with("options", json!({"targets": 0})), "options.targets"),
        (with("options", json!({"confidence_min": 1.5})), "options.confidence_min"),
        (with("options", json!({"motion": {"coast_s": -1}})), "options.motion.coast_s"),
        (with("options", json!({"predict": {"horizon_s": 0.5, "steps": 0}})), "options.predict.steps"),
        (with("camera", json!({"saturatoin": 255})), "camera.saturatoin"),
        (with("camera", json!({"defects": 1})), "camera.defects"),
        (
            with("camera", json!({"defect_map": {"width": 120, "height": 90, "pixels": [[120, 3]]}})),
            "camera.defect_map",
        ),
        (with("camera", json!({"defect_map": {"width": 12, "height": 9, "pixels": [[3, 3]]}})), "camera.defect_map"),
        (with("camera", json!({"defect_map": {"height": 9}})), "camera.defect_map"),
        (with("camera", json!({"response": {"gamma": 0.45}})), "camera.response"),
        (with("camera", json!({"saturation": 255, "response": {"gamma": 0}})), "camera.response"),
        (with("camera", json!({"saturation": 255, "response": {"gamma": "high"}})), "camera.response.gamma"),
        (source("response", json!({"gamma": 20})), "source.response"),
        (source("black", json!(16)), "source.black"),
        (with("constants", json!({"defects": -0.1})), "constants.defects"),
        (with("source", json!({"kind": "recording", "path": "/no/such/folder"})), "source.path"),
        (with("source", json!({"kind": "radio"})), "source.kind"),
        (with("model", json!("profile-1d")), "model"),
        (source("rate_hz", json!(0)), ""),
        (source("rate_hz", json!(-1)), "source.rate_hz"),
        (source("width", json!(0)), "source.width"),
        (source("height", json!(1_000_000)), "source.width"),
        (source("bits", json!(40)), "source.bits"),
        (source("colour", json!("red")), "source.colour"),
        (source("motion", json!({"bx": "320 +"})), "source.motion.bx"),
    ];
    for (document, key) in cases {
        let answer = service.put("/v1/sessions/one", &document);
        if key.is_empty() {
            answer.expect(201);
            service.delete("/v1/sessions/one");
            continue;
        }
        let problem = answer.expect(422);
        let diagnostic = &problem["diagnostics"][0];
        assert_eq!(diagnostic["key"], key, "{problem}");
        assert!(diagnostic["line"].as_u64().unwrap() >= 1 && diagnostic["column"].as_u64().unwrap() >= 1);
        service.get("/v1/sessions/one").expect(404);
    }
    service.put("/v1/sessions/one", &with("model", json!("nobody"))).expect(404);
    service.put("/v1/sessions/one", &source("model", json!("nobody"))).expect(404);
    service.put_text("/v1/sessions/one", "application/json", "{\"source\": ").expect(422);
    service.put_text("/v1/sessions/one", "application/json", "[]").expect(422);
    service.put_text("/v1/sessions/one", "application/toml", "a = 1").expect(415);
    assert_eq!(service.get("/v1/sessions").expect(200), json!({"items": []}));
}

#[test]
fn camera_defects_are_left_out() {
    let service = Running::start();
    let mut document = session("fit", 200.0);
    let side = |name: &str| document["source"][name].as_u64().unwrap_or(if name == "width" { 640 } else { 480 });
    let (width, height) = (side("width"), side("height"));
    let map = json!({"width": width, "height": height, "columns": (0..width).step_by(10).collect::<Vec<u64>>()});
    service.put("/v1/sessions/sound", &document).expect(201);
    document["camera"] = json!({"defect_map": map});
    service.put("/v1/sessions/defective", &document).expect(201);
    let last = |name: &str| service.wait_for(name, |view| view["last"]["state"] == "tracking")["last"].clone();
    assert!(last("sound").get("left_out").is_none());
    let estimate = last("defective");
    let count = |key: &str| estimate[key].as_f64().unwrap();
    let share = count("left_out") / (count("left_out") + count("pixels"));
    assert!((0.05..0.2).contains(&share), "{estimate}");
}

#[test]
fn unsuitable_session_requests_are_rejected() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.get("/v1/sessions/one/preview?format=raw8").expect(400); // no WebSocket
    service.get("/v1/nothing").expect(404);
    service.request("POST", "/v1/sessions/one/frames", &[("content-type", "image/png")], b"x").expect(409);
}

#[test]
fn sessions_are_limited_to_64() {
    let service = Running::start();
    service.put("/v1/sources/idle", &json!({"kind": "pushed", "width": 8, "height": 8})).expect(201);
    let document = json!({"source": "idle", "model": "spot"});
    for number in 0..64 {
        service.put(&format!("/v1/sessions/s{number}"), &document).expect(201);
    }
    service.put("/v1/sessions/s64", &document).expect(429);
    service.put("/v1/sessions/s63", &document).expect(200);
    service.delete("/v1/sessions/s0");
    service.put("/v1/sessions/s64", &document).expect(201);
}

#[test]
fn pushed_frames_are_answered_with_their_estimates() {
    let service = Running::start();
    let source = json!({"kind": "pushed", "width": 64, "height": 48, "format": "u8"});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let post = |media: &str, bytes: &[u8]| {
        service.request("POST", "/v1/sessions/one/frames", &[("content-type", media)], bytes)
    };
    for (frame, centre) in [(30.0, 20.0), (31.25, 20.5), (32.0, 21.0)].into_iter().enumerate() {
        let bytes = picture(64, 48, centre);
        let estimate = if frame == 1 {
            let png = isophote_capture::encode_png(64, 48, PixelFormat::U8, &bytes).unwrap();
            post("image/png", &png).expect(200)
        } else {
            post("application/octet-stream", &bytes).expect(200)
        };
        assert_eq!(estimate["frame"], frame as u64);
        let found = (estimate["parameters"]["bx"].as_f64().unwrap(), estimate["parameters"]["by"].as_f64().unwrap());
        assert!((found.0 - centre.0).abs() < 0.1 && (found.1 - centre.1).abs() < 0.1, "{estimate}");
        assert!(estimate.get("truth").is_none(), "nobody knows the truth of a pushed frame");
    }
    post("application/octet-stream", &[0; 7]).expect(422);
    post("image/png", b"not an image").expect(422);
    post("image/tiff", b"").expect(415);
    let small = isophote_capture::encode_png(8, 6, PixelFormat::U8, &picture(8, 6, (4.0, 3.0))).unwrap();
    post("image/png", &small).expect(422);
    assert_eq!(service.wait_for("one", |_| true)["state"], "running", "no frame, no fault");
}

#[test]
fn a_recording_is_fitted_to_its_end() {
    let folder = Folder::new("recording");
    for frame in 0..5 {
        let png =
            isophote_capture::encode_png(64, 48, PixelFormat::U8, &picture(64, 48, (30.0 + f64::from(frame), 22.0)));
        std::fs::write(folder.0.join(format!("{frame}.png")), png.unwrap()).unwrap();
    }
    let service = Running::start();
    let source = json!({"kind": "recording", "path": folder.0, "rate_hz": 0, "pace": "fit"});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let view = service.wait_for("one", |view| view["state"] == "stopped");
    assert_eq!((&view["frames"], &view["dropped"]), (&json!(5), &json!(0)));
    assert_eq!((&view["last"]["file"], &view["last"]["frame"]), (&json!("4.png"), &json!(4)));
    assert!((view["last"]["parameters"]["bx"].as_f64().unwrap() - 34.0).abs() < 0.1, "{view}");
    assert!(view["reason"].as_str().unwrap().contains("ended"));

    let source = json!({"kind": "recording", "path": folder.0, "rate_hz": 0, "pace": "fit", "loop": true});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(200);
    service.wait_for("one", |view| view["frames"].as_u64().unwrap() > 12);
    std::fs::write(folder.0.join("2.png"), b"torn").unwrap();
    // A damaged file is skipped and counts as a lost frame; without any readable file the recording waits for one.
    service.wait_for("one", |view| view["dropped"].as_u64() > Some(2) && view["state"] == "running");
    let write =
        |bytes: &[u8]| (0..5).for_each(|frame| std::fs::write(folder.0.join(format!("{frame}.png")), bytes).unwrap());
    write(b"torn");
    let view = service.wait_for("one", |view| view["state"] == "stalled");
    assert!(view["reason"].as_str().unwrap().contains(".png"), "{view}");
    write(&isophote_capture::encode_png(64, 48, PixelFormat::U8, &picture(64, 48, (30.0, 22.0))).unwrap());
    let frames = view["frames"].as_u64();
    service.wait_for("one", |view| view["state"] == "running" && view["frames"].as_u64() > frames);
}

/// The only file of a loop is truncated and later restored, in place or by a new file.
#[test]
fn loops_of_one_file_survive_damage() {
    let folder = Folder::new("loop-of-one");
    let png = isophote_capture::encode_png(64, 48, PixelFormat::U8, &picture(64, 48, (30.0, 22.0))).unwrap();
    let header = b"YUV4MPEG2 W64 H48 F30:1 Cmono\nFRAME\n".to_vec();
    let video = [header, picture(64, 48, (30.0, 22.0))].concat();
    let service = Running::start();
    for (name, bytes) in [("one.png", png), ("one.y4m", video)] {
        let path = folder.0.join(name);
        std::fs::write(&path, &bytes).unwrap();
        let source = json!({"kind": "recording", "path": path, "rate_hz": 100, "loop": true});
        service.put("/v1/sources/film", &source).expect(201);
        service.put("/v1/sessions/one", &json!({"source": "film", "model": "spot"})).expect(201);
        service.wait_for("one", |view| view["last"]["state"] == "tracking");
        let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(bytes.len() as u64 / 2).unwrap();
        let view = service.wait_for("one", |view| view["state"] == "stalled");
        assert!(view["reason"].as_str().unwrap().contains(name), "{view}");
        let source = service.get("/v1/sources/film").expect(200);
        assert!(source["state"] == "stalled" && source["unread"].as_u64() > Some(0), "{source}");
        let whole = folder.0.join("whole");
        std::fs::write(&whole, &bytes).unwrap();
        std::fs::rename(&whole, &path).unwrap();
        let frames = view["frames"].as_u64();
        service.wait_for("one", |view| view["state"] == "running" && view["frames"].as_u64() > frames);
        let source = service.get("/v1/sources/film").expect(200);
        assert!(source["state"] == "running" && source["reason"].is_null(), "{source}");
        service.delete("/v1/sessions/one").expect(204);
        service.delete("/v1/sources/film").expect(204);
    }
    service.stop();
}

/// The same frames in one file, as a session's recording.
#[test]
fn a_video_is_fitted_as_a_folder_of_pictures_is() {
    let folder = Folder::new("video");
    let mut video = b"YUV4MPEG2 W64 H48 F30:1 Cmono\n".to_vec();
    for frame in 0..5 {
        video.extend_from_slice(b"FRAME\n");
        video.extend_from_slice(&picture(64, 48, (30.0 + f64::from(frame), 22.0)));
    }
    std::fs::write(folder.0.join("run.y4m"), &video).unwrap();
    let service = Running::start();
    let source = json!({"kind": "recording", "path": folder.0.join("run.y4m"), "rate_hz": 0, "pace": "fit"});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let view = service.wait_for("one", |view| view["state"] == "stopped");
    assert_eq!((&view["frames"], &view["last"]["file"]), (&json!(5), &json!("run.y4m#4")));
    assert!((view["last"]["parameters"]["bx"].as_f64().unwrap() - 34.0).abs() < 0.1, "{view}");
}
