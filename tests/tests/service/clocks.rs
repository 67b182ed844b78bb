//! Every source has its own clock, and velocities are per second of it, whatever the playback speed.

use isophote_jit::PixelFormat;
use serde_json::{Value, json};

use crate::client::{Folder, Running, picture};

/// Number of frames of a moving spot, and their interval.
const FRAMES: u32 = 24;
const PERIOD_S: f64 = 0.05;
/// px/s.
const VELOCITY: [f64; 2] = [16.0, 7.0];
/// Tolerance of the velocity; a wrong clock would be off by a third or more.
const VELOCITY_PX_S: f64 = 1.5;

fn frame(number: u32) -> Vec<u8> {
    let t = f64::from(number) * PERIOD_S;
    picture(64, 48, (22.0 + VELOCITY[0] * t, 20.0 + VELOCITY[1] * t))
}

fn png(number: u32) -> Vec<u8> {
    isophote_capture::encode_png(64, 48, PixelFormat::U8, &frame(number)).unwrap()
}

fn session(source: Value) -> Value {
    json!({"source": source, "model": "spot", "options": {"predict": {"horizon_s": 0.1, "steps": 1}}})
}

fn velocity(estimate: &Value) -> [f64; 2] {
    let velocity = &estimate["predict"][0]["velocity"];
    [0, 1].map(|axis| velocity[axis].as_f64().unwrap_or_else(|| panic!("it moves: {estimate}")))
}

fn check(name: &str, estimate: &Value) {
    let frame = estimate["frame"].as_u64().unwrap();
    let time_s = estimate["time_s"].as_f64().unwrap_or_else(|| panic!("{name} has a clock: {estimate}"));
    assert!((time_s - frame as f64 * PERIOD_S).abs() < 1e-9, "{name}: frame {frame} at {time_s} s");
    let velocity = velocity(estimate);
    let is_right = (0..2).all(|axis| (velocity[axis] - VELOCITY[axis]).abs() < VELOCITY_PX_S);
    assert!(is_right, "{name}: {velocity:?} px/s, it is {VELOCITY:?}");
}

/// Fits a recording to its end; returns its last estimate.
fn last(service: &Running, source: Value) -> Value {
    service.request("DELETE", "/v1/sessions/one", &[], b"");
    let mut document = session(source);
    document["model"] = json!("plain-spot");
    service.put("/v1/sessions/one", &document).expect(201);
    service.wait_for("one", |view| view["state"] == "stopped")["last"].clone()
}

#[test]
fn velocities_use_the_time_of_the_recording() {
    let folder = Folder::new("clocks");
    let mut truth = String::new();
    let mut video = b"YUV4MPEG2 W64 H48 F20:1 Cmono\n".to_vec();
    let names = ["told", "silent"].map(|name| folder.0.join(name));
    names.iter().for_each(|name| std::fs::create_dir_all(name).unwrap());
    for number in 0..FRAMES {
        let file = format!("{number}.png");
        names.iter().for_each(|name| std::fs::write(name.join(&file), png(number)).unwrap());
        let t = f64::from(number) * PERIOD_S;
        truth += &format!("{}\n", json!({"frame": number, "file": file, "t": t, "parameters": {}}));
        video.extend_from_slice(b"FRAME\n");
        video.extend_from_slice(&frame(number));
    }
    std::fs::write(names[0].join("truth.jsonl"), truth).unwrap();
    std::fs::write(folder.0.join("run.y4m"), video).unwrap();
    let service = Running::start();
    // The kernels for `quadrature = "auto"` are compiled beside the fits: the frame from which on they are ready
    // varies.
    let spot = std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap();
    let plain = spot.replace("quadrature = \"auto\"", "quadrature = 2");
    assert_ne!(plain, spot);
    service.put_text("/v1/models/plain-spot", "application/toml", &plain).expect(201);
    let of = |name: &str, rate_hz: f64, pace: &str| json!({"kind": "recording", "path": folder.0.join(name), "rate_hz": rate_hz, "pace": pace});
    for name in ["told", "run.y4m"] {
        let mut first = None;
        for (rate_hz, pace) in [(0.0, "fit"), (100.0, "fit"), (20.0, "realtime"), (50.0, "realtime")] {
            let estimate = last(&service, of(name, rate_hz, pace));
            check(&format!("{name} at {rate_hz} Hz, pace {pace}"), &estimate);
            // Without lost frames the result is bit-identical.
            let velocity = velocity(&estimate);
            let first = *first.get_or_insert(velocity);
            assert!(pace == "realtime" || velocity == first, "{name} at {rate_hz} Hz: {velocity:?}, before {first:?}");
        }
    }
    // Pictures without time stamps were taken at the source's rate.
    check("pictures at 20 Hz, pace fit", &last(&service, of("silent", 20.0, "fit")));
    // If that is unknown too, the time is absent.
    let estimate = last(&service, of("silent", 0.0, "fit"));
    assert_eq!((estimate.get("time_s"), estimate["state"].as_str()), (None, Some("tracking")), "{estimate}");
}

#[test]
fn synthetic_sources_use_the_clock_of_their_motion() {
    let service = Running::start();
    let [x, y] = VELOCITY;
    // Pace `fit` runs arbitrarily far: a target that turned back would be elsewhere.
    let motion = json!({"bx": format!("22 + {x}*min(t, 2)"), "by": format!("20 + {y}*min(t, 2)")});
    for (pace, rate_hz) in [("fit", 0.0), ("fit", 60.0), ("realtime", 60.0)] {
        let source = json!({"kind": "synthetic", "model": "spot", "width": 64, "height": 48, "samples": 1, "rate_hz": rate_hz,
                            "pace": pace, "motion": motion, "set": {"a1": 0.01, "a2": 0, "a3": 0.015625, "v0": 20, "v1": 150}});
        service.request("DELETE", "/v1/sessions/one", &[], b"");
        let document = session(source);
        service.put("/v1/sessions/one", &document).expect(201);
        let mut socket = service.socket("one", "mode=all");
        // Some frame of the first 2 s, after the start of the track.
        let found = std::iter::from_fn(|| socket.next().ok()).find(|estimate| estimate["frame"].as_u64() >= Some(30));
        let estimate = found.unwrap();
        let (frame, time_s) = (estimate["frame"].as_u64().unwrap(), estimate["time_s"].as_f64().unwrap());
        assert!((time_s - frame as f64 / 60.0).abs() < 1e-9, "pace {pace}: frame {frame} at {time_s} s");
        if time_s < 1.9 {
            let velocity = velocity(&estimate);
            assert!((0..2).all(|axis| (velocity[axis] - VELOCITY[axis]).abs() < VELOCITY_PX_S), "{velocity:?}");
        }
    }
}

#[test]
fn pushed_frames_carry_the_times_of_their_client() {
    let service = Running::start();
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    let media = [("content-type", "application/octet-stream")];
    service.put("/v1/sessions/one", &session(source.clone())).expect(201);
    let mut estimate = Value::Null;
    for number in 0..FRAMES {
        let path = format!("/v1/sessions/one/frames?time_s={}", f64::from(number) * PERIOD_S);
        estimate = service.request("POST", &path, &media, &frame(number)).expect(200);
    }
    check("POST", &estimate);
    for (query, words) in [
        ("time_s=soon", "invalid"),
        ("time_s=inf", "finite"),
        ("time_s=1e300", "finite number of seconds from"),
        ("time=1", "unknown field"),
    ] {
        let answer =
            service.request("POST", &format!("/v1/sessions/one/frames?{query}"), &media, &frame(0)).expect(400);
        assert!(answer["detail"].as_str().unwrap().contains(words), "{answer}");
    }
    let estimate = service.request("POST", "/v1/sessions/one/frames", &media, &frame(FRAMES)).expect(200);
    assert!(estimate.get("time_s").is_none(), "it is not known: {estimate}");

    service.put("/v1/sessions/one", &session(source)).expect(200);
    let mut socket = service.frames_socket("one").unwrap();
    for number in 0..FRAMES {
        socket.send(&json!({"time_s": f64::from(number) * PERIOD_S}).to_string());
        socket.send_bytes(&frame(number));
        estimate_of(&mut socket, number);
    }
    // A time applies to one frame.
    socket.send_bytes(&frame(FRAMES));
    assert!(socket.next().unwrap().get("time_s").is_none());
    socket.send("{\"time_s\": \"soon\"}");
    assert_eq!(socket.next().unwrap_err(), 1008);
}

fn estimate_of(socket: &mut crate::client::Socket, number: u32) {
    let estimate = socket.next().unwrap();
    if number + 1 == FRAMES {
        check("a socket", &estimate);
    }
}

/// Columns are found by name, whoever made the source and whatever the table holds.
#[test]
fn columns_of_a_table_are_found_by_name() {
    let folder = Folder::new("columns");
    let path = folder.0.join("curve.csv");
    let document = "name = \"line\"\ncoordinates = [\"i\"]\nchannels = [\"x\", \"y\"]\n[parameters]\na = { start = 1.0 }\nb = { start = 1.0 }\n\
                    [model]\nobserved = \"y\"\nintensity = \"a + b*x\"\n[[stages]]\nparameters = [\"a\", \"b\"]\n";
    let service = Running::start();
    service.put_text("/v1/models/line", "application/toml", document).expect(201);
    let rows = |header: &str, row: &dyn Fn(f64) -> String| {
        (0..9).fold(format!("{header}\n"), |text, i| text + &row(f64::from(i)) + "\n")
    };
    // y = 3 + 2 x
    let y = |x: f64| 3.0 + 2.0 * x;
    for (header, row) in [
        ("x,y", &(|x: f64| format!("{x},{}", y(x))) as &dyn Fn(f64) -> String),
        ("y,x", &|x: f64| format!("{},{x}", y(x))),
        ("t,y,x", &|x: f64| format!("7,{},{x}", y(x))),
    ] {
        std::fs::write(&path, rows(header, row)).unwrap();
        let source = json!({"kind": "recording", "path": path, "rate_hz": 0, "pace": "fit"});
        for source in [json!("table"), source.clone()] {
            service.put("/v1/sources/table", &json!({"kind": "recording", "path": path, "rate_hz": 0, "pace": "fit"}));
            service.put("/v1/sessions/one", &json!({"source": source, "model": "line"})).expect(201);
            let view = service.wait_for("one", |view| view["state"] == "stopped");
            let found = ["a", "b"].map(|name| view["last"]["parameters"][name].as_f64().unwrap_or(f64::NAN));
            assert!((found[0] - 3.0).abs() < 1e-3 && (found[1] - 2.0).abs() < 1e-3, "{header}: {found:?} {view}");
            service.delete("/v1/sessions/one").expect(204);
            service.delete("/v1/sources/table").expect(204);
        }
    }
    std::fs::write(&path, rows("x,z", &|x| format!("{x},{}", y(x)))).unwrap();
    service.put("/v1/sources/table", &json!({"kind": "recording", "path": path})).expect(201);
    let answer = service.put("/v1/sessions/one", &json!({"source": "table", "model": "line"})).expect(422);
    let message = answer["diagnostics"][0]["message"].as_str().unwrap();
    assert!(message.contains("none of the 2 columns is named `y`, which the model `line` reads"), "{answer}");
}

/// A gain below 1 lowers the saturation limit, unannounced: sessions detect it, as `fit` does.
#[test]
fn sessions_find_where_a_camera_clips() {
    let service = Running::start();
    let source = json!({"kind": "synthetic", "model": "spot", "width": 160, "height": 120, "samples": 2, "rate_hz": 0, "pace": "fit",
                        "saturation": 253, "gain": 0.9, "full_well_e": 5000, "read_noise_e": 15,
                        "set": {"bx": 80, "by": 60, "a1": 0.0011, "a2": 0, "a3": 0.0016, "v0": 30, "v1": 400}});
    let put = service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    assert!(put["camera"].get("saturation").is_none_or(Value::is_null), "{put}");
    let view = service.wait_for("one", |view| view["frames"].as_u64() > Some(3));
    let (last, share) = (&view["last"], view["last"]["saturated"].as_f64().unwrap());
    assert!(last["state"] == "tracking" && share > 0.2, "{share}: {last}");
    // Clipped pixels are left out: the brightness is the true one, not that of a flat top.
    let brightness = last["parameters"]["v1"].as_f64().unwrap();
    assert!((brightness - 360.0).abs() < 36.0, "{brightness}");
}
