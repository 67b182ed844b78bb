//! Frames pushed over a WebSocket are answered in order, until one side closes.

use isophote_jit::PixelFormat;
use serde_json::{Value, json};

use crate::client::{Running, picture, session};

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

fn pushed(service: &Running, name: &str) {
    let source = json!({"kind": "pushed", "width": WIDTH, "height": HEIGHT});
    service.put(&format!("/v1/sessions/{name}"), &json!({"source": source, "model": "spot"})).expect(201);
}

/// Centre of the spot in frame n.
fn centre(frame: u64) -> (f64, f64) {
    (24.0 + 0.37 * frame as f64, 20.0 + 0.21 * frame as f64)
}

fn raw(frame: u64) -> Vec<u8> {
    picture(WIDTH, HEIGHT, centre(frame))
}

fn check(estimate: &Value, frame: u64) {
    assert_eq!(estimate["frame"], frame, "{estimate}");
    let number = |name: &str| estimate["parameters"][name].as_f64().unwrap();
    let (x, y) = centre(frame);
    assert!((number("bx") - x).abs() < 0.1 && (number("by") - y).abs() < 0.1, "{estimate}");
    assert_eq!(estimate["session"], "one");
}

/// The sender is far ahead of the answers: frames beyond the window wait in the socket, and none is lost or refused.
#[test]
fn fast_frames_are_answered_in_order() {
    let service = Running::start();
    pushed(&service, "one");
    let mut socket = service.frames_socket("one").unwrap();
    (0..40).for_each(|frame| socket.send_bytes(&raw(frame)));
    (0..40).for_each(|frame| check(&socket.next().unwrap(), frame));
    // A second client and POST share the session.
    let mut second = service.frames_socket("one").unwrap();
    second.send_bytes(&raw(40));
    check(&second.next().unwrap(), 40);
    let media = [("content-type", "application/octet-stream")];
    check(&service.request("POST", "/v1/sessions/one/frames", &media, &raw(41)).expect(200), 41);
    socket.send_bytes(&raw(42));
    check(&socket.next().unwrap(), 42);
    let view = service.wait_for("one", |view| view["frames"] == 43);
    assert_eq!(view["dropped"], 0);
}

#[test]
fn wrong_frames_are_answered_in_order_with_problems() {
    let service = Running::start();
    pushed(&service, "one");
    let mut socket = service.frames_socket("one").unwrap();
    let png =
        |frame, width| isophote_capture::encode_png(width, HEIGHT, PixelFormat::U8, &raw(frame)[..width * HEIGHT]);
    socket.send_bytes(&raw(0));
    socket.send_bytes(&[7; 100]);
    socket.send_bytes(&png(1, WIDTH).unwrap());
    socket.send_bytes(&png(2, WIDTH / 2).unwrap());
    socket.send_bytes(&png(2, WIDTH).unwrap()[..200]);
    socket.send_bytes(&[]);
    socket.send_bytes(&raw(2));
    let problem = |answer: Value, detail: &str| {
        assert_eq!((&answer["status"], &answer["code"]), (&json!(422), &json!("wrong-document")));
        assert_eq!(answer["diagnostics"][0]["code"], "wrong-frame");
        assert!(answer["detail"].as_str().unwrap().contains(detail), "{answer}");
    };
    check(&socket.next().unwrap(), 0);
    problem(socket.next().unwrap(), "100 bytes, 3072 are expected");
    check(&socket.next().unwrap(), 1);
    problem(socket.next().unwrap(), "the frame has [32, 48] px");
    problem(socket.next().unwrap(), "");
    problem(socket.next().unwrap(), "0 bytes, 3072 are expected");
    check(&socket.next().unwrap(), 2);
}

#[test]
fn sockets_for_frames_that_are_refused() {
    let service = Running::start();
    pushed(&service, "one");
    service.put("/v1/sessions/own", &session("fit", 100.0)).expect(201);
    assert_eq!(service.frames_socket("nobody").err(), Some(404));
    assert_eq!(service.frames_socket("own").err(), Some(409));
    assert_eq!(service.open("/v1/sessions/one/frames", "chat").err(), Some(400));
    service.get("/v1/sessions/own/frames").expect(409);
    service.get("/v1/sessions/one/frames").expect(400);
    let mut socket = service.frames_socket("one").unwrap();
    socket.send("[1]");
    assert_eq!(socket.next(), Err(1008), "text is no frame");
    // The header of a binary message of 64 MiB + 1 byte, without its payload.
    let mut socket = service.frames_socket("one").unwrap();
    let length = (64 * 1024 * 1024 + 1u64).to_be_bytes();
    socket.send_raw(&[&[0x82, 0xff], &length[..], &[1, 2, 3, 4]].concat());
    assert_eq!(socket.next(), Err(1009), "too large");
    check_still_there(&service);
}

/// A frame of 2592 × 2592 px may take half of the budget of messages in flight.
#[test]
fn silent_sockets_reserve_no_memory() {
    let service = Running::start();
    pushed(&service, "one");
    for name in ["large", "wide", "broad"] {
        let source = json!({"kind": "pushed", "width": 2592, "height": 2592});
        service.put(&format!("/v1/sessions/{name}"), &json!({"source": source, "model": "spot"})).expect(201);
    }
    let mut idle: Vec<_> = ["large", "wide", "broad"].map(|name| service.frames_socket(name).unwrap()).into();
    check_still_there(&service);
    // Two unfinished messages use up the budget; the next ones wait until these end or disconnect.
    let head = [0x82, 0xff, 0, 0, 0, 0, 0, 0x66, 0x84, 0, 1, 2, 3, 4];
    let mut begun: Vec<_> = idle.drain(..2).collect();
    begun.iter_mut().for_each(|socket| socket.send_raw(&[&head[..], &[7; 100_000]].concat()));
    let mut waiting = service.frames_socket("one").unwrap();
    waiting.send_bytes(&raw(1));
    drop(begun);
    check(&waiting.next().unwrap(), 1);
}

fn check_still_there(service: &Running) {
    let mut socket = service.frames_socket("one").unwrap();
    socket.send_bytes(&raw(0));
    check(&socket.next().unwrap(), 0);
}

#[test]
fn how_a_socket_for_frames_ends() {
    let service = Running::start();
    pushed(&service, "one");
    let mut socket = service.frames_socket("one").unwrap();
    socket.send_bytes(&raw(0));
    check(&socket.next().unwrap(), 0);
    service.delete("/v1/sessions/one");
    assert_eq!(socket.next(), Err(1000), "stopped");
    assert_eq!(service.frames_socket("one").err(), Some(404));

    // Frames accepted before the session is replaced are answered with an estimate or a reason.
    pushed(&service, "one");
    let mut socket = service.frames_socket("one").unwrap();
    (0..8).for_each(|frame| socket.send_bytes(&raw(frame)));
    check(&socket.next().unwrap(), 0);
    let source = json!({"kind": "pushed", "width": WIDTH, "height": HEIGHT});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(200);
    let mut ended = false;
    let code = loop {
        match socket.next() {
            Ok(answer) if answer["status"] == 409 => ended = true,
            Ok(answer) => assert!(answer["frame"].is_u64() && !ended, "{answer}"),
            Err(code) => break code,
        }
    };
    assert_eq!(code, 1000, "replaced");

    let mut socket = service.frames_socket("one").unwrap();
    socket.send_bytes(&raw(0));
    check(&socket.next().unwrap(), 0);
    let stopping = std::thread::Builder::new().name("stop".into()).spawn(move || service.stop()).unwrap();
    assert_eq!(socket.next(), Err(1001), "the service stops");
    stopping.join().unwrap();
}
