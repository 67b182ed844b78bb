//! Cost of a shadow to its session: `cargo run --release -p isophote-tests --example shadow -- [SECONDS] [MODEL]`. A
//! 640 × 480 session at 60 fps, first alone, then with a shadow: frames dropped by the session in either time, frames
//! that the shadow fitted and left out, and the cost of both. Fails if the session drops a frame beside the shadow and
//! none alone.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use client::{Folder, Running};
use isophote_tests::{Service, program};
use serde_json::{Value, json};

fn main() {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().map_or(60, |seconds| seconds.parse().unwrap());
    let model = arguments.next().unwrap_or_else(|| "gaussian".into());
    let folder = Folder::new("shadow-cost");
    let running = Service::start(&program().unwrap(), &[], &folder.0).unwrap();
    let service = Running::at(running.address());
    let source = json!({"kind": "synthetic", "model": "spot", "width": 640, "height": 480, "rate_hz": 60, "samples": 2,
        "motion": {"bx": "320 + 110*sin(2*pi*0.2*t)", "by": "240 + 70*cos(2*pi*0.13*t)"}, "full_well_e": 5000, "read_noise_e": 15});
    let camera = json!({"electrons_per_dn": 19.6, "read_noise_e": 15});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot", "camera": camera})).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking" && view["frames"].as_u64() > Some(120));
    let alone = watched(&service, seconds);
    service.put("/v1/sessions/one/shadow", &json!({"model": model})).expect(201);
    service.wait_for("one", |view| view["shadow"]["frames"].as_u64() > Some(10));
    let beside = watched(&service, seconds);
    let last = service.get("/v1/sessions/one").expect(200);
    let shadow = &last["shadow"];
    println!(
        "{seconds} s each: alone {} frames, {} dropped; beside a shadow {} frames, {} dropped",
        alone[0], alone[1], beside[0], beside[1]
    );
    println!(
        "shadow `{model}`: {} frames, {} left out, {} ms a frame; session {} ms a frame",
        shadow["frames"], shadow["dropped"], shadow["cost_ms"], last["cost_ms"]
    );
    assert!(beside[1] == 0 || alone[1] > 0, "the shadow cost its session frames: {last}");
}

/// Frames that the session fitted and dropped in that time.
fn watched(service: &Running, seconds: u64) -> [u64; 2] {
    let counts = |view: &Value| ["frames", "dropped"].map(|key| view[key].as_u64().unwrap());
    let begin = counts(&service.get("/v1/sessions/one").expect(200));
    let (_nobody, never) = sync_channel::<()>(0);
    assert_eq!(never.recv_timeout(Duration::from_secs(seconds)), Err(RecvTimeoutError::Timeout));
    let end = counts(&service.get("/v1/sessions/one").expect(200));
    [end[0] - begin[0], end[1] - begin[1]]
}
