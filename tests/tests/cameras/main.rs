//! The whole service on cameras of real drivers. Each test runs in the rig ([`isophote_tests::rig`]), or is skipped
//! without one.
#![allow(clippy::unwrap_used)]

#[allow(dead_code)] // the service tests use the rest
#[path = "../service/client.rs"]
mod client;
mod exposure;
mod faults;
mod tracking;
mod unplugging;

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use isophote_capture::SyntheticSpec;
use isophote_symbolic::Model;
use isophote_tests::rig::{threads, wait};
use isophote_tests::{Finished, Service, finish, program, repository};
use serde_json::{Value, json};

use client::Running;

/// Pictures of a film: a spot on a closed path, each at a different position.
const PICTURES: usize = 16;
/// Picture sizes, px: the rig's processors are slow. vivid's HDMI input supports the larger size only.
const SMALL: [usize; 2] = [320, 240];
const LARGE: [usize; 2] = [640, 480];
/// Timeout of one command.
const COMMAND: Duration = Duration::from_secs(20);

/// `isophote serve` and a client of it. The service ends on drop.
struct TestSystem {
    service: Service,
    client: Running,
}

impl TestSystem {
    fn start() -> TestSystem {
        let service = Service::start(&program().unwrap(), &[], Path::new("/tmp")).unwrap();
        let client = Running::at(service.address());
        client.put_text("/v1/models/plain-spot", "application/toml", &plain_spot()).expect(201);
        TestSystem { service, client }
    }

    /// Runs `isophote ARGUMENTS` against the service.
    fn isophote(&self, arguments: &[&str]) -> Finished {
        let mut command = Command::new(program().unwrap());
        finish(command.args(arguments).env("ISOPHOTE_SERVER", self.service.url()), COMMAND).unwrap()
    }

    /// Polls until the session is as wanted.
    fn until(&self, session: &str, what: &str, is_there: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..2000 {
            let view = self.client.get(&format!("/v1/sessions/{session}")).expect(200);
            if is_there(&view) {
                return view;
            }
            wait(Duration::from_millis(20));
        }
        let view = self.client.get(&format!("/v1/sessions/{session}")).text;
        panic!("not {what}: {view}\nthreads, and where in the kernel they are:\n{}", threads());
    }

    /// Waits until the session has fitted `more` frames and is tracking.
    fn until_tracking(&self, session: &str, more: u64) -> Value {
        let frames = |view: &Value| view["frames"].as_u64().unwrap();
        let before = frames(&self.client.get(&format!("/v1/sessions/{session}")).expect(200));
        let is_tracking = |view: &Value| {
            view["state"] == "running" && view["last"]["state"] == "tracking" && frames(view) >= before + more
        };
        self.until(session, "tracking", is_tracking)
    }
}

/// A spot of 24 × 18 px with camera noise, on a circle, moving 23 px per picture.
fn circling([width, height]: [usize; 2]) -> SyntheticSpec {
    let mut spec = SyntheticSpec::new(Arc::new(Model::from_toml(&plain_spot()).unwrap()));
    [spec.width, spec.height] = [width, height];
    (spec.samples, spec.rate_hz, spec.full_well_e, spec.read_noise_e) = (1, PICTURES as f64, 5000.0, 15.0);
    for (name, value) in [("a1", 1.0 / 576.0), ("a2", 0.0), ("a3", 1.0 / 324.0), ("v0", 20.0), ("v1", 180.0)] {
        spec.set.insert(name.into(), value);
    }
    spec.motion.insert("bx".into(), format!("{} + 60*cos(2*pi*t)", width / 2));
    spec.motion.insert("by".into(), format!("{} + 60*sin(2*pi*t)", height / 2));
    spec
}

/// The profile of `models/spot.toml` without its most costly features: the rig emulates its processor.
fn plain_spot() -> String {
    std::fs::read_to_string(repository().join("tests/documents/plain-spot.toml")).unwrap()
}

fn session(source: Value) -> Value {
    json!({"source": source, "model": "plain-spot"})
}

/// The picture whose spot is nearest to an estimate's, and its distance.
fn nearest(truths: &[[f64; 2]], estimate: &Value) -> (usize, f64) {
    let at = |name: &str| estimate["parameters"][name].as_f64().unwrap();
    let far = |[x, y]: &[f64; 2]| (x - at("bx")).hypot(y - at("by"));
    let all = truths.iter().map(far).enumerate();
    all.min_by(|(_, a), (_, b)| a.total_cmp(b)).unwrap()
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}
