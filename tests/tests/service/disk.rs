//! A disk that is full: what is put is refused, nothing has changed, and what runs goes on.

use std::os::unix::fs::PermissionsExt;
use std::time::Instant;

use isophote_tests::{Service, program};
use serde_json::{Value, json};

use crate::client::{DEADLINE, Folder, Running, session};
use crate::recorder::{expect_healthy, of, said};

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

/// Its session does not notice; the end of the file has room, for which chunks give way.
#[test]
fn a_recording_on_a_full_disk_ends_and_says_so() {
    let folder = Folder::new("full-recorded");
    let (recorded, arguments) = (folder.0.join("recorded"), ["--recordings", folder.0.to_str().unwrap()]);
    let process = Service::start(&limited(&folder, 1024), &arguments, &folder.0).unwrap();
    let service = Running::at(process.address());
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    // Chunks of 250 kB.
    let document = json!({"name": "full", "rotate_mb": 2, "csv": true});
    service.put("/v1/sessions/one/recording", &document).expect(201);
    let view = service.recording("one", |view| view["state"] != "recording");
    assert_eq!(view["state"], "failed", "{view}");
    assert!(view["reason"].as_str().unwrap().starts_with("the disk: "), "{view}");
    let frames = service.get("/v1/sessions/one").expect(200)["frames"].as_u64();
    let session = service.wait_for("one", |view| view["frames"].as_u64() > frames);
    assert_eq!((&session["state"], &session["dropped"]), (&json!("running"), &json!(0)), "{session}");
    let list = service.get("/v1/recordings").expect(200);
    assert_eq!(list["items"], json!([{"file": "full-0001.mcap", "bytes": view["bytes"]}]), "{view}");
    let path = recorded.join("full-0001.mcap");
    let all = said(&path);
    let fits = of(&all, "isophote.Fit").len();
    assert!(fits > 20 && fits <= view["fits"].as_u64().unwrap() as usize, "{fits}: {view}");
    expect_healthy(&path, fits);
    // The next one is another file.
    service.put("/v1/sessions/one/recording", &json!({"name": "next"})).expect(201);
    drop(process);

    // The same at a start, of a file whose whole chunks leave no room for its end.
    let bytes = std::fs::read(&path).unwrap();
    let chunks = mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes;
    let last = chunks.iter().max_by_key(|chunk| chunk.chunk_start_offset).unwrap();
    let end = (last.chunk_start_offset + last.chunk_length) as usize;
    std::fs::write(recorded.join("room-0001.part.mcap"), &bytes[..end]).unwrap();
    let process = Service::start(&limited(&folder, end.div_ceil(1024)), &arguments, &folder.0).unwrap();
    let service = Running::at(process.address());
    let has_room = || {
        let list = service.get("/v1/recordings").expect(200);
        list["items"].as_array().unwrap().iter().any(|one| one["file"] == "room-0001.mcap")
    };
    let start = Instant::now();
    while !has_room() {
        assert!(start.elapsed() < DEADLINE);
        std::thread::yield_now();
    }
    let shorter = said(&recorded.join("room-0001.mcap"));
    assert!(shorter.len() < all.len() && of(&shorter, "isophote.Fit").len() > fits / 4, "{}", shorter.len());
    expect_healthy(&recorded.join("room-0001.mcap"), of(&shorter, "isophote.Fit").len());
}

fn names(list: &Value) -> Vec<String> {
    list["items"].as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap().to_string()).collect()
}
