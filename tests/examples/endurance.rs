//! Endurance of a service in a process of its own: its resources must not grow.
//!
//! `cargo run --release -p isophote-tests --example endurance -- soak 30`: thirty minutes with a swap a second and a
//! fault a minute, beside a healthy witness session of 30 frames a second. `… -- swaps 100000`: that many swaps in
//! sequence. `… -- slow 1000`: that many heads that do not end, and then bodies. `… -- readers 10`: ten minutes with 32
//! readers of each kind that read nothing and reconnect every five seconds; `… -- floods 10`: the same with far more
//! data to read. Prints the process' usage every minute, or every thousand swaps; exits with status 1 if it has grown
//! at the end.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::ExitCode;
use std::time::Instant;

use client::{Folder, Running, Socket, session};
use isophote_tests::{Service, program};
use serde_json::{Value, json};

/// Frames of the witness per second.
const RATE_HZ: f64 = 30.0;
const SECOND: u64 = 30;
const MINUTE: u64 = 60 * SECOND;
/// Largest growth of memory between the two halves of the time, KiB: allocators round.
const GROWTH_KIB: u64 = 4096;
/// Largest growth of memory per thousand swaps, KiB.
const SWAPS_GROWTH_KIB: f64 = 64.0;
/// Largest growth of memory by readers that read nothing, KiB.
const READERS_GROWTH_KIB: u64 = 1024;
/// Clients that stall are disconnected by then, s.
const SLOW_S_MAX: f64 = 12.0;
const SLOW_HEAD: &str = "GET /v1/sessions HTTP/1.1\r\nHost: localhost\r\nX-Slow: ";
const SLOW_BODY: &str = "POST /v1/sessions/pushed/frames HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/octet-stream\r\nContent-Length: 3072\r\n\r\nxxxx";
/// Models that alternate in the session beside the witness.
const MODELS: [&str; 3] = ["gaussian", "moffat", "spot"];

/// Resources of a process.
#[derive(Clone, Copy, Debug)]
struct Usage {
    memory_kib: u64,
    threads: u64,
    descriptors: u64,
}

impl Usage {
    fn of(process: u32) -> Usage {
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let field = |name: &str| -> u64 {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
            line.split_whitespace().next().unwrap().parse().unwrap()
        };
        let descriptors = fs::read_dir(format!("/proc/{process}/fd")).unwrap().count() as u64;
        Usage { memory_kib: field("VmRSS:"), threads: field("Threads:"), descriptors }
    }
}

/// Connections of faulty clients, kept until the next minute.
struct Faults {
    sockets: Vec<Socket>,
    streams: Vec<TcpStream>,
}

impl Faults {
    fn begin(&mut self, running: &Running, number: u64) -> &'static str {
        (self.sockets, self.streams) = (Vec::new(), Vec::new());
        match number % 6 {
            0 => {
                self.sockets.extend((0..16).map(|_| running.socket("witness", "mode=all&credit=0")));
                "16 subscribers that never read"
            }
            1 => {
                self.begun(running, SLOW_HEAD);
                "16 heads that do not end"
            }
            2 => {
                self.begun(running, SLOW_BODY);
                "16 bodies that do not end"
            }
            3 => {
                for length in 0..200 {
                    let text = format!("name = \"bad\"\n[model]\nintensity = \"{}\"", "(".repeat(length));
                    assert_eq!(running.put_text("/v1/models/bad", "application/toml", &text).status, 422);
                }
                "200 wrong documents"
            }
            4 => {
                for _ in 0..20 {
                    running.put("/v1/sessions/passing", &session("realtime", 60.0)).expect(201);
                    running.delete("/v1/sessions/passing").expect(204);
                    let lost = json!({"source": {"kind": "recording", "path": "/nowhere"}, "model": "spot"});
                    assert!(running.put("/v1/sessions/lost", &lost).status >= 400);
                }
                "20 sessions that come and go"
            }
            _ => {
                for _ in 0..16 {
                    let mut socket = running.socket("witness", "mode=latest");
                    socket.send_raw(&[0x81, 0xff, 1, 2, 3]); // the beginning of a long message, and then nothing
                    drop(socket);
                }
                "16 sockets that break off"
            }
        }
    }

    fn begun(&mut self, running: &Running, text: &str) {
        self.streams.extend((0..16).map(|_| begun(running, text)));
    }
}

/// A client that sends `text`, and then nothing.
fn begun(running: &Running, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(&running.address).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    stream
}

/// The 99th percentile of the gaps between frames of the witness, ms.
fn p99_ms(mut gaps_ns: Vec<u64>) -> f64 {
    gaps_ns.sort_unstable();
    gaps_ns.get(gaps_ns.len() * 99 / 100).map_or(0.0, |gap| *gap as f64 * 1e-6)
}

fn soak(running: &Running, process: u32, minutes: u64) -> bool {
    running.put("/v1/sessions/witness", &session("realtime", RATE_HZ)).expect(201);
    running.put("/v1/sessions/swapped", &session("realtime", RATE_HZ)).expect(201);
    let pushed = json!({"source": {"kind": "pushed", "width": 64, "height": 48, "format": "u8"}, "model": "spot"});
    running.put("/v1/sessions/pushed", &pushed).expect(201);
    let mut witness = running.socket("witness", "mode=all&credit=60000");
    let (mut faults, mut usages) = (Faults { sockets: Vec::new(), streams: Vec::new() }, Vec::new());
    let (mut last_ns, mut gaps_ns, mut dropped, mut swaps) = (None, Vec::new(), 0, 0);
    let mut fault = "none";
    for frame in 1..=minutes * MINUTE {
        let estimate = witness.next().unwrap();
        let now_ns = estimate["publish_ns"].as_u64().unwrap();
        gaps_ns.extend(last_ns.replace(now_ns).map(|before_ns| now_ns - before_ns));
        dropped += estimate["dropped"].as_u64().unwrap();
        assert_eq!(estimate["state"], "tracking", "{estimate}");
        if frame % SECOND == 0 {
            let model = MODELS[swaps % MODELS.len()];
            let swapped = running.put("/v1/sessions/swapped/model", &json!({"model": model, "allow_slow": true}));
            assert_eq!(swapped.expect(200)["active_model"], model);
            swaps += 1;
        }
        if frame % MINUTE == 0 {
            let usage = Usage::of(process);
            let (minute, gap_ms) = (frame / MINUTE, p99_ms(std::mem::take(&mut gaps_ns)));
            println!(
                "minute {minute:3}: {usage:?}, {swaps} swaps, gap {gap_ms:.1} ms (p99), dropped {dropped}, {fault}"
            );
            usages.push(usage);
            witness.send(r#"{"credit": 60000}"#);
            fault = faults.begin(running, frame / MINUTE - 1);
        }
    }
    // Faults repeat every six minutes: each half has all of them.
    let most = |usages: &[Usage], of: fn(&Usage) -> u64| usages.iter().map(of).max().unwrap_or(0);
    let (first, second) = usages.split_at(usages.len() / 2);
    let grown = |of: fn(&Usage) -> u64| most(second, of).saturating_sub(most(first, of));
    let (memory_kib, threads, descriptors) = (grown(|u| u.memory_kib), grown(|u| u.threads), grown(|u| u.descriptors));
    println!(
        "the second half has at most {memory_kib} KiB, {threads} threads, {descriptors} descriptors more than the first"
    );
    memory_kib <= GROWTH_KIB && threads <= 1 && descriptors <= 2 && dropped == 0
}

/// Every stalled client is disconnected in time, and the witness loses nothing.
fn slow(running: &Running, _process: u32, count: u64) -> bool {
    running.put("/v1/sessions/witness", &session("realtime", RATE_HZ)).expect(201);
    let pushed = json!({"source": {"kind": "pushed", "width": 64, "height": 48, "format": "u8"}, "model": "spot"});
    running.put("/v1/sessions/pushed", &pushed).expect(201);
    let mut is_well = true;
    for (what, text) in [("heads", SLOW_HEAD), ("bodies", SLOW_BODY)] {
        let begin = Instant::now();
        let streams: Vec<TcpStream> = (0..count).map(|_| begun(running, text)).collect();
        for mut stream in streams {
            // Only the end of the connection matters, not the response.
            stream.read_to_end(&mut Vec::new()).ok();
        }
        let gone_s = begin.elapsed().as_secs_f64();
        println!("{count} {what} that do not end: gone after {gone_s:.1} s");
        is_well &= gone_s <= SLOW_S_MAX;
    }
    let witness = running.get("/v1/sessions/witness").expect(200);
    println!("the witness dropped {} frames beside {}", witness["dropped"], witness["frames"]);
    is_well && witness["dropped"] == 0
}

/// Readers of ordinary sessions.
fn readers(running: &Running, process: u32, minutes: u64) -> bool {
    not_reading(running, process, minutes, &session("realtime", RATE_HZ))
}

/// Readers of sessions that send forty kilobytes per frame, as fast as possible: rings are full within a second.
fn floods(running: &Running, process: u32, minutes: u64) -> bool {
    let mut document = session("fit", 500.0);
    document["options"] = json!({"predict": {"horizon_s": 1, "steps": 256}});
    not_reading(running, process, minutes, &document)
}

/// 32 readers of each kind, as many as a session accepts, each kind on a session of its own.
fn not_reading(running: &Running, process: u32, minutes: u64, document: &Value) -> bool {
    running.put("/v1/sessions/witness", &session("realtime", RATE_HZ)).expect(201);
    let kinds = ["application/x-ndjson", "text/event-stream", "websocket"];
    let path = |number: usize| format!("/v1/sessions/read-{number}");
    (0..kinds.len()).for_each(|number| drop(running.put(&path(number), document).expect(201)));
    let mut witness = running.socket("witness", "mode=all");
    let (mut sockets, mut streams, mut memory_kib, mut refused) = (Vec::new(), Vec::new(), Vec::new(), 0);
    (0..10 * SECOND).for_each(|_| drop(witness.next().unwrap()));
    println!("before they come: {:?}", Usage::of(process));
    for frame in 0..minutes * MINUTE {
        if frame % (5 * SECOND) == 0 {
            (sockets, streams) = (Vec::new(), Vec::new());
            for (number, kind) in kinds.iter().enumerate() {
                let head = format!(
                    "GET {}/estimates?mode=all HTTP/1.1\r\nHost: localhost\r\nAccept: {kind}\r\n\r\n",
                    path(number)
                );
                for _ in 0..32 {
                    match *kind {
                        "websocket" => match running.try_socket(&format!("read-{number}"), "mode=all", "isophote.v1") {
                            Ok(socket) => sockets.push(socket),
                            Err(_) => refused += 1, // the previous ones are not disconnected yet
                        },
                        _ => streams.push(begun(running, &head)),
                    }
                }
            }
        }
        witness.next().unwrap();
        if frame % MINUTE == MINUTE - 1 {
            let usage = Usage::of(process);
            println!("minute {:3}: {usage:?}, {refused} sockets were refused", frame / MINUTE + 1);
            memory_kib.push(usage.memory_kib);
        }
    }
    drop((sockets, streams));
    (0..10 * SECOND).for_each(|_| drop(witness.next().unwrap()));
    println!("ten seconds after they have gone: {:?}", Usage::of(process));
    let (first, second) = memory_kib.split_at(memory_kib.len() / 2);
    let most = |half: &[u64]| half.iter().copied().max().unwrap_or(0);
    let growth_kib = most(second).saturating_sub(most(first));
    println!("the second half has at most {growth_kib} KiB more than the first");
    growth_kib <= READERS_GROWTH_KIB
}

fn swaps(running: &Running, process: u32, count: u64) -> bool {
    running.put("/v1/sessions/swapped", &session("realtime", 500.0)).expect(201);
    let mut memory_kib = Vec::new();
    for number in 1..=count {
        let model = MODELS[number as usize % MODELS.len()];
        let answer =
            running.put("/v1/sessions/swapped/model", &json!({"model": model, "allow_slow": true})).expect(200);
        assert_eq!(answer["active_model"], Value::from(model));
        if number % 1000 == 0 {
            let usage = Usage::of(process);
            if number % 10_000 == 0 || count < 10_000 {
                println!("{number:6} swaps: {usage:?}");
            }
            memory_kib.push(usage.memory_kib as f64);
        }
    }
    // The slope over the second half; caches fill in the first.
    let half = &memory_kib[memory_kib.len() / 2..];
    let growth = (half.last().unwrap_or(&0.0) - half.first().unwrap_or(&0.0)) / (half.len() as f64 - 1.0).max(1.0);
    println!("{growth:.2} KiB more for each 1,000 swaps");
    growth <= SWAPS_GROWTH_KIB
}

fn usage() -> ExitCode {
    println!("usage: endurance soak MINUTES | swaps COUNT | slow COUNT | readers MINUTES | floods MINUTES");
    ExitCode::from(2)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (what, count) = match &arguments[..] {
        [what, count] => (what.as_str(), count.parse::<u64>().ok()),
        _ => ("", None),
    };
    let folder = Folder::new("endurance");
    let data = folder.0.join("data");
    let run = match what {
        "soak" => soak,
        "swaps" => swaps,
        "slow" => slow,
        "readers" => readers,
        "floods" => floods,
        _ => return usage(),
    };
    let Some(count) = count else { return usage() };
    let mut service = Service::start(&program().unwrap(), &["--data", data.to_str().unwrap()], &folder.0).unwrap();
    let is_well = run(&Running::at(service.address()), service.child().id(), count);
    if is_well { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
