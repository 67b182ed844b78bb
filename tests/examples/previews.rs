//! Cost of previews, and the view of a slow reader: `cargo run --release -p isophote-tests --example previews --
//! [SECONDS]`. A service shows frames of 640 × 480 at 60 Hz to viewers at 30 Hz, raw and as JPEG. Prints the shares of
//! one processor of the threads that draw and send, and of the whole process beyond its load without viewers; then,
//! through a reader of 4 Mbit/s, the rate and the age of the pictures.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;

use std::fs;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use isophote_tests::Service;
use isophote_wire::PreviewHeader;
use serde_json::json;
use tungstenite::{Message, WebSocket};

use client::Running;

/// Ticks per second of processor time in /proc, on every current Linux.
const TICKS_S: f64 = 100.0;
/// Bytes per second of the slow reader.
const SLOW_BYTES_S: f64 = 4e6 / 8.0;

fn main() {
    let seconds = std::env::args().nth(1).map_or(10.0, |argument| argument.parse().unwrap());
    let folder = client::Folder::new("previews");
    let mut service = Service::start(&isophote_tests::program().unwrap(), &[], &folder.0).unwrap();
    let process = service.child().id();
    let running = Running::at(service.address());
    let source = json!({"kind": "synthetic", "model": "spot", "width": 640, "height": 480, "samples": 1, "rate_hz": 60,
        "set": {"a1": 0.0011, "a2": 0.0, "a3": 0.0025, "v0": 20, "v1": 150}, "full_well_e": 5000, "read_noise_e": 15,
        "motion": {"bx": "320 + 80*sin(2*pi*0.2*t)", "by": "240 + 60*cos(2*pi*0.2*t)"}});
    running.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    running.wait_for("one", |view| view["frames"].as_u64().unwrap() > 120);
    println!("load: {}", fs::read_to_string("/proc/loadavg").unwrap().trim());
    let without = cost(process, seconds, &[]).process;
    println!("no viewer: process {:.1} % of a processor", 100.0 * without);
    for (query, viewers) in
        [("format=raw8", 1), ("format=raw8", 10), ("format=raw8&part=residual", 1), ("format=jpeg", 1)]
    {
        let readers: Vec<Reader> =
            (0..viewers).map(|_| Reader::start(&running, &format!("{query}&rate=30"), f64::INFINITY)).collect();
        let Cost { process, threads } = cost(process, seconds, &readers);
        let shown: Vec<Shown> = readers.into_iter().map(Reader::stop).collect();
        let rate_hz = shown.iter().map(|one| one.rate_hz).sum::<f64>() / shown.len() as f64;
        println!(
            "{query}, {viewers} viewer(s) at {rate_hz:.1} Hz: drawing and sending {:.1} %, process {:+.1} %",
            100.0 * threads,
            100.0 * (process - without)
        );
    }
    for query in ["format=jpeg", "format=raw8"] {
        let reader = Reader::start(&running, &format!("{query}&rate=30"), SLOW_BYTES_S);
        cost(process, 2.0 * seconds, std::slice::from_ref(&reader));
        let Shown { rate_hz, mut ages_ms, width, bytes } = reader.stop();
        ages_ms.sort_by(f64::total_cmp);
        let at = |share: f64| ages_ms[((ages_ms.len() - 1) as f64 * share) as usize];
        println!(
            "{query} at 4 Mbit/s: {rate_hz:.1} Hz, {width} px wide, {bytes:.0} bytes each; from fit to read {:.0} ms (median), {:.0} ms (95 %), {:.0} ms (most)",
            at(0.5),
            at(0.95),
            at(1.0)
        );
    }
    println!("load: {}", fs::read_to_string("/proc/loadavg").unwrap().trim());
}

/// Shares of one processor.
struct Cost {
    process: f64,
    /// Of the threads that draw and those that send.
    threads: f64,
}

/// The cost over this time; the first second does not count.
fn cost(process: u32, seconds: f64, readers: &[Reader]) -> Cost {
    pass(Duration::from_secs(1));
    readers.iter().for_each(|reader| reader.counts.store(true, Ordering::Relaxed));
    let (begin, before) = (Instant::now(), ticks(process));
    pass(Duration::from_secs_f64(seconds));
    let (after, took) = (ticks(process), begin.elapsed().as_secs_f64());
    let share = |kind: usize| (after[kind] - before[kind]) / TICKS_S / took;
    Cost { process: share(0), threads: share(1) }
}

fn pass(time: Duration) {
    let (_open, nothing) = sync_channel::<()>(0);
    nothing.recv_timeout(time).ok();
}

/// Processor time so far, ticks: of the process, and of the threads that draw and send.
fn ticks(process: u32) -> [f64; 2] {
    let of = |path: &str| -> Option<(String, f64)> {
        let text = fs::read_to_string(path).ok()?;
        let (name, numbers) = text.split_once('(')?.1.rsplit_once(')')?;
        let fields: Vec<&str> = numbers.split_whitespace().collect();
        Some((name.to_string(), fields[11].parse::<f64>().ok()? + fields[12].parse::<f64>().ok()?))
    };
    let tasks = fs::read_dir(format!("/proc/{process}/task")).unwrap().map(|task| task.unwrap().path().join("stat"));
    let threads: Vec<(String, f64)> = tasks.filter_map(|path| of(path.to_str()?)).collect();
    let viewing = threads.iter().filter(|(name, _)| name == "http" || name.starts_with("preview"));
    [of(&format!("/proc/{process}/stat")).unwrap().1, viewing.map(|(_, ticks)| ticks).sum()]
}

/// A viewer on a thread of its own.
struct Reader {
    counts: std::sync::Arc<AtomicBool>,
    ends: std::sync::Arc<AtomicBool>,
    thread: JoinHandle<()>,
    shown: Receiver<Shown>,
}

/// The pictures that a reader received.
struct Shown {
    rate_hz: f64,
    ages_ms: Vec<f64>,
    width: usize,
    bytes: f64,
}

impl Reader {
    fn start(service: &Running, query: &str, bytes_s: f64) -> Reader {
        let (counts, ends) = (std::sync::Arc::<AtomicBool>::default(), std::sync::Arc::<AtomicBool>::default());
        let offset_ns = offset_ns(service);
        let stream = Throttled { stream: TcpStream::connect(&service.address).unwrap(), bytes_s, free: Instant::now() };
        let url = format!("ws://{}/v1/sessions/one/preview?{query}", service.address);
        let mut socket = tungstenite::client(url, stream).unwrap().0;
        let (sender, shown) = sync_channel(1);
        let shared = (counts.clone(), ends.clone());
        let read = move || sender.send(read(&mut socket, &shared.0, &shared.1, offset_ns)).unwrap();
        let thread = std::thread::Builder::new().name("viewer".into()).spawn(read).unwrap();
        Reader { counts, ends, thread, shown }
    }

    fn stop(self) -> Shown {
        self.ends.store(true, Ordering::Relaxed);
        let shown = self.shown.recv().unwrap();
        self.thread.join().unwrap();
        shown
    }
}

/// The service's clock minus [`since`], ns.
fn offset_ns(service: &Running) -> f64 {
    let before = since();
    let now = service.get("/v1/time").expect(200)["monotonic_ns"].as_f64().unwrap();
    now - (before + since()) / 2.0
}

fn since() -> f64 {
    static BEGIN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    BEGIN.get_or_init(Instant::now).elapsed().as_nanos() as f64
}

fn read(socket: &mut WebSocket<Throttled>, counts: &AtomicBool, ends: &AtomicBool, offset_ns: f64) -> Shown {
    let (mut begin, mut ages_ms, mut width, mut bytes) = (None, Vec::new(), 0, 0);
    while !ends.load(Ordering::Relaxed) {
        let Message::Binary(message) = socket.read().unwrap() else { continue };
        let now_ns = since() + offset_ns;
        if !counts.load(Ordering::Relaxed) {
            continue;
        }
        let Some(begun) = begin else {
            begin = Some(Instant::now());
            continue;
        };
        let _: Instant = begun;
        let (head, _) = PreviewHeader::read(&message).unwrap();
        ages_ms.push((now_ns - head.drawing.estimate.unwrap().publish_ns.unwrap() as f64) / 1e6);
        (width, bytes) = (head.pixels.width, bytes + message.len());
    }
    let seconds = begin.map_or(f64::NAN, |begin: Instant| begin.elapsed().as_secs_f64());
    let count = ages_ms.len() as f64;
    Shown { rate_hz: count / seconds, ages_ms, width, bytes: bytes as f64 / count }
}

/// A stream with a limited read rate.
struct Throttled {
    stream: TcpStream,
    bytes_s: f64,
    free: Instant,
}

impl Read for Throttled {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.bytes_s.is_infinite() {
            return self.stream.read(bytes);
        }
        pass(self.free.saturating_duration_since(Instant::now()));
        let piece_bytes = bytes.len().min(2048);
        let count = self.stream.read(&mut bytes[..piece_bytes])?;
        self.free = self.free.max(Instant::now()) + Duration::from_secs_f64(count as f64 / self.bytes_s);
        Ok(count)
    }
}

impl Write for Throttled {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}
