//! Full disks: writes are refused, nothing changes, and sessions go on.

use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::time::Instant;

use isophote_server::{AccessOptions, Options, RecordingQuota};
use isophote_tests::{Service, finish, program};
use serde_json::{Value, json};

use crate::client::{DEADLINE, Folder, Running, session};
use crate::recorder::{expect_healthy, of, read_messages};

fn level(start: f64, bytes: usize) -> String {
    let document = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"],
                          "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}});
    let text = document.to_string();
    text.clone() + &" ".repeat(bytes - text.len())
}

/// The program with a file-size limit, KiB.
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
    // A model's document exists twice for a moment: soon another does not fit.
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
    // Freed space is used.
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

/// The session is unaffected; chunks are dropped to make space for the end of the file.
#[test]
fn recordings_on_a_full_disk_end_with_a_reason() {
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
    let item = &list["items"][0];
    assert_eq!((&item["file"], &item["bytes"]), (&json!("full-0001.mcap"), &view["bytes"]), "{list} {view}");
    let path = recorded.join("full-0001.mcap");
    let all = read_messages(&path);
    let fits = of(&all, "isophote.Fit").len();
    assert!(fits > 20 && fits <= view["fits"].as_u64().unwrap() as usize, "{fits}: {view}");
    expect_healthy(&path, fits);
    // The next recording is another file.
    service.put("/v1/sessions/one/recording", &json!({"name": "next"})).expect(201);
    drop(process);

    // Recovery at start-up of a file whose complete chunks leave no space for its end.
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
    let shorter = read_messages(&recorded.join("room-0001.mcap"));
    assert!(shorter.len() < all.len() && of(&shorter, "isophote.Fit").len() > fits / 4, "{}", shorter.len());
    expect_healthy(&recorded.join("room-0001.mcap"), of(&shorter, "isophote.Fit").len());
}

#[test]
fn a_quota_counts_finished_recordings() {
    let folder = Folder::new("quota");
    let access = AccessOptions {
        recordings: Some(folder.0.clone()),
        quota: RecordingQuota { tenant_mb: Some(3), ..RecordingQuota::default() },
        ..AccessOptions::default()
    };
    let service = Running::with(&Options { access, ..Running::options() });
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let put = |document: Value| service.put("/v1/sessions/one/recording", &document);
    let ended = || service.recording("one", |view| view["state"] != "recording");
    let bytes = || {
        let list = service.get("/v1/recordings").expect(200);
        list["items"].as_array().unwrap().iter().map(|file| file["bytes"].as_u64().unwrap()).sum::<u64>()
    };
    put(json!({"name": "first", "disk_budget_mb": 2})).expect(201);
    assert_eq!(ended()["reason"], "its budget of 2 MB is used up");
    put(json!({"name": "second"})).expect(201);
    let view = ended();
    assert_eq!(view["state"], "ended", "{view}");
    assert!(view["reason"].as_str().unwrap().starts_with("recordings of this tenant may take 3 MB"), "{view}");
    assert!((2_500_000..=3_000_000).contains(&bytes()), "{}", bytes());
    expect_healthy(&folder.0.join("recorded/second-0001.mcap"), view["fits"].as_u64().unwrap() as usize);
    // Too little is left even for the beginning of a file.
    std::fs::write(folder.0.join("recorded/by-hand.csv"), vec![b' '; 500_000]).unwrap();
    let problem = put(json!({"name": "third"})).expect(429);
    assert_eq!(problem["code"], "over-limit", "{problem}");
    assert!(problem["detail"].as_str().unwrap().contains("3 MB"), "{problem}");
    // Rotation deletes only files of the same recording.
    service.delete("/v1/recordings/first-0001.mcap").expect(204);
    put(json!({"name": "rotated", "rotate_mb": 1})).expect(201);
    let has_rotated = |view: &Value| view["files"][0] != "rotated-0001.mcap" || view["state"] != "recording";
    let view = service.recording("one", has_rotated);
    assert_eq!(view["state"], "recording", "{view}");
    assert_eq!(service.get("/v1/recordings/second-0001.mcap").status, 200);
    service.delete("/v1/sessions/one/recording").expect(204);
    assert!(bytes() <= 2_500_000, "{}", bytes());
}

#[test]
fn recordings_leave_free_space() {
    let folder = Folder::new("floor");
    let arguments = ["--recordings", folder.0.to_str().unwrap(), "--demo", "--recordings-min-free-mb", "1000000000000"];
    let process = Service::start(&program().unwrap(), &arguments, &folder.0).unwrap();
    let service = Running::at(process.address());
    let problem = service.put("/v1/sessions/demo/recording", &json!({})).expect(507);
    assert_eq!(problem["code"], "storage");
    assert!(problem["detail"].as_str().unwrap().contains("would not leave 1000000000000 MB free"), "{problem}");
    assert_eq!(service.get("/v1/recordings").expect(200)["items"], json!([]));
}

/// On a separate disk, full to its last block, tokens are revoked one by one.
#[test]
fn tokens_are_revoked_on_a_full_disk() {
    let unshare = || {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount"]);
        command
    };
    if !unshare().arg("true").output().is_ok_and(|ended| ended.status.success()) {
        eprintln!("skipped: a disk of its own needs `unshare --map-root-user --mount`");
        return;
    }
    let folder = Folder::new("full-tokens");
    let script = r#"
        mount -t tmpfs -o size=128k tmpfs "$1"
        cd "$1"
        for name in a b c; do "$2" token new --name $name --data . > $name; done
        cat /dev/zero > fill || true
        if echo more > more; then echo "there is free space"; fi
        for name in b a c; do "$2" token revoke $name --data .; "$2" token list --data . | tail -n +2 | wc -l; done
    "#;
    let mut command = unshare();
    command.args(["bash", "-ec", script, "full"]).arg(&folder.0).arg(program().unwrap());
    let ended = finish(&mut command, DEADLINE).unwrap();
    assert_eq!((ended.status, ended.stdout.as_str()), (Some(0), "2\n1\n0\n"), "{}", ended.stderr);
}

fn names(list: &Value) -> Vec<String> {
    list["items"].as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap().to_string()).collect()
}
