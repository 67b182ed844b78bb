//! Injects driver faults by vivid while a session tracks the pictures of its loop.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use isophote_tests::loopback::Film;
use isophote_tests::program;
use isophote_tests::rig::{LOOPBACK, Rig, WEBCAM, in_rig, until};
use serde_json::{Value, json};

use crate::{COMMAND, LARGE, PICTURES, SMALL, TestSystem, circling, session};

fn ctl(device: &str, arguments: &[&str]) {
    let mut command = Command::new("v4l2-ctl");
    let done = isophote_tests::finish(command.arg("--device").arg(device).args(arguments), COMMAND).unwrap();
    assert_eq!(done.status, Some(0), "{arguments:?}: {}", done.stderr);
}

/// Writes a film to vivid's output, which vivid loops to its input; the caller ends the writer.
pub fn loop_back(film: &Film) -> Child {
    ctl("/dev/video0", &["--set-input=3"]);
    ctl("/dev/video1", &["--set-output=1"]);
    ctl("/dev/video1", &["--set-dv-bt-timings=index=0"]);
    ctl("/dev/video0", &["--set-dv-bt-timings=index=0"]);
    ctl("/dev/video1", &["--set-fmt-video-out=width=640,height=480,pixelformat=GREY"]);
    ctl("/dev/video0", &["--set-ctrl=loop_video=1,osd_text_mode=2"]);
    let file = Path::new("/run/film.raw");
    std::fs::write(file, film.pictures.concat()).unwrap();
    // Injected faults hit the output too, and end its writer.
    let write =
        format!("v4l2-ctl --device=/dev/video1 --stream-out-mmap=4 --stream-loop --stream-from={}", file.display());
    let again = format!("while :; do {write}; done");
    Command::new("bash").args(["-c", &again]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

pub fn stop(mut writer: Child) {
    writer.kill().unwrap();
    writer.wait().unwrap();
}

/// A source's camera status.
fn camera(system: &TestSystem) -> Value {
    system.client.get("/v1/sources/eye").expect(200)["camera"].clone()
}

fn count(camera: &Value, what: &str) -> u64 {
    camera[what].as_u64().unwrap_or_else(|| panic!("{camera}"))
}

#[test]
#[ignore = "long proof"]
fn sessions_track_through_injected_driver_faults() {
    program().unwrap();
    in_rig(Rig { vivid: Some(WEBCAM), timeout_s: 240, ..Rig::default() }, || {
        let film = Film::render(circling(LARGE), PICTURES, *b"GREY").unwrap();
        let writer = loop_back(&film);
        let system = TestSystem::start();
        let eye = json!({"kind": "camera", "device": "/dev/video0", "format": "GREY"});
        system.client.put("/v1/sources/eye", &eye).expect(201);
        system.client.put("/v1/sessions/one", &session(json!("eye"))).expect(201);
        system.until_tracking("one", 5);
        let inject = |control: &str| ctl("/dev/video0", &[&format!("--set-ctrl={control}")]);

        // Flagged frames are counted and dropped, and the session goes on.
        let before = camera(&system);
        let mut after = before.clone();
        for _ in 0..20 {
            inject("inject_v4l2_buf_flag_error=1"); // one buffer, of the input or of the output
            system.until_tracking("one", 5);
            after = camera(&system);
            if count(&after, "damaged") > count(&before, "damaged") {
                break;
            }
        }
        assert_eq!(count(&after, "damaged"), count(&before, "damaged") + 1);
        assert_eq!(count(&after, "reconnects"), count(&before, "reconnects"));

        // Lost frames are gaps; the total dropped equals the gaps in the numbers.
        inject("percentage_of_dropped_buffers=30");
        let mut socket = system.client.socket("one", "mode=all");
        let (mut first, mut dropped, mut seen) = (None, 0, 0);
        while seen < 100 {
            let estimate = socket.next().unwrap();
            let frame = estimate["frame"].as_u64().unwrap();
            dropped += if first.is_some() { estimate["dropped"].as_u64().unwrap() } else { 0 };
            seen += 1;
            let first = *first.get_or_insert(frame);
            assert_eq!(frame - first, seen - 1 + dropped);
        }
        drop(socket);
        inject("percentage_of_dropped_buffers=0");
        let gaps = count(&camera(&system), "gaps") - count(&after, "gaps");
        eprintln!("30 % dropped buffers: {seen} frames, {dropped} dropped, {gaps} gaps of the driver's numbers");
        assert!(gaps >= 20, "{gaps}");

        // Faults that end a stream: it is reopened.
        for fault in [
            &["inject_vidioc_qbuf_error=1"][..],
            &["inject_fatal_streaming_error=1"],
            &["inject_vidioc_reqbufs_error=1", "inject_fatal_streaming_error=1"],
            &["inject_vidioc_streamon_error=1", "inject_fatal_streaming_error=1"],
            &["disconnect=1"],
        ] {
            let before = count(&camera(&system), "reconnects");
            let is_back = || (count(&camera(&system), "reconnects") > before).then_some(());
            let mut start = Instant::now();
            for _ in 0..20 {
                start = Instant::now();
                fault.iter().for_each(|control| inject(control)); // on the input or the output, whichever comes first
                if until("reconnection", Duration::from_secs(1), is_back).is_ok() {
                    break;
                }
            }
            assert!(is_back().is_some(), "{fault:?} did nothing");
            let view = system.until_tracking("one", 3);
            eprintln!("{fault:?}: tracks again after {:.1} s", start.elapsed().as_secs_f64());
            assert_eq!(view["reason"], Value::Null, "{view}");
        }

        // Sequence numbers that wrap count no losses.
        inject("wrap_sequence_number=1");
        inject("inject_fatal_streaming_error=1");
        system.until_tracking("one", 150);

        stop(writer);
        assert_eq!(system.client.delete("/v1/sessions/one").status, 204);
        assert_eq!(system.client.delete("/v1/sources/eye").status, 204);
        // The device is free again.
        ctl("/dev/video0", &["--set-fmt-video=width=640,height=480,pixelformat=YUYV"]);
    });
}

/// v4l2loopback reports neither that a writer has gone, nor that another one writes a different size.
#[test]
#[ignore = "long proof"]
fn devices_that_change_their_size_are_awaited() {
    program().unwrap();
    in_rig(Rig { loopback: Some(LOOPBACK), timeout_s: 150, ..Rig::default() }, || {
        let device = Path::new("/dev/video0");
        let films = [SMALL, LARGE].map(|size| Film::render(circling(size), PICTURES, *b"GREY").unwrap());
        let system = TestSystem::start();
        let playing = films[0].play(device, 10.0).unwrap();
        let eye = json!({"kind": "camera", "device": device});
        system.client.put("/v1/sessions/one", &session(eye)).expect(201);
        let view = system.until_tracking("one", 5);
        assert_eq!(view["source_camera"]["width"], 320);
        drop(playing);
        system.until("one", "silent", |view| view["state"] == "stalled" || view["state"] == "lost_source");
        // A writer can set its format only while the reader has closed the device, which it does now and then.
        let playing = until("another writer", Duration::from_secs(30), || films[1].play(device, 10.0).ok()).unwrap();
        let other = system.until("one", "told of the size", |view| {
            view["state"] == "lost_source" && view["reason"].as_str().is_some_and(|reason| reason.contains("640×480"))
        });
        eprintln!("{}", other["reason"]);
        let fitted = other["frames"].as_u64();
        drop(playing);
        let playing = until("the first writer", Duration::from_secs(30), || films[0].play(device, 10.0).ok()).unwrap();
        let view = system.until_tracking("one", 5);
        assert!(view["frames"].as_u64() > fitted);
        drop(playing);
    });
}

/// A device that another program streams from is retried until it is free.
#[test]
#[ignore = "long proof"]
fn busy_devices_are_awaited() {
    program().unwrap();
    in_rig(Rig { vivid: Some(WEBCAM), timeout_s: 120, ..Rig::default() }, || {
        let system = TestSystem::start();
        let eye = json!({"kind": "camera", "device": "/dev/video0", "format": "GREY"});
        system.client.put("/v1/sources/eye", &eye).expect(201);
        let mut other = Command::new("v4l2-ctl");
        other.args(["--device=/dev/video0", "--stream-mmap=4", "--stream-count=1000000"]);
        let other = other.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let is_taken = || {
            let mut set = Command::new("v4l2-ctl");
            set.args(["--device=/dev/video0", "--set-fmt-video=width=320,height=180,pixelformat=YUYV"]);
            (isophote_tests::finish(&mut set, COMMAND).unwrap().status != Some(0)).then_some(())
        };
        until("stream of somebody else's", COMMAND, is_taken).unwrap();
        let mut document = session(json!("eye"));
        document["window"] = json!({"x": 300, "y": 200, "width": 32, "height": 24});
        system.client.put("/v1/sessions/one", &document).expect(201);
        let waits = |view: &Value| {
            view["state"] == "lost_source" && view["reason"].as_str().is_some_and(|reason| reason.contains("in use"))
        };
        system.until("one", "told that it is in use", waits);
        stop(other);
        system.until("one", "running", |view| view["state"] == "running" && view["frames"].as_u64() > Some(3));
    });
}
