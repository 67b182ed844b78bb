//! Records sessions and reads the files: for tests, and for the example that does more of it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use isophote_capture::LogReader;
use isophote_tests::{finish, repository};
use serde_json::{Value, json};

use crate::client::{DEADLINE, Running, session};

/// One message of a file.
pub struct RecordedMessage {
    pub schema: String,
    pub log_time: u64,
    /// Of Isophote's own schemas.
    pub json: Value,
    /// Of pictures.
    pub pixels: Option<Vec<f64>>,
}

/// All messages of a file.
pub fn read_messages(path: &Path) -> Vec<RecordedMessage> {
    let mut reader = LogReader::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        let schema = message.schema.to_string();
        let json = schema.starts_with("isophote.").then(|| serde_json::from_slice(&message.payload).unwrap());
        let pixels = message.frame().map(|frame| {
            let frame = frame.unwrap();
            let width = frame.width();
            (0..width * frame.rows()).map(|at| frame.plane_view(0).pixel(at % width, at / width)).collect()
        });
        all.push(RecordedMessage { schema, log_time: message.log_time, json: json.unwrap_or_default(), pixels });
    }
    all
}

/// Checks a file's records against the specification, as `mcap doctor`, and counts its messages, as `mcap recover`
/// keeps them, with the format authors' package. `None`, with a message, if that is not installed.
pub fn doctor(path: &Path) -> Option<Value> {
    let minute = Duration::from_secs(60);
    let has_package = finish(Command::new("python3").args(["-c", "import mcap"]), minute);
    if !has_package.is_ok_and(|finished| finished.status == Some(0)) {
        eprintln!("skipped: the doctor of MCAP files: python3 has no package mcap");
        return None;
    }
    let script = repository().join("tests/doctor.py");
    let finished = finish(Command::new("python3").arg(script).arg(path), minute).unwrap();
    let report: Value = serde_json::from_str(&finished.stdout).unwrap_or_else(|_| panic!("{}", finished.stderr));
    assert_eq!(finished.status, Some(i32::from(report["faults"] != json!([]))), "{report}");
    Some(report)
}

/// A file has no faults and holds that many fits.
pub fn expect_healthy(path: &Path, fits: usize) {
    if let Some(report) = doctor(path) {
        assert_eq!(report["faults"], json!([]), "{}: {report}", path.display());
        assert_eq!(report["messages"]["isophote.Fit"], fits, "{}: {report}", path.display());
    }
}

/// The messages of a schema.
pub fn of<'a>(all: &'a [RecordedMessage], schema: &str) -> Vec<&'a RecordedMessage> {
    all.iter().filter(|one| one.schema == schema).collect()
}

impl Running {
    /// Polls until the recording is as wanted.
    pub fn recording(&self, session: &str, is_there: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let view = self.get(&format!("/v1/sessions/{session}/recording")).expect(200);
            if is_there(&view) {
                return view;
            }
            assert!(start.elapsed() < DEADLINE, "{view}");
            std::thread::yield_now();
        }
    }
}

/// Frames fitted since the start of the recording.
pub fn fits(view: &Value) -> u64 {
    view["fits"].as_u64().unwrap()
}

/// Records a session in pace `fit`, with two swaps; returns the file.
pub fn recorded(service: &Running, folder: &Path, name: &str, fits_wanted: u64) -> PathBuf {
    let mut document = session("fit", 100.0);
    document["source"]["full_well_e"] = json!(5000);
    service.put(&format!("/v1/sessions/{name}"), &document).expect(201);
    service.wait_for(name, |view| view["frames"].as_u64() > Some(20));
    let at = format!("/v1/sessions/{name}/recording");
    let view = service.put(&at, &json!({"name": name})).expect(201);
    assert_eq!((&view["state"], &view["frames"]), (&json!("recording"), &json!("raw")), "{view}");
    for (part, model) in [(1, "gaussian"), (2, "spot")] {
        service.recording(name, |view| fits(view) > part * fits_wanted / 3);
        service.put(&format!("/v1/sessions/{name}/model"), &json!({"model": model})).expect(200);
    }
    let view = service.recording(name, |view| fits(view) >= fits_wanted);
    assert_eq!((&view["dropped"], &view["state"]), (&json!(0), &json!("recording")), "{view}");
    let of_session = || service.get(&format!("/v1/sessions/{name}")).expect(200)["recording"].clone();
    assert_eq!((&of_session()["state"], &of_session()["files"]), (&view["state"], &view["files"]));
    assert_eq!(service.delete(&at).status, 204);
    service.get(&at).expect(404);
    assert_eq!(of_session(), Value::Null);
    folder.join(format!("{name}-0001.mcap"))
}
