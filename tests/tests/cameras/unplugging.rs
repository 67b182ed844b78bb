//! A USB camera behind the kernel's uvcvideo: unplugged, silent, and with damaged pictures.

use std::time::{Duration, Instant};

use isophote_tests::program;
use isophote_tests::rig::{Rig, USB, in_rig, until};
use isophote_tests::uvccam::{Camera, Fault, Scene, node};
use serde_json::json;

use crate::{TestSystem, session};

const SPOT: Scene = Scene::Spot { centre: [100.0, 120.0], half_axes: [30.0, 24.0], amplitude: 150.0, background: 20.0 };
const SERIAL: &str = "rig-0001";

fn small(device: &std::path::Path) -> serde_json::Value {
    session(
        json!({"kind": "camera", "device": device, "format": "GREY", "width": 320, "height": 240, "controls": {"gain": 64}}),
    )
}

/// Time to stop a session, s.
fn stopping(system: &TestSystem, what: &str) -> f64 {
    let start = Instant::now();
    assert_eq!(system.client.delete("/v1/sessions/one").status, 204);
    let time = start.elapsed().as_secs_f64();
    eprintln!("stopped while {what} in {time:.2} s");
    time
}

#[test]
#[ignore = "long proof"]
fn cameras_unplugged_20_times_are_found_again() {
    program().unwrap();
    in_rig(Rig { modules: USB, timeout_s: 240, ..Rig::default() }, || {
        let mut camera = Camera::new(SPOT);
        camera.plug(SERIAL).unwrap();
        let device = node(SERIAL).unwrap();
        let system = TestSystem::start();
        system.client.put("/v1/sessions/one", &small(&device)).expect(201);
        let mut last = system.until_tracking("one", 3)["last"]["frame"].as_u64().unwrap();
        let mut times = Vec::new();
        for round in 0..20 {
            camera.unplug();
            let lost = system.until("one", "lost", |view| view["state"] == "lost_source");
            assert!(lost["reason"].as_str().unwrap().contains("camera"), "{}", lost["reason"]);
            camera.plug(SERIAL).unwrap();
            node(SERIAL).unwrap();
            let back = Instant::now();
            let view = system.until("one", "running", |view| view["state"] == "running");
            times.push(back.elapsed().as_secs_f64());
            let view = if round % 5 == 0 { system.until_tracking("one", 2) } else { view };
            let frame = view["last"]["frame"].as_u64().unwrap();
            assert!(frame >= last, "frames go on being counted");
            last = frame;
        }
        eprintln!("seconds from the node's return to frames: {times:.2?}");
        let view = system.until_tracking("one", 2);
        assert_eq!(view["reason"], serde_json::Value::Null);

        // Silence, then pictures again.
        camera.stall(Duration::from_secs(4));
        let stalled = system.until("one", "stalled", |view| view["state"] == "stalled");
        assert!(stalled["reason"].as_str().is_some_and(|reason| reason.contains("no picture")), "{stalled}");
        system.until_tracking("one", 2);

        // Stop in every state.
        stopping(&system, "it streams");
        system.client.put("/v1/sessions/one", &small(&node(SERIAL).unwrap())).expect(201);
        system.until_tracking("one", 1);
        camera.stall(Duration::from_secs(5));
        system.until("one", "stalled", |view| view["state"] == "stalled");
        stopping(&system, "stalled");
        let before = node(SERIAL).unwrap();
        camera.unplug();
        until("end of the node", Duration::from_secs(10), || (!before.exists()).then_some(())).unwrap();
        camera.plug(SERIAL).unwrap();
        system.client.put("/v1/sessions/one", &small(&node(SERIAL).unwrap())).expect(201);
        system.until_tracking("one", 1);
        camera.unplug();
        system.until("one", "lost", |view| view["state"] == "lost_source");
        stopping(&system, "it is gone");
    });
}

/// uvcvideo drops flagged and short pictures; its sequence numbers skip them.
#[test]
#[ignore = "long proof"]
fn damaged_pictures_are_counted_as_gaps() {
    program().unwrap();
    in_rig(Rig { modules: USB, timeout_s: 120, ..Rig::default() }, || {
        let mut camera = Camera::new(SPOT);
        camera.plug(SERIAL).unwrap();
        let device = node(SERIAL).unwrap();
        let system = TestSystem::start();
        let mut source = small(&device)["source"].clone();
        source["rate_hz"] = json!(5);
        system.client.put("/v1/sources/eye", &source).expect(201);
        system.client.put("/v1/sessions/one", &session(json!("eye"))).expect(201);
        let mut socket = system.client.socket("one", "mode=all");
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
        let camera = system.client.get("/v1/sources/eye").expect(200)["camera"].clone();
        let lost = ["gaps", "damaged", "overtaken"].map(|what| camera[what].as_u64().unwrap());
        eprintln!("4 spoiled pictures: {estimates} frames, {dropped} dropped; gaps, damaged, overtaken {lost:?}");
        assert_eq!(lost[0] + lost[1], 4, "each spoiled picture is missing, and no other");
        assert!(dropped >= 4, "{dropped}");
        assert_eq!(camera["reconnects"], 0);
    });
}
