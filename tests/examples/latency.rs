//! Latency that the service adds to a fit, and to the disk: `cargo run --release -p isophote-tests --example latency --
//! [FRAMES] [PUTS]`.
//!
//! Measures the time from the handover of a frame to its estimate on a subscriber's socket, less the fit, beside a
//! thread that sends as many bytes through a socket of its own at the same rate; and `PUT` of `spot` by a service that
//! has never compiled it, beside the disk's fsync. Exits with status 1 above the limits.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;

use std::fs::File;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::ExitCode;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use client::{Folder, Running, session};
use isophote_machine::monotonic_ns;
use isophote_tests::{Service, program};
use serde_json::Value;
use tungstenite::Message;

const RATE_HZ: f64 = 60.0;
/// Frames before the measurement.
const FIRST: usize = 60;
/// Most that may be added to the bare socket, µs: median, p99.
const ADDED_US_MAX: (f64, f64) = (100.0, 300.0);
/// Most that may be added to the disk, ms, median.
const PUT_MS_MAX: f64 = 30.0;

/// The median and the 99th percentile.
fn median_and_p99(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 2], values[values.len() * 99 / 100])
}

/// The time of a frame before its fit and after it, µs.
type Stages = [f64; 2];

/// The stages of each frame, without the fit; and the bytes of an estimate.
fn frames(running: &Running, count: usize) -> (Vec<Stages>, usize) {
    running.put("/v1/sessions/one", &session("realtime", RATE_HZ)).expect(201);
    let mut socket = running.socket("one", "mode=all");
    let (mut stages_us, mut bytes) = (Vec::new(), 0);
    while stages_us.len() < FIRST + count {
        let Message::Text(text) = socket.read() else { continue };
        let now_ns = monotonic_ns();
        let estimate: Value = serde_json::from_str(&text).unwrap();
        let ended_ns = estimate["publish_ns"].as_u64().unwrap();
        stages_us.push([estimate["timing_us"]["wait"].as_f64().unwrap(), (now_ns - ended_ns) as f64 * 1e-3]);
        bytes = text.len();
    }
    (stages_us.split_off(FIRST), bytes)
}

/// The time through a socket from a thread that only sends, µs.
fn bare(count: usize, bytes: usize) -> Vec<f64> {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut to = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    to.set_nodelay(true).unwrap();
    let mut from = listener.accept().unwrap().0;
    let (_never, ended) = sync_channel::<()>(0);
    let send = move || {
        for _ in 0..FIRST + count {
            ended.recv_timeout(Duration::from_secs_f64(1.0 / RATE_HZ)).ok(); // sleeps
            let mut message = vec![0; bytes.max(8)];
            message[..8].copy_from_slice(&monotonic_ns().to_le_bytes());
            to.write_all(&message).unwrap();
        }
    };
    let sender = std::thread::Builder::new().name("bare".into()).spawn(send).unwrap();
    let mut message = vec![0; bytes.max(8)];
    let mut passed_us: Vec<f64> = (0..FIRST + count)
        .map(|_| {
            from.read_exact(&mut message).unwrap();
            let sent_ns = u64::from_le_bytes(message[..8].try_into().unwrap());
            (monotonic_ns() - sent_ns) as f64 * 1e-3
        })
        .collect();
    sender.join().unwrap();
    passed_us.split_off(FIRST)
}

/// `PUT` of `spot` by a new service, and an fsync of as many bytes on its disk, ms.
fn put(program: &Path, folder: &Path, number: usize) -> (f64, f64) {
    let data = folder.join(number.to_string());
    let service = Service::start(program, &["--data", data.to_str().unwrap()], folder).unwrap();
    let running = Running::at(service.address());
    let mut model = running.get("/v1/models/spot").expect(200);
    ["version", "digest"].iter().for_each(|key| drop(model.as_object_mut().unwrap().remove(*key)));
    let begin = Instant::now();
    running.put("/v1/models/mine", &model).expect(201);
    let put_ms = begin.elapsed().as_secs_f64() * 1e3;
    let mut file = File::create(data.join("beside")).unwrap();
    let begin = Instant::now();
    file.write_all(model.to_string().as_bytes()).unwrap();
    file.sync_all().unwrap();
    (put_ms, begin.elapsed().as_secs_f64() * 1e3)
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).map(|argument| argument.parse::<usize>().unwrap());
    let (count, puts) = (arguments.next().unwrap_or(3600), arguments.next().unwrap_or(20));
    let (folder, program) = (Folder::new("latency"), program().unwrap());
    let service = Service::start(&program, &[], &folder.0).unwrap();
    let (stages_us, bytes) = frames(&Running::at(service.address()), count);
    // The session keeps running: both have the same load.
    let bare = median_and_p99(bare(count, bytes));
    let added = median_and_p99(stages_us.iter().map(|stages| stages.iter().sum()).collect());
    println!("{count} frames at {RATE_HZ} Hz, estimates of {bytes} bytes, µs, median and p99:");
    println!("  frame handed over to estimate read, less the fit: {:.0}, {:.0}", added.0, added.1);
    for (stage, what) in ["before the fit", "after it"].iter().enumerate() {
        let (median, p99) = median_and_p99(stages_us.iter().map(|stages| stages[stage]).collect());
        println!("    {what}: {median:.0}, {p99:.0}");
    }
    println!("  a bare thread and socket: {:.0}, {:.0}", bare.0, bare.1);
    drop(service);
    let (put_ms, sync_ms) = (0..puts).map(|number| put(&program, &folder.0, number)).unzip();
    let (put_ms, sync_ms) = (median_and_p99(put_ms).0, median_and_p99(sync_ms).0);
    println!("PUT of spot, {puts} new services, ms, median: {put_ms:.1}; one fsync there: {sync_ms:.1}");
    let is_well = added.0 - bare.0 <= ADDED_US_MAX.0 && added.1 - bare.1 <= ADDED_US_MAX.1;
    if is_well && put_ms - sync_ms <= PUT_MS_MAX { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
