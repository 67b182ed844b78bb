//! A disk that is full: what is put is refused, nothing has changed, and what runs goes on.

use std::os::unix::fs::PermissionsExt;

use isophote_tests::{Service, program};
use serde_json::{Value, json};

use crate::client::{Folder, Running, session};

fn level(start: f64, bytes: usize) -> String {
    let document = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                          "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}});
    let text = document.to_string();
    text.clone() + &" ".repeat(bytes - text.len())
}

/// The program with files of so many KiB at most.
fn limited(folder: &Folder, kib: usize) -> std::path::PathBuf {
    let script = folder.0.join("limited");
    let program = program().unwrap();
    let text = format!("#!/bin/bash\ntrap '' XFSZ\nulimit -f {kib}\nexec '{}' \"$@\"\n", program.display());
    std::fs::write(&script, text).unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o700)).unwrap();
    script
}

#[test]
fn a_full_disk_changes_nothing() {
    let folder = Folder::new("full");
    let data = folder.0.join("data");
    let arguments = ["--data", data.to_str().unwrap(), "--vector-width", "128"];
    let process = Service::start(&limited(&folder, 4096), &arguments, &folder.0).unwrap();
    let service = Running::at(process.address());
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let put = |i: usize, name: &str| {
        service.put_text(&format!("/v1/models/{name}"), "application/json", &level(i as f64, 500_000))
    };
    // A model's document is there twice for a moment: soon there is no room for another.
    let full = (0..20).find(|i| put(*i, &format!("level-{i}")).status == 507).unwrap();
    assert!(full > 1, "{full}");
    let state =
        || ["models", "sessions", "sources"].map(|kind| names(&service.get(&format!("/v1/{kind}")).expect(200)));
    let before = state();
    put(50, &format!("level-{full}")).expect(507);
    service.get(&format!("/v1/models/level-{full}")).expect(404);
    let problem = put(51, "level-0").expect(507);
    assert!(problem["detail"].as_str().unwrap().contains("nothing was changed"), "{problem}");
    let found = service.get("/v1/models/level-0").expect(200);
    assert_eq!((&found["version"], &found["parameters"]["v0"]["start"]), (&json!(1), &json!(0.0)));
    assert_eq!(state(), before);
    let frames = service.get("/v1/sessions/one").expect(200)["frames"].as_u64();
    service.wait_for("one", |view| view["frames"].as_u64() > frames);
    // Room that is made is used.
    service.delete("/v1/models/level-0").expect(204);
    service.delete("/v1/models/level-1").expect(204);
    service.put("/v1/sessions/two", &session("fit", 200.0)).expect(201);
    drop(process);

    let process = Service::start(&program().unwrap(), &arguments, &folder.0).unwrap();
    let service = Running::at(process.address());
    for name in ["one", "two"] {
        service.wait_for(name, |view| view["frames"].as_u64() > Some(1));
    }
    service.get("/v1/models/level-0").expect(404);
    for i in 2..full {
        let start = service.get(&format!("/v1/models/level-{i}")).expect(200)["parameters"]["v0"]["start"].clone();
        assert_eq!(start.as_f64(), Some(i as f64));
    }
}

fn names(list: &Value) -> Vec<String> {
    list["items"].as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap().to_string()).collect()
}
