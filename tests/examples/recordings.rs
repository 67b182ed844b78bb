//! Long tests of recordings: `cargo run --release -p isophote-tests --example recordings -- verify 10000`, `… -- kills
//! 100 [SEED]`, `… -- cost 20`.
//!
//! `verify`: that many frames with two swaps between them, begun in the middle of a track, replay bit for bit. `kills`:
//! that many kill −9 of a recording session; checks the remaining file and prints the loss. `cost`: records 640 × 480
//! px at 60 Hz for that many seconds, and prints the recording thread's share of a processor.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;
#[path = "../tests/service/recorder.rs"]
mod recorder;

use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use isophote_tests::{Service, finish, program};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};

use client::{Folder, Running, session};

/// Ticks per second of processor time in /proc.
const TICKS_HZ: f64 = 100.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize, usual: u64| arguments.get(at).map_or(usual, |text| text.parse().unwrap());
    match arguments.first().map(String::as_str) {
        Some("verify") => verify(number(1, 10_000)),
        Some("kills") => kills(number(1, 100), number(2, 20_261_123)),
        Some("cost") => cost(number(1, 20)),
        _ => println!("verify FRAMES | kills TIMES [SEED] | cost SECONDS"),
    }
}

fn serve(folder: &Path) -> Service {
    Service::start(&program().unwrap(), &["--recordings", folder.to_str().unwrap(), "--vector-width", "128"], folder)
        .unwrap()
}

fn verified(file: &Path) -> String {
    let mut command = Command::new(program().unwrap());
    let finished =
        finish(command.args(["replay", file.to_str().unwrap(), "--verify"]), Duration::from_secs(600)).unwrap();
    assert_eq!(finished.status, Some(0), "{}", finished.stderr);
    finished.stdout
}

fn verify(frames: u64) {
    let folder = Folder::new("recordings-verify");
    let process = serve(&folder.0);
    let service = Running::at(process.address());
    let file = recorder::recorded(&service, &folder.0.join("recorded"), "one", frames);
    print!("{}", verified(&file));
}

#[allow(clippy::disallowed_methods)] // the service stamps records with it
fn unix_ms() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64() * 1e3
}

/// The time of a file's last fit, ms since 1970, and the number of fits.
fn last_fit(file: &Path) -> (f64, usize) {
    let all = recorder::read_messages(file);
    let fits: Vec<u64> = all.iter().filter(|one| one.schema == "isophote.Fit").map(|one| one.log_time).collect();
    (fits.last().map_or(0.0, |ns| *ns as f64 / 1e6), fits.len())
}

fn kills(times: u64, seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut lost_ms, mut fits) = (Vec::new(), 0);
    for kill in 0..times {
        let folder = Folder::new(&format!("recordings-kills-{kill}"));
        let mut process = serve(&folder.0);
        let service = Running::at(process.address());
        service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
        service.put("/v1/sessions/one/recording", &json!({"name": "cut"})).expect(201);
        service.recording("one", |view| view["bytes"].as_u64() > Some(0) && view["fits"].as_u64() > Some(0));
        let after = Duration::from_micros(u64::from(random.next_u32() % 2_500_000));
        let (end, ended) = sync_channel::<()>(0);
        assert_eq!(ended.recv_timeout(after), Err(RecvTimeoutError::Timeout));
        drop(end);
        process.child().kill().unwrap();
        let killed_ms = unix_ms();
        process.child().wait().unwrap();
        let recordings = folder.0.join("recorded");
        let cut = recordings.join("cut-0001.part.mcap");
        let (last_ms, before) = last_fit(&cut);
        // The external tool recovers the same fits.
        let others = recorder::doctor(&cut).map(|report| report["messages"]["isophote.Fit"].as_u64());
        assert!(others.is_none_or(|fits| fits == Some(before as u64)), "kill {kill}: {others:?} of {before}");
        let process = serve(&folder.0);
        let service = Running::at(process.address());
        let list = loop {
            let list = service.get("/v1/recordings").expect(200);
            if list["items"] != json!([]) {
                break list;
            }
            std::thread::yield_now();
        };
        assert_eq!(list["items"][0]["file"], "cut-0001.mcap", "{list}");
        let file = recordings.join("cut-0001.mcap");
        assert_eq!(last_fit(&file), (last_ms, before), "kill {kill}");
        recorder::expect_healthy(&file, before);
        let bytes = std::fs::read(&file).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let counted = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).count() as u64;
        assert_eq!(summary.stats.unwrap().message_count, counted, "kill {kill}");
        if kill % 10 == 0 {
            verified(&file);
        }
        lost_ms.push(killed_ms - last_ms);
        fits += before;
    }
    lost_ms.sort_by(f64::total_cmp);
    let (median, most) = (lost_ms[lost_ms.len() / 2], lost_ms[lost_ms.len() - 1]);
    println!(
        "{times} kills, seed {seed}: {fits} fits kept; lost: median {median:.0} ms, at most {most:.0} ms; all files have their end"
    );
    assert!(most < 1000.0);
}

/// Processor time of the threads whose names begin with `name`, s.
fn used_s(process: u32, name: &str) -> f64 {
    let tasks = std::fs::read_dir(format!("/proc/{process}/task")).unwrap();
    let of = |entry: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
        let (head, rest) = stat.rsplit_once(')')?;
        let is_it = head.split_once('(')?.1.starts_with(name);
        let fields: Vec<&str> = rest.split_whitespace().collect();
        let ticks: f64 = fields[11].parse::<f64>().ok()? + fields[12].parse::<f64>().ok()?;
        is_it.then_some(ticks / TICKS_HZ)
    };
    tasks.filter_map(Result::ok).filter_map(of).sum()
}

fn cost(seconds: u64) {
    let folder = Folder::new("recordings-cost");
    let mut process = serve(&folder.0);
    let service = Running::at(process.address());
    let mut document = session("realtime", 60.0);
    (document["source"]["width"], document["source"]["height"]) = (json!(640), json!(480));
    document["source"]["motion"] = json!({"bx": "320 + 30*sin(2*pi*0.5*t)", "by": "240 + 20*cos(2*pi*0.5*t)"});
    service.put("/v1/sessions/one", &document).expect(201);
    service.wait_for("one", |view| view["frames"].as_u64() > Some(60));
    let before = service.get("/v1/sessions/one").expect(200);
    service.put("/v1/sessions/one/recording", &json!({"name": "cost"})).expect(201);
    let id = process.child().id();
    service.recording("one", |view| view["fits"].as_u64() > Some(30));
    let (begin, used) = (std::time::Instant::now(), used_s(id, "record"));
    let (begun, capturing, fitting) =
        (service.get("/v1/sessions/one/recording").expect(200), used_s(id, "source"), used_s(id, "fit"));
    let (end, ended) = sync_channel::<()>(0);
    assert_eq!(ended.recv_timeout(Duration::from_secs(seconds)), Err(RecvTimeoutError::Timeout));
    drop(end);
    let (elapsed, used) = (begin.elapsed().as_secs_f64(), used_s(id, "record") - used);
    let view: Value = service.get("/v1/sessions/one/recording").expect(200);
    let after = service.get("/v1/sessions/one").expect(200);
    let counted = |view: &Value, key: &str| view[key].as_u64().unwrap();
    let frames = counted(&view, "recorded_frames") - counted(&begun, "recorded_frames");
    println!(
        "{elapsed:.1} s: {frames} frames, {:.1} MB/s; the recording's thread took {:.1} % of a processor (the source {:.1} %, the fit {:.1} %); \
         {} left out by the recording, {} by the session since",
        (counted(&view, "bytes") - counted(&begun, "bytes")) as f64 / elapsed / 1e6,
        100.0 * used / elapsed,
        100.0 * (used_s(id, "source") - capturing) / elapsed,
        100.0 * (used_s(id, "fit") - fitting) / elapsed,
        view["dropped"],
        counted(&after, "dropped") - counted(&before, "dropped"),
    );
}
