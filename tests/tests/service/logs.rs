//! What the service says of itself: one JSON object a line, for every change of state.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use isophote_tests::program;
use serde_json::{Value, json};

use crate::client::{Running, session};

#[test]
fn a_whole_run_is_lines_of_json() {
    let mut command = Command::new(program().unwrap());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "json"]);
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(|line| {
        let line = line.unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        assert!(said["message"].is_string() && said["level"].is_string() && said["timestamp"].is_string(), "{line}");
        said
    });
    let listening = lines.find(|said| said["message"] == "listening").unwrap();
    let service = Running::at(listening["address"].as_str().unwrap().trim_start_matches("http://"));
    let model = service.get("/v1/models/gaussian").expect(200);
    let mut document = model.as_object().unwrap().clone();
    document.remove("version");
    document.remove("digest");
    service.put("/v1/models/mine", &document.into()).expect(201);
    service.put("/v1/sources/shared", &crate::client::synthetic("fit", 0.0)).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "shared", "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    service.put("/v1/sessions/one/model", &json!({"model": "mine"})).expect(200);
    service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})).expect(200);
    service.delete("/v1/models/mine").expect(204);
    service.delete("/v1/sessions/one").expect(204);
    service.delete("/v1/sources/shared").expect(204);
    service.put("/v1/sessions/two", &session("fit", 0.0)).expect(201);
    let ended = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(ended.success());
    let said: Vec<Value> = lines.collect();
    assert!(child.wait().unwrap().success());

    let mut rest = said.iter();
    let mut next = |message: &str| {
        let found = rest.find(|one| one["message"] == message);
        found.unwrap_or_else(|| panic!("no `{message}`, or not in its place: {said:#?}")).clone()
    };
    assert_eq!(next("model put")["version"], 1);
    assert_eq!(next("source put")["kind"], "synthetic");
    let started = next("session started");
    assert_eq!((&started["session"], &started["frame"]), (&json!("one"), &json!(0)));
    assert!(started["model"].as_str().unwrap().starts_with("spot@sha256:"));
    assert!(next("target found")["frame"].is_u64());
    let swapped = next("model swapped");
    assert!(
        swapped["frame"].as_u64().unwrap() > 0 && swapped["model"].as_str().unwrap().starts_with("mine@"),
        "{swapped}"
    );
    next("model swapped");
    assert_eq!(next("model removed")["model"], "mine");
    let stopped = next("session stopped");
    assert_eq!(stopped["session"], "one");
    assert!(stopped["frames"].as_u64().unwrap() > 0);
    assert_eq!(next("source removed")["source"], "shared");
    assert_eq!(next("session started")["session"], "two");
    assert_eq!(next("the service stops")["level"], "INFO");
    // Nothing is said of frames as such: thousands were fitted.
    assert!(said.len() < 40, "{} lines", said.len());
}
