//! The program runs under the systemd unit's system call filter.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use isophote_tests::{program, repository};
use seccompiler::{BpfProgram, TargetArch, apply_filter, compile_from_json};
use serde_json::{Value, json};

use crate::client::{Folder, Running, picture, session};

fn unit() -> String {
    std::fs::read_to_string(repository().join("server/deploy/isophote.service")).unwrap()
}

/// Resolves a system call or a group of them.
fn calls(word: &str, groups: &BTreeMap<&str, &str>) -> BTreeSet<String> {
    if !word.starts_with('@') {
        return [word.to_string()].into();
    }
    let members = groups.get(word).unwrap_or_else(|| panic!("syscall-groups.txt has no {word}"));
    members.split_whitespace().flat_map(|member| calls(member, groups)).collect()
}

/// The system calls that a unit allows: its first line denies all others, the following ones remove or add some.
fn allowed(unit: &str) -> BTreeSet<String> {
    let lines = include_str!("syscall-groups.txt").lines().filter(|line| !line.starts_with('#'));
    let groups: BTreeMap<&str, &str> = lines.map(|line| line.split_once(": ").unwrap()).collect();
    let values: Vec<&str> = unit.lines().filter_map(|line| line.strip_prefix("SystemCallFilter=")).collect();
    assert!(values.first().is_some_and(|first| !first.starts_with('~')), "{unit}");
    // systemd always allows these.
    let mut allowed = calls("@default", &groups);
    for value in values {
        let taken_out = value.strip_prefix('~');
        for call in taken_out.unwrap_or(value).split_whitespace().flat_map(|word| calls(word, &groups)) {
            match taken_out {
                Some(_) => drop(allowed.remove(&call)),
                None => drop(allowed.insert(call)),
            }
        }
    }
    allowed
}

/// Denies all others with EPERM, as the unit does.
fn filter(allowed: &BTreeSet<String>) -> BpfProgram {
    let arch = TargetArch::try_from(std::env::consts::ARCH).unwrap();
    let compiled = |names: &[&String]| {
        let rules: Vec<Value> = names.iter().map(|name| json!({"syscall": name})).collect();
        let document =
            json!({"all": {"mismatch_action": {"errno": 1}, "match_action": "allow", "filter": rules}}).to_string();
        compile_from_json(document.as_bytes(), arch).map(|mut programs| programs.remove("all").unwrap())
    };
    // Some names belong to other architectures.
    let known: Vec<&String> = allowed.iter().filter(|name| compiled(&[name]).is_ok()).collect();
    assert!(known.len() > 200, "{}", known.len());
    compiled(&known).unwrap()
}

/// Starts the program under the filter, which applies to the starting thread and its children.
fn start(allowed: &BTreeSet<String>, folder: &Folder) -> Child {
    let (filter, program) = (filter(allowed), program().unwrap());
    let mut command = Command::new(program);
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "json", "--data"]).arg(folder.0.join("data"));
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let confined = move || {
        apply_filter(&filter).unwrap();
        command.spawn().unwrap()
    };
    std::thread::scope(|scope| scope.spawn(confined).join().unwrap())
}

/// The log of a run in which a client exercises all features; `None` if the service does not start to listen.
fn log_of_a_run(allowed: &BTreeSet<String>, folder: &Folder) -> Option<Vec<Value>> {
    let mut child = start(allowed, folder);
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    let mut log = Vec::new();
    let address = loop {
        let Some(line) = lines.next() else {
            assert!(!child.wait().unwrap().success());
            return None;
        };
        let Ok(line) = serde_json::from_str::<Value>(&line) else { continue };
        log.push(line);
        let last = log.last().unwrap();
        if last["message"] == "listening" {
            break last["address"].as_str().unwrap().trim_start_matches("http://").to_string();
        }
    };
    let service = Running::at(&address);
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    let model = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                       "parameters": {"v0": {"start": 1}}, "model": {"intensity": "v0 + exp(-x*x)"}});
    for name in ["level", "again"] {
        service.put(&format!("/v1/models/{name}"), &model).expect(201);
    }
    service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})).expect(200);
    service.put("/v1/sessions/one/recording", &json!({"csv": true})).expect(201);
    service.get("/v1/cameras").expect(200);
    let raw = ("content-type", "application/octet-stream");
    let pushed = json!({"source": {"kind": "pushed", "width": 64, "height": 48, "format": "u8"}, "model": "spot"});
    service.put("/v1/sessions/pushed", &pushed).expect(201);
    let frame = picture(64, 48, (30.0, 20.0));
    assert_eq!(service.request("POST", "/v1/sessions/pushed/frames", &[raw], &frame).status, 200);
    service.delete("/v1/sessions/one/recording").expect(204);
    service.get("/metrics");
    assert!(Command::new("kill").arg(child.id().to_string()).status().unwrap().success());
    log.extend(lines.map(|line| serde_json::from_str(&line).unwrap()));
    assert!(child.wait().unwrap().success());
    Some(log)
}

fn warnings(log: &[Value]) -> Vec<&Value> {
    log.iter().filter(|line| line["level"] != "INFO").collect()
}

#[test]
fn unit_allows_the_system_calls_of_the_program() {
    let folder = Folder::new("syscalls");
    let log = log_of_a_run(&allowed(&unit()), &folder).unwrap();
    assert!(warnings(&log).is_empty(), "{log:#?}");
}

/// Planted faults: denying an optional call is logged once as a warning; denying a needed one prevents the start.
#[test]
fn forbidden_system_calls_are_detected() {
    let without = |call: &str| {
        let mut allowed = allowed(&unit());
        assert!(allowed.remove(call), "{call}");
        log_of_a_run(&allowed, &Folder::new(&format!("without-{call}")))
    };
    let log = without("setpriority").unwrap();
    let warned = warnings(&log);
    assert_eq!(warned.len(), 1, "{warned:#?}");
    assert!(warned[0]["message"].as_str().unwrap().contains("setpriority"), "{warned:?}");
    for call in ["socket", "mprotect"] {
        assert!(without(call).is_none(), "it started without {call}");
    }
}
