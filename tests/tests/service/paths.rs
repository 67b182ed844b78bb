//! File paths: nothing behind one blocks the service or keeps it from starting.

use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use isophote_jit::{PixelFormat, VectorWidth};
use isophote_server::{Options, Server};
use serde_json::{Value, json};

use crate::client::{Folder, Running, picture, session};

/// Timeout of a refusal: 100 ms in the service, plus a client beside many tests.
const SOON: Duration = Duration::from_millis(1500);

fn pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

pub fn png(path: &Path, x: f64) {
    let pixels = picture(64, 48, (x, 24.0));
    std::fs::write(path, isophote_capture::encode_png(64, 48, PixelFormat::U8, &pixels).unwrap()).unwrap();
}

fn recording(path: &Path, repeat: bool) -> Value {
    let source = json!({"kind": "recording", "path": path, "rate_hz": 100, "loop": repeat});
    json!({"source": source, "model": "spot"})
}

#[test]
fn non_files_are_refused_as_recordings_at_once() {
    let (folder, service) = (Folder::new("paths"), Running::start());
    let at = |name: &str| folder.0.join(name);
    for name in ["pipe.png", "pipe.tiff", "pipe.csv"] {
        pipe(&at(name));
    }
    symlink("/dev/zero", at("zero.png")).unwrap();
    symlink("/dev/zero", at("zero.y4m")).unwrap();
    for (name, special) in [("truth-pipe", None), ("truth-zero", Some("/dev/zero"))] {
        std::fs::create_dir_all(at(name)).unwrap();
        png(&at(name).join("0.png"), 30.0);
        let truth = at(name).join("truth.jsonl");
        special.map_or_else(|| pipe(&truth), |target| symlink(target, &truth).unwrap());
    }
    std::fs::create_dir_all(at("pipes-only")).unwrap();
    pipe(&at("pipes-only").join("0.png"));
    let names = [
        "pipe.png",
        "pipe.tiff",
        "pipe.csv",
        "zero.png",
        "zero.y4m",
        "truth-pipe",
        "truth-zero",
        "pipes-only",
        "absent.png",
    ];
    for name in names {
        let begin = Instant::now();
        let answer = service.put("/v1/sessions/one", &recording(&at(name), false)).expect(422);
        assert!(begin.elapsed() < SOON, "{name}: {:?}", begin.elapsed());
        assert_eq!(answer["diagnostics"][0]["key"], "source.path", "{name}: {answer}");
        let source = json!({"kind": "recording", "path": at(name), "rate_hz": 30});
        service.put("/v1/sources/one", &source).expect(422);
    }
    // A picture of 40,000 × 40,000 px according to its header.
    png(&at("huge.png"), 30.0);
    let mut bytes = std::fs::read(at("huge.png")).unwrap();
    bytes[16..24].copy_from_slice(&[0, 0, 156, 64, 0, 0, 156, 64]);
    let mut crc = u32::MAX;
    for byte in &bytes[12..29] {
        crc ^= u32::from(*byte);
        (0..8).for_each(|_| crc = crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 });
    }
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    std::fs::write(at("huge.png"), &bytes).unwrap();
    let answer = service.put("/v1/sessions/one", &recording(&at("huge.png"), true)).expect(422);
    assert_eq!(answer["diagnostics"][0]["key"], "source.path", "{answer}");
    assert!(answer["detail"].as_str().unwrap().contains("huge.png: "), "{answer}");
    // Other files beside the pictures of a folder are ignored.
    png(&at("pipes-only").join("1.png"), 31.0);
    service.put("/v1/sessions/one", &recording(&at("pipes-only"), false)).expect(201);
    service.wait_for("one", |view| view["state"] == "stopped" && view["frames"] == 1);
    service.stop();
}

#[test]
fn loops_survive_damaged_files() {
    let (folder, service) = (Folder::new("loop"), Running::start());
    (0..3u8).for_each(|i| png(&folder.0.join(format!("{i}.png")), 30.0 + f64::from(i)));
    let whole = std::fs::read(folder.0.join("1.png")).unwrap();
    std::fs::write(folder.0.join("1.png"), &whole[..whole.len() / 2]).unwrap();
    service.put("/v1/sources/loop", &recording(&folder.0, true)["source"]).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "loop", "model": "spot"})).expect(201);
    let view = service.wait_for("one", |view| view["frames"].as_u64() > Some(6));
    assert!(view["state"] == "running" && view["dropped"].as_u64() >= Some(2), "{view}");
    let reason = service.get("/v1/sources/loop").expect(200)["reason"].to_string();
    assert!(reason.contains("1.png"), "{reason}");
    // Repaired, it is fitted again.
    std::fs::write(folder.0.join("1.png"), &whole).unwrap();
    service.wait_for("one", |view| view["last"]["file"] == "1.png");
    // A recording without any readable frame waits until one is readable.
    (0..3).for_each(|i| std::fs::write(folder.0.join(format!("{i}.png")), &whole[..50]).unwrap());
    let view = service.wait_for("one", |view| view["state"] == "stalled");
    assert!(view["reason"].as_str().unwrap().contains("damaged"), "{view}");
    std::fs::write(folder.0.join("2.png"), &whole).unwrap();
    service.wait_for("one", |view| view["state"] == "running" && view["last"]["file"] == "2.png");
}

#[test]
fn faults_of_files_do_not_quote_them() {
    let (folder, service) = (Folder::new("quotes"), Running::start());
    let path = folder.0.join("t.csv");
    for text in ["x,y\nsecret,1\n", "1e3,secret\n1,2\n", "secret,secret\n1,2\n", "x,secret\n1,2\n", "x\n1\nsecret,2\n"]
    {
        std::fs::write(&path, text).unwrap();
        let document = json!({"source": {"kind": "recording", "path": path, "rate_hz": 1}, "model": "profile-1d"});
        let answer = service.put("/v1/sessions/one", &document).expect(422).to_string();
        assert!(answer.contains("t.csv") || answer.contains("column"), "{answer}");
        assert!(!answer.contains("secret") && !answer.contains("1e3"), "{answer}");
    }
}

fn start(data: &Path) -> Result<Server, String> {
    let (listen, width) = ("127.0.0.1:0".parse().unwrap(), VectorWidth::default());
    let options = Options {
        listen,
        data: Some(data.to_path_buf()),
        models: None,
        demo: false,
        width,
        access: Default::default(),
    };
    Server::start(&options).map_err(|error| error.to_string())
}

#[test]
fn foreign_files_in_an_old_data_folder_are_ignored() {
    let folder = Folder::new("strangers");
    let models = folder.0.join("models");
    std::fs::create_dir_all(&models).unwrap();
    let spot = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/spot.toml")).unwrap();
    let stored = |text: &str| json!({"version": 1, "media": "application/toml", "text": text}).to_string();
    std::fs::write(models.join("mine.json"), stored(&spot)).unwrap();
    std::fs::write(models.join("wrong.json"), stored("name = 1")).unwrap();
    pipe(&models.join("pipe.json"));
    pipe(&models.join("mine.new"));
    symlink("/dev/zero", models.join("zero.json")).unwrap();
    std::fs::create_dir(models.join("folder.json")).unwrap();
    std::fs::write(models.join("bytes.json"), [0xff, 0xfe]).unwrap();
    std::fs::write(models.join("half.json"), "{\"version\": 1,").unwrap();
    // A pipe in place of the new database does not block either.
    pipe(&folder.0.join("isophote.redb.new"));
    let begin = Instant::now();
    let service = Running::start_with(Some(&folder.0), false);
    assert!(begin.elapsed() < SOON * 4, "{:?}", begin.elapsed());
    service.get("/v1/models/mine").expect(200);
    for name in ["wrong", "pipe", "zero", "folder", "bytes", "half"] {
        service.get(&format!("/v1/models/{name}")).expect(404);
        service.put_text(&format!("/v1/models/{name}"), "application/toml", &spot).expect(201);
    }
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    service.get("/v1/models/pipe").expect(200);
    assert!(models.join("mine.new").exists() && models.join("wrong.json").exists(), "it is the user's");
    // An invalid database prevents the start, and the message names the remedy.
    service.stop();
    std::fs::remove_file(folder.0.join("isophote.redb")).unwrap();
    pipe(&folder.0.join("isophote.redb"));
    let error = start(&folder.0).err().unwrap();
    assert!(error.contains("isophote.redb"), "{error}");
}

#[test]
fn a_data_folder_has_one_service() {
    let folder = Folder::new("alone");
    let first = start(&folder.0).unwrap();
    let error = start(&folder.0).err().unwrap();
    assert!(error.contains("another service"), "{error}");
    first.stop();
    start(&folder.0).unwrap().stop();
}

#[test]
fn removed_shipped_models_stay_removed() {
    let folder = Folder::new("removed");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.delete("/v1/models/gaussian").expect(204);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    service.get("/v1/models/gaussian").expect(404);
    let gaussian = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/gaussian.toml")).unwrap();
    service.put_text("/v1/models/gaussian", "application/toml", &gaussian).expect(201);
    service.stop();
    Running::start_with(Some(&folder.0), false).get("/v1/models/gaussian").expect(200);
}

#[test]
fn commands_do_not_wait_for_pipes() {
    let folder = Folder::new("model-pipe");
    pipe(&folder.0.join("pipe.toml"));
    symlink("/dev/zero", folder.0.join("zero.toml")).unwrap();
    for name in ["pipe.toml", "zero.toml"] {
        let mut command = std::process::Command::new(isophote_tests::program().unwrap());
        command.args(["model", "check", name]).current_dir(&folder.0);
        let finished = isophote_tests::finish(&mut command, crate::client::DEADLINE).unwrap();
        assert_eq!(finished.status, Some(1), "{name}: {}", finished.stderr);
        assert!(finished.stderr.contains("neither a file nor a folder"), "{}", finished.stderr);
    }
}
