//! The service's log: one JSON object per line, for every change of state.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::MetadataExt;
use std::process::{Child, Command, Stdio};

use isophote_server::{Role, TokenFile};
use isophote_tests::program;
use serde_json::{Value, json};

use crate::client::{Folder, Running, session};

/// A service, its process, and its log.
fn start(level: &str) -> (Running, Child, impl Iterator<Item = Value>) {
    start_with(&["--log-level", level])
}

/// The same with arguments.
pub fn start_with(arguments: &[&str]) -> (Running, Child, impl Iterator<Item = Value> + use<>) {
    let mut command = Command::new(program().unwrap());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "json"]).args(arguments);
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(|line| {
        let line = line.unwrap();
        let entry: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        assert!(entry["message"].is_string() && entry["level"].is_string() && entry["timestamp"].is_string(), "{line}");
        entry
    });
    let listening = lines.find(|entry| entry["message"] == "listening").unwrap();
    let address = listening["address"].as_str().unwrap();
    let service = Running::at(address.trim_start_matches("http://").trim_start_matches("https://"));
    (service, child, lines)
}

/// Stops the service; returns the rest of its log.
pub fn end(mut child: Child, lines: impl Iterator<Item = Value>) -> Vec<Value> {
    let ended = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(ended.success());
    let log_lines = lines.collect();
    assert!(child.wait().unwrap().success());
    log_lines
}

#[test]
fn logs_are_lines_of_json() {
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
    let log_lines = end(child, lines);

    let mut rest = log_lines.iter();
    let mut next = |message: &str| {
        let found = rest.find(|one| one["message"] == message);
        found.unwrap_or_else(|| panic!("no `{message}`, or not in its place: {log_lines:#?}")).clone()
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
    // Frames are not logged: thousands were fitted.
    assert!(log_lines.len() < 40, "{} lines", log_lines.len());
}

/// `server/src/service/replay.rs` repeats such changes.
#[test]
fn changes_are_logged_with_their_outcome() {
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
    let log_lines = end(child, lines);
    let changes = log_lines.iter().filter(|one| one["message"] == "change").map(|one| {
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
    // Requests refused before they reach the owner are not logged as changes.
    assert_eq!(json!(kinds), json!(expected));
    let (media, text) = ("application/json", model.to_string());
    assert_eq!(changes[0].1, json!({"change": "put-model", "name": "mine", "media": media, "text": text}));
    assert_eq!(changes[3].1, json!({"change": "swap-model", "session": "one", "model": "mine"}));
}

#[test]
fn changes_are_logged_with_their_token() {
    let folder = Folder::new("log-tokens");
    let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
    let admin = file.add(Role::Admin, Some("lab")).unwrap().1.text();
    let other = file.add_for("acme", Role::Operate, None).unwrap().1.text();
    let (service, child, lines) = start_with(&["--tokens", file.path().to_str().unwrap()]);
    let ask = |token: &str, method: &str, path: &str, body: &Value| {
        let bearer = format!("Bearer {token}");
        let headers = [("authorization", bearer.as_str()), ("content-type", "application/json")];
        service.request(method, path, &headers, body.to_string().as_bytes()).status
    };
    let model = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": 1}},
                       "model": {"intensity": "v0"}});
    assert_eq!(ask(&admin, "PUT", "/v1/models/level", &model), 201);
    assert_eq!(ask(&admin, "POST", "/v1/models:check", &model), 200);
    assert_eq!(ask(&admin, "GET", "/v1/models/level", &Value::Null), 200);
    assert_eq!(ask(&other, "PUT", "/v1/sessions/one", &session("realtime", 10.0)), 201);
    assert_eq!(ask(&other, "PUT", "/v1/models/level", &model), 403);
    assert_eq!(ask(&other, "PUT", "/v1/sources/one/scene", &json!({})), 404);
    assert_eq!(ask(&other, "DELETE", "/v1/sessions/one", &Value::Null), 204);
    let log_lines = end(child, lines);
    let text = json!(log_lines).to_string();
    assert!([admin, other].iter().all(|token| !text.contains(&token[9..])), "{text}");
    let changes = log_lines.iter().filter(|line| line["message"] == "change made").map(|line| {
        ["token", "tenant", "method", "path", "status"].map(|key| line[key].to_string().replace('"', "")).join(" ")
    });
    let expected = [
        "lab default PUT /v1/models/level 201",
        "operate-1 acme PUT /v1/sessions/one 201",
        "operate-1 acme DELETE /v1/sessions/one 204",
    ];
    assert_eq!(changes.collect::<Vec<_>>(), expected);
}

/// The numbers of lines with and without a leading time.
fn text_log(folder: &Folder, journal: impl FnOnce(&File) -> Option<String>) -> (usize, usize) {
    let path = folder.0.join("log");
    let file = File::create(&path).unwrap();
    let mut command = Command::new(program().unwrap());
    command.args(["serve", "--listen", "127.0.0.1:0", "--demo"]).env_remove("JOURNAL_STREAM");
    command.envs(journal(&file).map(|stream| ("JOURNAL_STREAM", stream)));
    let mut child = command.stdin(Stdio::null()).stderr(file).spawn().unwrap();
    let text = || std::fs::read_to_string(&path).unwrap();
    while !text().contains("target found") {
        assert!(child.try_wait().unwrap().is_none(), "{}", text());
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let text = text();
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("isophote: listening on ")).collect();
    // 2026-01-31T12:00:00.000Z isophote:
    let is_timed = |line: &&&str| {
        let (time, rest) = line.split_at_checked(24).unwrap_or_default();
        let shape: String = time.chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
        shape == "0000-00-00T00:00:00.000Z" && rest.starts_with(" isophote: ")
    };
    let timed = lines.iter().filter(is_timed).count();
    assert!(lines.iter().all(|line| is_timed(&line) || line.starts_with("isophote: ")), "{text}");
    (timed, lines.len() - timed)
}

#[test]
fn text_lines_have_a_time_except_in_the_journal() {
    let folder = Folder::new("log-times");
    let stream = |file: &File, more: u64| {
        let about = file.metadata().unwrap();
        Some(format!("{}:{}", about.dev(), about.ino() + more))
    };
    let (timed, bare) = text_log(&folder, |_| None);
    assert!(timed > 1 && bare == 0, "{timed} {bare}");
    let (timed, bare) = text_log(&folder, |file| stream(file, 0));
    assert!(timed == 0 && bare > 1, "{timed} {bare}");
    // Inherited from a service with another standard error.
    let (timed, bare) = text_log(&folder, |file| stream(file, 1));
    assert!(timed > 1 && bare == 0, "{timed} {bare}");
}
