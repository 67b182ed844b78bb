//! Estimates: latest, all, credit, WebSocket, server-sent events, NDJSON, and the end of a stream.

use std::io::{BufRead, BufReader};

use serde_json::{Value, json};

use crate::client::{Folder, Running, Socket, session};

/// frame(n+1) − frame(n) = 1 + dropped(n+1)
fn check_dropped(before: &Value, after: &Value) {
    let number = |estimate: &Value, key: &str| estimate[key].as_u64().unwrap();
    assert_eq!(number(after, "frame") - number(before, "frame"), 1 + number(after, "dropped"), "{before}\n{after}");
}

fn take(socket: &mut Socket, count: usize) -> Vec<Value> {
    (0..count).map(|_| socket.next().unwrap()).collect()
}

#[test]
fn every_estimate_in_order() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 500.0)).expect(201);
    let mut socket = service.socket("one", "mode=all");
    let estimates = take(&mut socket, 200);
    assert_eq!(estimates[0]["dropped"], 0);
    for pair in estimates.windows(2) {
        check_dropped(&pair[0], &pair[1]);
        assert_eq!(pair[1]["dropped"], 0);
    }
    let parameters: Vec<&str> = estimates[0]["order"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    assert_eq!(parameters, ["bx", "by", "a1", "a2", "a3", "v0", "v1"]);
    assert_eq!(estimates[9]["covariance"].as_array().unwrap().len(), 7);
}

#[test]
fn without_credit_the_newest_waits_and_the_others_are_counted() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
    let mut socket = service.socket("one", "mode=latest&credit=2");
    let first = take(&mut socket, 2);
    check_dropped(&first[0], &first[1]);
    let later = first[1]["frame"].as_u64().unwrap() + 10;
    service.wait_for("one", |view| view["last"]["frame"].as_u64().unwrap() > later);
    socket.send("{\"credit\":1}");
    let next = socket.next().unwrap();
    check_dropped(&first[1], &next);
    assert!(next["dropped"].as_u64().unwrap() >= 10, "{next}");
}

#[test]
fn in_mode_all_credit_delays_and_loses_nothing() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 500.0)).expect(201);
    let mut socket = service.socket("one", "mode=all&credit=1");
    let first = socket.next().unwrap();
    let later = first["frame"].as_u64().unwrap() + 50;
    service.wait_for("one", |view| view["last"]["frame"].as_u64().unwrap() > later);
    socket.send("{\"credit\":40}");
    let mut before = first;
    for estimate in take(&mut socket, 40) {
        assert_eq!(estimate["dropped"], 0);
        check_dropped(&before, &estimate);
        before = estimate;
    }
}

/// The steps of the fits are for those who ask, and are not there when nobody does.
#[test]
fn steps_for_those_who_ask() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let (mut plain, mut asking) = (service.socket("one", "mode=all"), service.socket("one", "mode=all&trace=1"));
    let traced = |estimate: &Value| estimate.get("trace").is_some();
    // The fit that was under way when it was asked for has none.
    let with = take(&mut asking, 5).pop().unwrap();
    let trace = with["trace"].as_array().unwrap();
    assert!((1..=256).contains(&trace.len()) && trace[0]["stage"] == 0 && trace[0]["pass"] == 0, "{trace:?}");
    assert!(trace.iter().all(|point| point["objective"].is_f64()), "{trace:?}");
    assert!(!take(&mut plain, 20).iter().any(traced));
    assert!(!traced(&service.get("/v1/sessions/one").expect(200)["last"]));
    service.get("/v1/sessions/one/estimates?trace=2").expect(400);
}

#[test]
fn lines_and_events() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    for (accept, media) in [
        ("application/x-ndjson", "application/x-ndjson"),
        ("*/*", "application/x-ndjson"),
        ("text/event-stream", "text/event-stream"),
    ] {
        let url = format!("{}/v1/sessions/one/estimates?mode=all", service.url);
        let mut answer = ureq::get(&url).header("accept", accept).call().unwrap();
        assert_eq!(answer.headers()["content-type"], media);
        let lines = BufReader::new(answer.body_mut().as_reader()).lines().map(Result::unwrap);
        let lines = lines.map(|line| line.trim_start_matches("data: ").to_string());
        let estimates: Vec<Value> = lines
            .filter(|line| line.starts_with('{'))
            .take(20)
            .map(|line| serde_json::from_str(&line).unwrap())
            .collect();
        assert_eq!(estimates.len(), 20);
        estimates.windows(2).for_each(|pair| check_dropped(&pair[0], &pair[1]));
    }
    let status = |query: &str, accept: &str| {
        service.request("GET", &format!("/v1/sessions/one/estimates?{query}"), &[("accept", accept)], b"")
    };
    status("", "image/png").expect(406);
    status("mode=some", "*/*").expect(400);
    status("speed=1", "*/*").expect(400);
    status("credit=-1", "*/*").expect(400);
    service.get("/v1/sessions/nobody/estimates").expect(404);
}

#[test]
fn handshakes_that_are_refused() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    assert_eq!(service.try_socket("nobody", "", "isophote.v1").err(), Some(404));
    assert_eq!(service.try_socket("one", "mode=some", "isophote.v1").err(), Some(400));
    assert_eq!(service.try_socket("one", "", "chat").err(), Some(400));
    assert!(service.try_socket("one", "", "chat, isophote.v1").is_ok());
    let held: Vec<Socket> = (0..32).map_while(|_| service.try_socket("one", "credit=0", "isophote.v1").ok()).collect();
    assert!(held.len() >= 31, "{}", held.len()); // the last one may still be leaving
    assert_eq!(service.try_socket("one", "", "isophote.v1").err(), Some(429));
}

#[test]
fn wrong_messages_end_the_stream() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    for text in ["credit", "{}", "{\"credit\":-1}", "{\"credit\":1,\"mode\":\"all\"}"] {
        let mut socket = service.socket("one", "credit=0");
        socket.send(text);
        assert_eq!(socket.next(), Err(1008), "{text}");
    }
}

#[test]
fn how_a_stream_ends() {
    let folder = Folder::new("ends");
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    let end = |socket: &mut Socket| loop {
        if let Err(code) = socket.next() {
            return code;
        }
    };
    let mut socket = service.socket("one", "");
    service.delete("/v1/sessions/one");
    assert_eq!(end(&mut socket), 1000, "stopped");

    let pixels: Vec<u8> = (0..64 * 48).map(|i| (i % 251) as u8).collect();
    let png = isophote_capture::encode_png(64, 48, isophote_jit::PixelFormat::U8, &pixels).unwrap();
    std::fs::write(folder.0.join("0.png"), png).unwrap();
    let source = json!({"kind": "recording", "path": folder.0});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["state"] == "stopped");
    let mut socket = service.socket("one", "");
    assert_eq!(socket.next().unwrap()["frame"], 0, "the last estimate is still there");
    assert_eq!(end(&mut socket), 1000, "the recording has ended");

    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(200);
    let (mut open, mut waiting) = (service.socket("one", ""), service.socket("one", "credit=0"));
    open.next().unwrap();
    let stopping = std::thread::Builder::new().name("stop".into()).spawn(move || service.stop()).unwrap();
    assert_eq!(end(&mut open), 1001, "the service stops");
    assert_eq!(end(&mut waiting), 1001, "the service stops");
    stopping.join().unwrap();
}
