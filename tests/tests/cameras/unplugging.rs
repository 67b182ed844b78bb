//! A USB camera that comes and goes, falls silent and spoils pictures, behind the kernel's uvcvideo.

use std::time::{Duration, Instant};

use isophote_tests::program;
use isophote_tests::rig::{Rig, USB, in_rig, until};
use isophote_tests::uvccam::{Camera, Fault, Scene, node};
use serde_json::json;

use crate::{Whole, session};

const SPOT: Scene = Scene::Spot { centre: [100.0, 120.0], half_axes: [30.0, 24.0], amplitude: 150.0, background: 20.0 };
const SERIAL: &str = "rig-0001";

fn small(device: &std::path::Path) -> serde_json::Value {
    session(
        json!({"kind": "camera", "device": device, "format": "GREY", "width": 320, "height": 240, "controls": {"gain": 64}}),
    )
}

/// How long it takes to stop a session, s.
fn stopping(whole: &Whole, what: &str) -> f64 {
    let start = Instant::now();
    assert_eq!(whole.client.delete("/v1/sessions/one").status, 204);
    let time = start.elapsed().as_secs_f64();
    eprintln!("stopped while {what} in {time:.2} s");
    time
}

#[test]
fn a_camera_that_is_unplugged_20_times_is_found_again_20_times() {
    program().unwrap();
    in_rig(Rig { modules: USB, timeout_s: 240, ..Rig::default() }, || {
        let mut camera = Camera::new(SPOT);
        camera.plug(SERIAL).unwrap();
        let device = node(SERIAL).unwrap();
        let whole = Whole::start();
        whole.client.put("/v1/sessions/one", &small(&device)).expect(201);
        let mut last = whole.until_tracking("one", 3)["last"]["frame"].as_u64().unwrap();
        let mut times = Vec::new();
        for round in 0..20 {
            camera.unplug();
            let lost = whole.until("one", "lost", |view| view["state"] == "lost_source");
            assert!(lost["reason"].as_str().unwrap().contains("camera"), "{}", lost["reason"]);
            camera.plug(SERIAL).unwrap();
            node(SERIAL).unwrap();
            let back = Instant::now();
            let view = whole.until("one", "running", |view| view["state"] == "running");
            times.push(back.elapsed().as_secs_f64());
            let view = if round % 5 == 0 { whole.until_tracking("one", 2) } else { view };
            let frame = view["last"]["frame"].as_u64().unwrap();
            assert!(frame >= last, "frames go on being counted");
            last = frame;
        }
        eprintln!("seconds from the node's return to frames: {times:.2?}");
        let view = whole.until_tracking("one", 2);
        assert_eq!(view["reason"], serde_json::Value::Null);

        // Silence, then pictures again.
        camera.stall(Duration::from_secs(4));
        let stalled = whole.until("one", "stalled", |view| view["state"] == "stalled");
        assert!(stalled["reason"].as_str().is_some_and(|reason| reason.contains("no picture")), "{stalled}");
        whole.until_tracking("one", 2);

        // Stopping, in every state.
        stopping(&whole, "it streams");
        whole.client.put("/v1/sessions/one", &small(&node(SERIAL).unwrap())).expect(201);
        whole.until_tracking("one", 1);
        camera.stall(Duration::from_secs(5));
        whole.until("one", "stalled", |view| view["state"] == "stalled");
        stopping(&whole, "stalled");
        let before = node(SERIAL).unwrap();
        camera.unplug();
        until("end of the node", Duration::from_secs(10), || (!before.exists()).then_some(())).unwrap();
        camera.plug(SERIAL).unwrap();
        whole.client.put("/v1/sessions/one", &small(&node(SERIAL).unwrap())).expect(201);
        whole.until_tracking("one", 1);
        camera.unplug();
        whole.until("one", "lost", |view| view["state"] == "lost_source");
        stopping(&whole, "it is gone");
    });
}

/// uvcvideo drops pictures that are flagged or too short; its numbers leave them out.
#[test]
fn spoiled_pictures_are_gaps_and_are_counted_exactly() {
    program().unwrap();
    in_rig(Rig { modules: USB, timeout_s: 120, ..Rig::default() }, || {
        let mut camera = Camera::new(SPOT);
        camera.plug(SERIAL).unwrap();
        let device = node(SERIAL).unwrap();
        let whole = Whole::start();
        let mut source = small(&device)["source"].clone();
        source["rate_hz"] = json!(5);
        whole.client.put("/v1/sources/eye", &source).expect(201);
        whole.client.put("/v1/sessions/one", &session(json!("eye"))).expect(201);
        let mut socket = whole.client.socket("one", "mode=all");
        let first = socket.next().unwrap()["frame"].as_u64().unwrap();
        let (mut dropped, mut estimates, mut last) = (0, 0, first);
        for fault in [Fault::Error, Fault::Short, Fault::Error, Fault::Short] {
            camera.spoil(fault);
            for _ in 0..4 {
                let estimate = socket.next().unwrap();
                dropped += estimate["dropped"].as_u64().unwrap();
                estimates += 1;
                last = estimate["frame"].as_u64().unwrap();
            }
        }
        assert_eq!(last - first, estimates + dropped);
        let camera = whole.client.get("/v1/sources/eye").expect(200)["camera"].clone();
        let lost = ["gaps", "damaged", "overtaken"].map(|what| camera[what].as_u64().unwrap());
        eprintln!("4 spoiled pictures: {estimates} frames, {dropped} dropped; gaps, damaged, overtaken {lost:?}");
        assert_eq!(lost[0] + lost[1], 4, "each spoiled picture is missing, and no other");
        assert!(dropped >= 4, "{dropped}");
        assert_eq!(camera["reconnects"], 0);
    });
}
