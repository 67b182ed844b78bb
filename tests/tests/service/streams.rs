//! Streams of estimates: latest, all, credit, WebSocket, server-sent events, NDJSON, and their end.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;

use serde_json::{Value, json};

use crate::client::{DEADLINE, Folder, Running, Socket, picture, session};

/// frame(n+1) − frame(n) = 1 + dropped(n+1)
fn check_dropped(before: &Value, after: &Value) {
    let number = |estimate: &Value, key: &str| estimate[key].as_u64().unwrap();
    assert_eq!(number(after, "frame") - number(before, "frame"), 1 + number(after, "dropped"), "{before}\n{after}");
}

fn take(socket: &mut Socket, count: usize) -> Vec<Value> {
    (0..count).map(|_| socket.next().unwrap()).collect()
}

#[test]
fn all_estimates_arrive_in_order() {
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
fn without_credit_the_newest_waits_and_others_are_dropped() {
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
fn in_mode_all_credit_delays_without_losses() {
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

/// Traces are sent to subscribers who ask for them, and only made then.
#[test]
fn traces_are_sent_to_those_who_ask() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let (mut plain, mut asking) = (service.socket("one", "mode=all"), service.socket("one", "mode=all&trace=1"));
    let traced = |estimate: &Value| estimate.get("trace").is_some();
    // The fit in progress at the request has none.
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
        assert_eq!(answer.headers()["cache-control"], "no-store, no-transform");
        assert_eq!(answer.headers()["x-accel-buffering"], "no");
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
fn invalid_handshakes_are_refused() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    assert_eq!(service.try_socket("nobody", "", "isophote.v1").err(), Some(404));
    assert_eq!(service.try_socket("one", "mode=some", "isophote.v1").err(), Some(400));
    assert_eq!(service.try_socket("one", "", "chat").err(), Some(400));
    assert!(service.try_socket("one", "", "chat, isophote.v1").is_ok());
    let held: Vec<Socket> = (0..32).map_while(|_| service.try_socket("one", "credit=0", "isophote.v1").ok()).collect();
    assert!(held.len() >= 31, "{}", held.len()); // the last one may still be closing
    assert_eq!(service.try_socket("one", "", "isophote.v1").err(), Some(429));
}

#[test]
fn wrong_messages_end_the_stream() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    for text in ["credit", "{}", "{\"credit\":-1}", "[1]"] {
        let mut socket = service.socket("one", "credit=0");
        socket.send(text);
        assert_eq!(socket.next(), Err(1008), "{text}");
    }
}

/// Keys of a client newer than the service.
#[test]
fn unknown_keys_of_messages_are_ignored() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    let mut socket = service.socket("one", "credit=0");
    socket.send("{\"credit\":2,\"mode\":\"all\",\"resume\":{\"frame\":7}}");
    take(&mut socket, 2);
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/two", &json!({"source": source, "model": "spot"})).expect(201);
    let mut socket = service.frames_socket("two").unwrap();
    socket.send("{\"time_s\":2.5,\"exposure_us\":100}");
    socket.send_bytes(&picture(64, 48, (30.0, 20.0)));
    assert_eq!(socket.next().unwrap()["time_s"], 2.5);
}

/// A connection with an endless answer, read line by line.
struct Stream(std::io::Lines<BufReader<TcpStream>>);

impl Stream {
    fn open(service: &Running, query: &str, headers: &str) -> Stream {
        let mut stream = TcpStream::connect(&service.address).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        let path = format!("/v1/sessions/one/estimates?{query}");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n\r\n").unwrap();
        Stream(BufReader::new(stream).lines())
    }

    /// The rest of the next line with that prefix.
    fn next(&mut self, prefix: &str) -> String {
        let line = self.0.by_ref().map(Result::unwrap).find(|line| line.starts_with(prefix));
        line.expect("the stream goes on")[prefix.len()..].to_string()
    }

    fn event(&mut self) -> (String, Value) {
        (self.next("id: "), serde_json::from_str(&self.next("data: ")).unwrap())
    }
}

/// A reader that takes one estimate per 20 fitted frames gets new ones, not those buffered in sockets.
#[test]
fn slow_readers_of_latest_get_new_estimates() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
    let frames = || service.get("/v1/sessions/one").expect(200)["last"]["frame"].as_u64().unwrap_or(0);
    service.wait_for("one", |view| view["last"].is_object());
    let mut lines = Stream::open(&service, "mode=latest", "Accept: application/x-ndjson");
    let (mut before, mut behind, mut dropped) = (None::<Value>, Vec::new(), 0);
    for _ in 0..60 {
        let estimate: Value = serde_json::from_str(&format!("{{{}", lines.next("{"))).unwrap();
        let (frame, lost) = (estimate["frame"].as_u64().unwrap(), estimate["dropped"].as_u64().unwrap());
        before.iter().for_each(|before| check_dropped(before, &estimate));
        behind.push(frames().saturating_sub(frame));
        dropped += lost;
        before = Some(estimate);
        let later = frames() + 20;
        service.wait_for("one", |view| view["last"]["frame"].as_u64() >= Some(later));
    }
    // Sockets buffer hundreds: without pacing the reader would lag 760 frames in the median. A window is reported only
    // with acknowledgements, so a slow machine may lag for a while.
    let (_, median, _) = behind.select_nth_unstable(30);
    assert!(*median < 5 * 25, "{behind:?}");
    assert!(dropped > 500, "{dropped} of 1200");
}

#[test]
fn every_n_sends_one_of_n_frames() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 500.0)).expect(201);
    let mut socket = service.socket("one", "mode=all&every=7");
    let mut lines = Stream::open(&service, "mode=all&every=7", "Accept: application/x-ndjson");
    let line = |lines: &mut Stream| serde_json::from_str(&format!("{{{}", lines.next("{"))).unwrap();
    for estimates in [take(&mut socket, 10), (0..10).map(|_| line(&mut lines)).collect()] {
        for pair in estimates.windows(2) {
            check_dropped(&pair[0], &pair[1]);
            assert_eq!(pair[1]["dropped"], 6);
        }
    }
    service.get("/v1/sessions/one/estimates?every=0").expect(400);
}

#[test]
fn event_streams_resume_after_the_last_event() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let events = "Accept: text/event-stream";
    let mut stream = Stream::open(&service, "mode=all", events);
    stream.event();
    let (id, had) = stream.event();
    drop(stream);
    let frame = |estimate: &Value| estimate["frame"].as_u64().unwrap();
    service.wait_for("one", |view| view["last"]["frame"].as_u64() > Some(frame(&had) + 100));
    let back = format!("{events}\r\nLast-Event-ID: {id}");
    let mut again = Stream::open(&service, "mode=all", &back);
    let mut before = had.clone();
    for _ in 0..50 {
        let (_, next) = again.event();
        assert_eq!(next["dropped"], 0);
        check_dropped(&before, &next);
        before = next;
    }
    let (_, newest) = Stream::open(&service, "mode=latest", &back).event();
    check_dropped(&had, &newest);
    assert!(newest["dropped"].as_u64() >= Some(100), "{newest}");
    // Another session under that name restarts its frame numbers.
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(200);
    service.wait_for("one", |view| view["last"]["frame"].as_u64() > Some(frame(&had) + 10));
    for mode in ["latest", "all"] {
        let (other, first) = Stream::open(&service, &format!("mode={mode}"), &back).event();
        assert_eq!(first["dropped"], 0, "{id}, then {other}");
    }
}

/// For frames captured on hand-over, or by a camera with time stamps.
#[test]
fn wall_clock_times_are_sent_where_known() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    let estimate = service.socket("one", "").next().unwrap();
    let number = |estimate: &Value, key: &str| estimate[key].as_u64().unwrap();
    let since = isophote_machine::monotonic_ns() - number(&estimate, "capture_ns");
    let now_ms = isophote_machine::unix_ms();
    assert!(
        (number(&estimate, "capture_unix_ns") + since).abs_diff(now_ms * 1_000_000) < 3_600_000_000_000,
        "{estimate}"
    );
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/two", &json!({"source": source, "model": "spot"})).expect(201);
    let media = [("content-type", "application/octet-stream")];
    let pushed = service.request("POST", "/v1/sessions/two/frames", &media, &picture(64, 48, (30.0, 20.0))).expect(200);
    assert!(pushed.get("capture_unix_ns").is_none() && pushed["capture_ns"].is_u64(), "{pushed}");
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
