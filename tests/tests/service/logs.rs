//! What the service says of itself: one JSON object a line, for every change of state.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use isophote_tests::program;
use serde_json::{Value, json};

use crate::client::{Running, session};

/// A service, its process, and what it says from now on.
fn start(level: &str) -> (Running, Child, impl Iterator<Item = Value>) {
    let mut command = Command::new(program().unwrap());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "json", "--log-level", level]);
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(|line| {
        let line = line.unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        assert!(said["message"].is_string() && said["level"].is_string() && said["timestamp"].is_string(), "{line}");
        said
    });
    let listening = lines.find(|said| said["message"] == "listening").unwrap();
    let service = Running::at(listening["address"].as_str().unwrap().trim_start_matches("http://"));
    (service, child, lines)
}

/// The rest of what it says, in order to its end.
fn end(mut child: Child, lines: impl Iterator<Item = Value>) -> Vec<Value> {
    let ended = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(ended.success());
    let said = lines.collect();
    assert!(child.wait().unwrap().success());
    said
}

#[test]
fn a_whole_run_is_lines_of_json() {
    let (service, child, lines) = start("info");
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
    let said = end(child, lines);

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

/// `server/src/service/replay.rs` makes such changes again.
#[test]
fn changes_are_said_with_what_came_of_them() {
    let (service, child, lines) = start("debug");
    let model = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": 1}},
                       "model": {"intensity": "v0"}});
    service.put("/v1/models/mine", &model).expect(201);
    service.put("/v1/sources/shared", &crate::client::synthetic("fit", 0.0)).expect(201);
    let document = json!({"source": "shared", "model": "spot"});
    service.put("/v1/sessions/one", &document).expect(201);
    service.put("/v1/sessions/one/model", &json!({"model": "mine"})).expect(200);
    service.delete("/v1/sources/shared").expect(409);
    service.put("/v1/sessions/one/shadow", &json!({"model": "gaussian"})).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "shared", "model": "nothing"})).expect(404);
    service.delete("/v1/sessions/one").expect(204);
    let said = end(child, lines);
    let changes = said.iter().filter(|one| one["message"] == "change").map(|one| {
        let command: Value = serde_json::from_str(one["command"].as_str().unwrap()).unwrap();
        (command["change"].clone(), command, one["outcome"].clone())
    });
    let changes: Vec<_> = changes.collect();
    let kinds: Vec<_> = changes.iter().map(|(kind, _, outcome)| json!([kind, outcome])).collect();
    let expected = [
        ["put-model", "done"],
        ["put-source", "done"],
        ["put-session", "done"],
        ["swap-model", "done"],
        ["remove-source", "in-use"],
        ["put-shadow", "done"],
        ["remove-session", "done"],
    ];
    // What is refused before it comes to the owner is none of its changes.
    assert_eq!(json!(kinds), json!(expected));
    let (media, text) = ("application/json", model.to_string());
    assert_eq!(changes[0].1, json!({"change": "put-model", "name": "mine", "media": media, "text": text}));
    assert_eq!(changes[3].1, json!({"change": "swap-model", "session": "one", "model": "mine"}));
}
