//! Clients that stall, fill or flood the service, and nonsensical numbers: each is bounded and gets an error.

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::time::{Duration, Instant};

use isophote_tests::{Service, program, repository};
use serde_json::{Value, json};

use crate::client::{DEADLINE, Running, session, synthetic};

/// Sends a request whose answer is never read, or whose body never ends.
fn begun(service: &Running, request: &str) -> TcpStream {
    let mut stream = TcpStream::connect(&service.address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

fn status(stream: &mut TcpStream) -> String {
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap_or_else(|error| panic!("{error} after {answer:?}"));
    answer.split(' ').nth(1).unwrap_or_default().to_string()
}

#[test]
fn stalled_readers_are_disconnected() {
    let service = Running::start();
    let mut document = session("fit", 500.0);
    document["options"] = json!({"predict": {"horizon_s": 1, "steps": 256}});
    service.put("/v1/sessions/one", &document).expect(201);
    service.put("/v1/sessions/witness", &session("realtime", 30.0)).expect(201);
    for accept in ["application/x-ndjson", "text/event-stream"] {
        let request =
            format!("GET /v1/sessions/one/estimates?mode=all HTTP/1.1\r\nHost: localhost\r\nAccept: {accept}\r\n\r\n");
        let stalled: Vec<TcpStream> = (0..16).map(|_| begun(&service, &request)).collect();
        let sockets: Vec<_> =
            (0..16).map_while(|_| service.try_socket("one", "mode=all", "isophote.v1").ok()).collect();
        // All subscriptions are taken; stalled ones do not hold up the session, and are released.
        let begin = Instant::now();
        let frames = service.get("/v1/sessions/one").expect(200)["frames"].as_u64().unwrap();
        while service.try_socket("one", "", "isophote.v1").is_err() {
            assert!(begin.elapsed() < DEADLINE / 2, "{accept}");
            service.get("/livez").expect(200);
        }
        service.wait_for("one", |view| view["frames"].as_u64() > Some(frames + 100));
        drop((stalled, sockets));
    }
    let witness = service.get("/v1/sessions/witness").expect(200);
    assert_eq!(witness["state"], "running", "{witness}");
}

/// Idle connections reach the limit; further ones are refused, and health is still answered.
#[test]
fn connections_over_the_limit_are_refused() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 30.0)).expect(201);
    let limit = isophote_server::limits::LIMITS.sockets;
    // Upgraded connections keep their slots.
    let sockets: Vec<_> = (0..10).map(|_| service.socket("one", "credit=0")).collect();
    let idle = limit - sockets.len();
    let idle: Vec<TcpStream> = (0..idle).map(|_| TcpStream::connect(&service.address).unwrap()).collect();
    let get = |path: &str| format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
    for _ in 0..5 {
        assert_eq!(status(&mut begun(&service, &get("/livez"))), "200");
        assert_eq!(status(&mut begun(&service, &get("/v1/models"))), "503");
        let put = "PUT /v1/models/a HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n";
        let mut sending = begun(&service, put);
        sending.write_all(&[b' '; 100_000]).unwrap();
        assert_eq!(status(&mut sending), "503");
    }
    drop(idle);
    let begin = Instant::now();
    while status(&mut begun(&service, "GET /v1/models HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"))
        != "200"
    {
        assert!(begin.elapsed() < DEADLINE / 2);
    }
    drop(sockets);
}

#[test]
fn bodies_of_frames_are_bounded_by_their_source() {
    let service = Running::start();
    let pushed = |name: &str, side: usize| {
        let source = json!({"kind": "pushed", "width": side, "height": side, "format": "f32"});
        service.put(&format!("/v1/sessions/{name}"), &json!({"source": source, "model": "spot"})).expect(201);
    };
    pushed("small", 64);
    pushed("large", 4000);
    let media = [("content-type", "application/octet-stream")];
    let post = |name: &str, bytes: usize| {
        service.request("POST", &format!("/v1/sessions/{name}/frames"), &media, &vec![0; bytes])
    };
    post("small", 64 * 64 * 4).expect(200);
    post("small", 64 * 64 * 4 + 1).expect(413);
    // Unfinished frames of 64 MB: two take half of the limit of bytes in flight.
    let head = "POST /v1/sessions/large/frames HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/octet-stream\r\n\
                Content-Length: 64000000\r\n\r\n";
    let mut held: Vec<TcpStream> = (0..2).map(|_| begun(&service, head)).collect();
    let begin = Instant::now();
    let problem = loop {
        let answer = post("large", 1000);
        if answer.status == 503 {
            break answer.expect(503);
        }
        assert!(begin.elapsed() < DEADLINE / 2, "{}", answer.text);
        held.push(begun(&service, head)); // this request may have used the space of one of them
    };
    assert_eq!(problem["code"], "full");
    post("small", 64 * 64 * 4).expect(200);
    drop(held);
    let begin = Instant::now();
    while post("large", 1000).status != 422 {
        assert!(begin.elapsed() < DEADLINE / 2);
    }
}

#[test]
fn malformed_websocket_frames_end_with_their_code() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 30.0)).expect(201);
    let source = json!({"kind": "pushed", "width": 8, "height": 8});
    service.put("/v1/sessions/two", &json!({"source": source, "model": "spot"})).expect(201);
    let long = [&[0x81, 0xff, 0, 0, 0, 0, 0, 1, 0, 0, 1, 2, 3, 4][..], &[b'x'; 64]].concat(); // length 65536
    let longer = [&[0x82, 0xff, 0, 0, 0, 0, 1, 0, 0, 0, 1, 2, 3, 4][..], &[b'x'; 64]].concat(); // 16 MiB
    let cases: [(&[u8], u16); 6] = [
        (&[0xf1, 0x80, 1, 2, 3, 4], 1002),             // reserved bits
        (&[0x83, 0x80, 1, 2, 3, 4], 1002),             // an invalid opcode
        (&[0x81, 0x02, b'{', b'}'], 1002),             // not masked
        (&[0x09, 0x80, 1, 2, 3, 4], 1002),             // a fragmented ping
        (&[0x81, 0x82, 0, 0, 0, 0, 0xff, 0xfe], 1007), // invalid UTF-8
        (&longer, 1009),
    ];
    for (bytes, code) in cases {
        for mut socket in [service.socket("one", "credit=0"), service.frames_socket("two").unwrap()] {
            socket.send_raw(bytes);
            assert_eq!(socket.next(), Err(code), "{:?}", &bytes[..2]);
        }
    }
    let mut socket = service.socket("one", "credit=0");
    socket.send_raw(&long);
    assert_eq!(socket.next(), Err(1009));
}

#[test]
fn nonsensical_numbers_are_refused_at_their_key() {
    let service = Running::start();
    let lens = |key: &str, value: Value| {
        let mut lens = json!({"width": 64, "height": 48, "fx": 80, "fy": 80, "cx": 32, "cy": 24});
        lens[key] = value;
        json!({"intrinsics": lens})
    };
    let spot = |position_mm: Value, radius_mm: f64| json!({"spots": [{"name": "lamp", "position_mm": position_mm, "radius_mm": radius_mm}]});
    let mut document = session("realtime", 30.0);
    document["source"] = json!("shared");
    service.put("/v1/sources/shared", &synthetic("realtime", 30.0)).expect(201);
    let cases = [
        ("camera", json!({"saturation": 0}), "camera.saturation"),
        ("camera", json!({"saturation": -5}), "camera.saturation"),
        ("camera", json!({"saturation": 10, "black": 10}), "camera.saturation"),
        ("camera", json!({"electrons_per_dn": 0}), "camera.electrons_per_dn"),
        ("camera", json!({"electrons_per_dn": -1}), "camera.electrons_per_dn"),
        ("camera", json!({"read_noise_e": -1}), "camera.read_noise_e"),
        ("camera", json!({"electrons_per_dn": 20, "row_noise_e": -1}), "camera.row_noise_e"),
        ("camera", json!({"row_noise_e": 40}), "camera.row_noise_e"),
        ("camera", json!({"defects": 1}), "camera.defects"),
        ("camera", json!({"saturation": 1e300}), "camera.saturation"),
        ("camera", json!({"black": -1}), "camera.black"),
        ("camera", json!({"black": 1e300}), "camera.black"),
        ("camera", json!({"electrons_per_dn": 1e300}), "camera.electrons_per_dn"),
        ("camera", json!({"read_noise_e": 1e300}), "camera.read_noise_e"),
        ("camera", json!({"electrons_per_dn": 20, "row_noise_e": 1e300}), "camera.row_noise_e"),
        ("camera", lens("fx", json!(1e300)), "camera.intrinsics"),
        ("camera", lens("cy", json!(-1e300)), "camera.intrinsics"),
        ("start", json!({"bx": 1e300}), "start.bx"),
        ("start", json!({"a1": -1}), "start.a1"),
        ("constants", json!({"gain": 1e300}), "constants.gain"),
        ("constants", json!({"gain": -1}), "constants.gain"),
        ("constants", json!({"read_noise": -1}), "constants.read_noise"),
        ("window", json!({"x": 64, "y": 0, "width": 10, "height": 10}), "window"),
        ("window", json!({"x": 0, "y": 1000, "width": 10, "height": 10}), "window"),
        ("window", json!({"x": 0, "y": 0, "width": 0, "height": 10}), "window"),
        ("options", json!({"predict": {"horizon_s": 1e300, "steps": 10}}), "options.predict.horizon_s"),
        ("options", json!({"predict": {"horizon_s": -1, "steps": 10}}), "options.predict.horizon_s"),
        ("options", json!({"predict": {"horizon_s": 1, "steps": 0}}), "options.predict.steps"),
        ("options", json!({"motion": {"coast_s": 1e300}}), "options.motion.coast_s"),
        ("options", json!({"motion": {"coast_s": -1}}), "options.motion.coast_s"),
        ("options", json!({"motion": {"acceleration_px_s2": 1e300}}), "options.motion.acceleration_px_s2"),
        ("options", json!({"motion": {"acceleration_px_s2": 0}}), "options.motion.acceleration_px_s2"),
        ("target", spot(json!([0, 0, 1e300]), 3.0), "target"),
        ("target", spot(json!([0, 0, 0]), 1e300), "target"),
    ];
    for (key, value, at) in cases {
        let mut wrong = document.clone();
        wrong[key] = value;
        let answer = service.put("/v1/sessions/one", &wrong).expect(422);
        assert_eq!(answer["diagnostics"][0]["key"], at, "{wrong}: {answer}");
        assert!(answer["detail"].as_str().unwrap().len() < 200, "{answer}");
    }
    document["camera"] = json!({"saturation": 0.5, "black": 0, "electrons_per_dn": 1, "read_noise_e": 0});
    document["window"] = json!({"x": 0, "y": 0, "width": 1000, "height": 1000}); // clipped, as usual
    document["options"] = json!({"predict": {"horizon_s": 3600, "steps": 1}});
    service.put("/v1/sessions/one", &document).expect(201);
    let cases = [
        ("gain", json!(-1), "gain"),
        ("gain", json!(0), "gain"),
        ("gain", json!(1e300), "gain"),
        ("saturation", json!(0), "saturation"),
        ("saturation", json!(1e300), "saturation"),
        ("exposure", json!(-1), "exposure"),
        ("exposure", json!(1e300), "exposure"),
        ("full_well_e", json!(1e300), "full_well_e"),
        ("read_noise_e", json!(1e300), "read_noise_e"),
        ("row_noise_e", json!(1e300), "row_noise_e"),
        ("rate_hz", json!(1e300), "rate_hz"),
        ("bits", json!(0), "bits"),
        ("samples", json!(1_000_000), "samples"),
        ("exposure_latency", json!(4_000_000_000u32), "exposure_latency"),
        ("set", json!({"v0": 1e300}), "set.v0"),
        ("light", json!({"defocus_px": 1e300}), "light.defocus_px"),
        ("light", json!({"glare": [{"x": 1e300, "sigma_px": 1, "height": 1}]}), "light.glare[0].x"),
        ("light", json!({"occluders": [{"width": 1e300, "value": 1}]}), "light.occluders[0].width"),
        ("light", json!({"occluders": [{"value": 1, "from_s": 1e300}]}), "light.occluders"),
    ];
    for (key, value, at) in cases {
        let mut source = synthetic("realtime", 30.0);
        source[key] = value;
        let answer = service.put("/v1/sources/two", &source).expect(422);
        assert_eq!(answer["diagnostics"][0]["key"], at, "{source}: {answer}");
        assert!(answer["detail"].as_str().unwrap().len() < 200, "{answer}");
        if ["gain", "exposure", "full_well_e", "read_noise_e", "row_noise_e", "set", "light"].contains(&key) {
            let answer = service.put("/v1/sources/shared/scene", &json!({key: source[key]})).expect(422);
            assert_eq!(answer["diagnostics"][0]["key"], at, "{source}: {answer}");
        }
    }
}

/// Bumps that explain nothing in the picture, in f64 over all of it: every fit runs out of time.
fn slow() -> String {
    let mut text = String::from("name = \"slow\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n");
    let (mut intensity, mut all) = (String::from("0"), Vec::new());
    for bump in 0..4 {
        for (name, start) in [("x", 100 + 130 * bump), ("y", 400 - 90 * bump), ("w", 30 + 9 * bump), ("v", 30)] {
            writeln!(text, "{name}{bump} = {{ start = {start} }}").unwrap();
            all.push(format!("\"{name}{bump}\""));
        }
        write!(intensity, " + v{bump} * exp(-((x - x{bump})^2 + (y - y{bump})^2) / w{bump}^2)").unwrap();
    }
    writeln!(text, "[model]\nintensity = \"{intensity}\"").unwrap();
    for stage in 0..8 {
        let free = all[stage % 2..].join(", ");
        writeln!(text, "[[stages]]\nparameters = [{free}]\nmethod = \"newton\"\niterations = 100\ntolerance = 1e-12")
            .unwrap();
    }
    text
}

#[test]
fn the_service_stops_in_time_whatever_runs() {
    let service = Running::start();
    service.put_text("/v1/models/slow", "application/toml", &slow()).expect(201);
    let mut source = synthetic("fit", 30.0); // realtime ones would be refused
    (source["width"], source["height"]) = (json!(640), json!(480));
    source["motion"]["bx"] = json!("320 + 80*sin(2*pi*3*t) + 40*cos(40*t)");
    source["read_noise_e"] = json!(400);
    source["full_well_e"] = json!(5000);
    service.put("/v1/sources/shared", &source).expect(201);
    let document = json!({"source": "shared", "model": "slow", "options": {"precision": "f64"}});
    let name = |i: usize| format!("/v1/sessions/long-{i}");
    for i in 0..64 {
        service.put(&name(i), &document).expect(201);
    }
    // Concurrent deletions end together.
    let begin = Instant::now();
    std::thread::scope(|scope| {
        for i in 0..24 {
            let service = &service;
            scope.spawn(move || service.delete(&name(i)).expect(204));
        }
    });
    let deleted = begin.elapsed();
    let begin = Instant::now();
    service.stop();
    let stopped = begin.elapsed();
    eprintln!("24 deleted in {deleted:?}, 40 stopped in {stopped:?}");
    assert!(deleted < Duration::from_secs(5), "{deleted:?}");
    assert!(stopped < Duration::from_secs(5), "{stopped:?}");
}

fn signal(service: &mut Service) {
    let id = service.child().id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
}

#[test]
fn one_signal_stops_gracefully_and_a_second_at_once() {
    let program = program().unwrap();
    let head =
        "PUT /v1/models/a HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/toml\r\nContent-Length: 9\r\n\r\n";
    for signals in [1, 2] {
        let mut service = Service::start(&program, &["--demo"], &repository()).unwrap();
        let client = Running::at(service.address());
        client.get("/livez").expect(200);
        let unfinished = begun(&client, head); // the service waits a while for it before it stops
        // The service has received it: a later request on another connection is answered.
        client.get("/v1/models").expect(200);
        let begin = Instant::now();
        signal(&mut service);
        // A signal right after the first counts as the same one.
        signal(&mut service);
        while signals == 2 && service.child().try_wait().unwrap().is_none() {
            signal(&mut service);
        }
        let ended = service.child().wait().unwrap();
        eprintln!("{signals}: {ended} after {:?}", begin.elapsed());
        assert_eq!(ended.signal(), None, "it ended by itself");
        // An exit before a second signal can be told from the first is a graceful one.
        let is_cut_short = signals == 2 && begin.elapsed() > Duration::from_millis(200);
        assert_eq!(ended.code(), Some(i32::from(is_cut_short)));
        let most = if signals == 2 { 1500 } else { 5000 };
        assert!(begin.elapsed() < Duration::from_millis(most));
        drop(unfinished);
    }
}

/// The buffer of a subscriber without credit does not grow; dropped estimates are counted.
#[test]
fn subscribers_without_credit_lose_estimates_and_are_notified() {
    let service = Running::start();
    let mut document = session("fit", 0.0);
    document["options"] = json!({"predict": {"horizon_s": 1, "steps": 256}});
    service.put("/v1/sessions/one", &document).expect(201);
    let mut socket = service.socket("one", "mode=all&credit=1");
    let first = socket.next().unwrap();
    let size = first.to_string().len() as u64;
    let frames = 2 * isophote_server::limits::LIMITS.ring_bytes as u64 / size;
    let number = |estimate: &Value, key: &str| estimate[key].as_u64().unwrap();
    service.wait_for("one", |view| number(view, "frames") > number(&first, "frame") + frames);
    socket.send("{\"credit\":2}");
    let (next, after) = (socket.next().unwrap(), socket.next().unwrap());
    assert!(number(&next, "dropped") > frames / 4, "{next}");
    assert_eq!(number(&next, "frame"), number(&first, "frame") + 1 + number(&next, "dropped"));
    // The session goes on meanwhile: later estimates may have been dropped as well.
    assert_eq!(number(&after, "frame"), number(&next, "frame") + 1 + number(&after, "dropped"));
    assert!(number(&after, "dropped") < frames / 4, "{after}");
}

/// Endless heads and missing bodies time out, and other requests are served meanwhile.
#[test]
fn unfinished_heads_and_bodies_time_out() {
    let service = Running::start();
    service.put("/v1/sessions/witness", &session("realtime", 30.0)).expect(201);
    let head = "GET /v1/sessions HTTP/1.1\r\nHost: localhost\r\nX-Slow: ";
    let body = "PUT /v1/models/slow HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/toml\r\nContent-Length: 1000\r\n\r\nname";
    let heads: Vec<TcpStream> = (0..20).map(|_| begun(&service, head)).collect();
    let bodies: Vec<TcpStream> = (0..20).map(|_| begun(&service, body)).collect();
    let frames = service.get("/v1/sessions/witness").expect(200)["frames"].as_u64().unwrap();
    service.wait_for("witness", |view| view["frames"].as_u64() > Some(frames + 30));
    for mut stream in heads {
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("closed before the deadline");
    }
    for mut stream in bodies {
        assert_eq!(status(&mut stream), "400");
    }
    assert_eq!(service.get("/v1/sessions/witness").expect(200)["state"], "running");
}

/// Arbitrary bytes sent as a model get a short answer that names the fault and quotes little.
#[test]
fn invalid_bytes_get_a_short_answer() {
    let service = Running::start();
    let long = "x".repeat(20_000);
    let formula = |formula: &str| {
        let text = format!(
            "name = \"m\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nbx = {{ start = 1.0 }}\n[model]\nintensity = \"{formula}\"\n"
        );
        text.into_bytes()
    };
    let nested = formula(&format!("{}bx{}", "(".repeat(100_000), ")".repeat(100_000)));
    let comment = format!("name = \"m\" # {}", "of great length ".repeat(20_000));
    let cases: [(&str, Vec<u8>); 9] = [
        ("a long line", comment.into_bytes()),
        ("not UTF-8", b"name = \"\xff\xfe\"".to_vec()),
        ("a NUL", b"name = \"a\0b\"".to_vec()),
        ("from right to left", formula("bx \u{202e}+ 1")),
        ("nested", nested),
        ("a long name", formula(&long)),
        ("a long number", formula(&"9".repeat(20_000))),
        ("one key many times", b"a = [1]\n".repeat(5_000)),
        ("brackets", "[".repeat(100_000).into_bytes()),
    ];
    for (what, text) in cases {
        let answer = service.request("PUT", "/v1/models/m", &[("content-type", "application/toml")], &text);
        let problem = answer.expect(422);
        let first = &problem["diagnostics"][0];
        assert!(first["code"].is_string() && first["line"].as_u64() >= Some(1), "{what}: {problem:.500}");
        for text in [&problem["detail"], &first["message"], &first["help"]] {
            let text = text.as_str().unwrap_or_default();
            let line = first["source"].as_str().unwrap_or_default();
            assert!(line.len() <= 1100, "{what}: {} bytes of its line", line.len());
            assert!(text.len() <= 2048 && !text.contains(&long[..100]), "{what}: {} bytes", text.len());
        }
    }
    service.get("/v1/models/m").expect(404);
}
