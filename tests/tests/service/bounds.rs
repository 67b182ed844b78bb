//! Long fits: stopping and swapping do not wait for them, and a frame has a time limit. Alternatives to a model are
//! compiled beside its fits.

use std::fmt::Write;
use std::time::Instant;

use serde_json::{Value, json};

use crate::client::{Answer, DEADLINE, Running, picture};

const SIDE: usize = 1200;

/// Bumps that explain nothing in the picture, stage after stage in f64 over all of it: minutes of work.
pub fn slow() -> String {
    let mut text = String::from("name = \"slow\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n");
    let mut intensity = String::from("0");
    let mut all = Vec::new();
    for bump in 0..4 {
        let middle = 200 + 230 * bump;
        for (name, start) in [("x", middle), ("y", 1100 - middle), ("w", 60 + 20 * bump), ("v", 30)] {
            writeln!(text, "{name}{bump} = {{ start = {start} }}").unwrap();
            all.push(format!("\"{name}{bump}\""));
        }
        write!(intensity, " + v{bump} * exp(-((x - x{bump})^2 + (y - y{bump})^2) / w{bump}^2)").unwrap();
    }
    writeln!(text, "[model]\nintensity = \"{intensity}\"").unwrap();
    for stage in 0..8 {
        let free = all[stage % 2..].join(", ");
        writeln!(text, "[[stages]]\nparameters = [{free}]\nmethod = \"newton\"\niterations = 100\ntolerance = 1e-9")
            .unwrap();
    }
    text
}

/// Waves that no bump resembles.
fn waves() -> Vec<u8> {
    let value = |i: usize| {
        let (x, y) = ((i % SIDE) as f64, (i / SIDE) as f64);
        (128.0 + 60.0 * (0.013 * x + 0.00002 * y * y).sin() + 50.0 * (0.011 * y - 0.00001 * x * x).cos()) as u8
    };
    (0..SIDE * SIDE).map(value).collect()
}

fn started(service: &Running, name: &str) {
    service.put_text("/v1/models/slow", "application/toml", &slow()).expect(201);
    let source = json!({"kind": "pushed", "width": SIDE, "height": SIDE});
    let document = json!({"source": source, "model": "slow", "options": {"precision": "f64"}});
    service.put(&format!("/v1/sessions/{name}"), &document).expect(201);
}

fn push(service: &Running, name: &str, pixels: &[u8]) -> Answer {
    let media = [("content-type", "application/octet-stream")];
    service.request("POST", &format!("/v1/sessions/{name}/frames"), &media, pixels)
}

/// Processor time of the thread of that name, in hundredths of a second; `None` if there is none.
fn worked(thread: &str) -> Option<u64> {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().filter_map(Result::ok);
    tasks.filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok()).find_map(|stat| {
        let (name, rest) = stat.split_once('(')?.1.rsplit_once(')')?;
        (name == thread).then(|| rest.split_whitespace().nth(11)?.parse().ok()).flatten()
    })
}

fn wait(what: &str, is_there: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_there() {
        assert!(begin.elapsed() < DEADLINE, "{what}");
        std::thread::yield_now();
    }
}

#[test]
fn stopping_a_session_cancels_its_fit() {
    let service = Running::start();
    started(&service, "ending");
    std::thread::scope(|scope| {
        let pushed = scope.spawn(|| push(&service, "ending", &waves()));
        wait("the fit begins", || worked("fit ending") > Some(20));
        let begin = Instant::now();
        service.delete("/v1/sessions/ending").expect(204);
        eprintln!("stopped in {:?}", begin.elapsed());
        // The pending push fails at once.
        assert!(pushed.join().unwrap().status >= 400);
        wait("the thread ends", || worked("fit ending").is_none());
        eprintln!("the fit ended in {:?}", begin.elapsed());
    });
    // Nothing is left: a new session of that name starts afresh.
    started_again(&service);
    service.stop();
}

fn started_again(service: &Running) {
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/ending", &json!({"source": source, "model": "spot"})).expect(201);
    let estimate = push(service, "ending", &picture(64, 48, (30.0, 20.0))).expect(200);
    assert_eq!((&estimate["state"], &estimate["frame"]), (&json!("tracking"), &json!(0)), "{estimate}");
}

#[test]
fn a_swap_does_not_wait_for_a_long_fit() {
    let service = Running::start();
    started(&service, "swapping");
    std::thread::scope(|scope| {
        let pushed = scope.spawn(|| push(&service, "swapping", &waves()));
        wait("the fit begins", || worked("fit swapping") > Some(20));
        let begin = Instant::now();
        let swap = service.put("/v1/sessions/swapping/model", &json!({"model": "spot"})).expect(200);
        eprintln!("swapped in {:?}", begin.elapsed());
        assert_eq!((&swap["active_model"], &swap["active_since_frame"]), (&json!("spot"), &json!(1)), "{swap}");
        let estimate = pushed.join().unwrap().expect(200);
        assert_eq!((&estimate["ending"], &estimate["converged"]), (&json!("cancelled"), &json!(false)), "{estimate}");
        assert_eq!(estimate["state"], "searching", "{estimate}");
    });
    let estimate = push(&service, "swapping", &picture(SIDE, SIDE, (600.0, 500.0))).expect(200);
    assert_eq!((&estimate["state"], &estimate["frame"]), (&json!("tracking"), &json!(1)), "{estimate}");
}

#[test]
fn frames_have_a_time_limit() {
    let service = Running::start();
    started(&service, "bounded");
    let begin = Instant::now();
    // The client may time out before the answer.
    push(&service, "bounded", &waves());
    let view = service.wait_for("bounded", |view| view["frames"] == 1);
    eprintln!("answered in {:?}", begin.elapsed());
    let last = &view["last"];
    assert_eq!((&last["ending"], &last["state"]), (&json!("budget"), &json!("searching")), "{view}");
    assert_eq!((&view["state"], &last["converged"]), (&json!("running"), &json!(false)), "{view}");
}

const NOISY: &str = r#"
name = "noisy"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a1 = { start = "extent.xx", min = 0 }
a2 = { start = "extent.xy" }
a3 = { start = "extent.yy", min = 0 }
v0 = { start = "background" }
v1 = { start = "amplitude", min = 0 }
[definitions]
s = "a1 * (x - bx)^2 + 2 * a2 * (x - bx) * (y - by) + a3 * (y - by)^2"
[model]
intensity = "v0 + v1 * if(s <= 1, 1 - 0.5*s - 0.3*s^2 - 0.2*s^3, 0)"
domain = "s <= 2.2"
constraint = ["a1*a3 - a2^2 > 0"]
noise = "1"
"#;

#[test]
fn alternatives_are_used_once_compiled() {
    const SIZE: (usize, usize) = (64, 48);
    let service = Running::start();
    service.put_text("/v1/models/noisy", "application/toml", NOISY).expect(201);
    let source = json!({"kind": "pushed", "width": SIZE.0, "height": SIZE.1});
    service.put("/v1/sessions/covered", &json!({"source": source, "model": "noisy"})).expect(201);
    let clear = picture(SIZE.0, SIZE.1, (30.2, 22.9));
    let covered: Vec<u8> = clear.iter().enumerate().map(|(i, v)| if i % SIZE.0 > 33 { 5 } else { *v }).collect();
    let both = || -> Value {
        let estimate = push(&service, "covered", &clear).expect(200);
        assert_eq!(estimate["state"], "tracking", "{estimate}");
        assert!(estimate["substitute"].is_null(), "{estimate}");
        push(&service, "covered", &covered).expect(200)
    };
    let begin = Instant::now();
    let first = both();
    eprintln!("the first covered frame: {} µs", first["timing_us"]["fit"]);
    assert!(first["substitute"].is_null(), "{first}");
    let last = std::iter::repeat_with(both).find(|estimate| {
        assert!(begin.elapsed() < DEADLINE, "{estimate}");
        !estimate["substitute"].is_null()
    });
    let last = last.unwrap();
    eprintln!("prepared in {:?}; then a covered frame: {} µs", begin.elapsed(), last["timing_us"]["fit"]);
    assert_eq!(last["substitute"]["robust"], true, "{last}");
    let off = last["parameters"]["bx"].as_f64().unwrap() - 30.2;
    assert!(off.abs() < 0.2 && last["state"] == "tracking", "{last}");
}
