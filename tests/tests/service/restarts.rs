//! After a restart declared sessions run again with the models that they had; those that cannot say why; crash loops
//! end.

use std::path::Path;

use isophote_jit::PixelFormat;
use isophote_server::Options;
use isophote_tests::{Service, program};
use serde_json::{Value, json};

use crate::client::{Folder, Running, picture, session, synthetic};

fn start(folder: &Folder) -> Running {
    Running::start_with(Some(&folder.0), false)
}

fn spot() -> String {
    std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap()
}

fn runs(service: &Running, name: &str) -> Value {
    service.wait_for(name, |view| view["state"] == "running" && view["frames"].as_u64() > Some(2))
}

#[test]
fn declared_sessions_run_again_unchanged() {
    let folder = Folder::new("restarts");
    let service = start(&folder);
    service.put_text("/v1/models/mine", "application/toml", &spot()).expect(201);
    let mut own = session("fit", 200.0);
    (own["model"], own["constants"]) = (json!("mine"), json!({"gain": 0.06}));
    let put = service.put("/v1/sessions/own", &own).expect(201);
    service.put("/v1/sources/shared", &synthetic("realtime", 100.0)).expect(201);
    for name in ["swapped", "gone"] {
        service.put(&format!("/v1/sessions/{name}"), &json!({"source": "shared", "model": "spot"})).expect(201);
    }
    service.put("/v1/sessions/swapped/model", &json!({"model": "gaussian"})).expect(200);
    service.delete("/v1/sessions/gone").expect(204);
    // The name moves to a new version; running sessions keep theirs.
    service
        .put_text("/v1/models/mine", "application/toml", &spot().replace("start = -0.5", "start = -0.45"))
        .expect(200);
    let (own, swapped) = (runs(&service, "own"), runs(&service, "swapped"));
    assert_eq!(own["last"]["epoch"], own["epoch"]);
    assert!(own["epoch"].as_u64().unwrap() > 0 && own["epoch"] != swapped["epoch"]);
    assert!(own.get("restarts").is_none() && own["declared_at"].is_string() && own["started_at"].is_string(), "{own}");
    service.stop();

    let service = start(&folder);
    let (own_now, swapped_now) = (runs(&service, "own"), runs(&service, "swapped"));
    assert_eq!((&own_now["active_model"], &own_now["active_digest"]), (&json!("mine"), &put["active_digest"]));
    assert_ne!(service.get("/v1/models/mine").expect(200)["digest"], put["active_digest"]);
    for key in ["model", "constants", "options", "source", "declared_at", "node"] {
        assert_eq!(own_now[key], own[key], "{key}");
    }
    assert_eq!((&own_now["restarts"], &own_now["last"]["node"]), (&json!(1), &own["node"]));
    assert_ne!(own_now["started_at"], own["started_at"]);
    let epochs = [&own, &swapped, &own_now, &swapped_now].map(|view| view["epoch"].as_u64().unwrap());
    assert!(epochs[2..].iter().min() > epochs[..2].iter().max(), "{epochs:?}");
    assert_eq!((&swapped_now["active_model"], &swapped_now["source"]), (&json!("gaussian"), &json!("shared")));
    assert!(swapped_now["last"]["model"].as_str().unwrap().starts_with("gaussian@sha256:"));
    service.get("/v1/sessions/gone").expect(404);
    assert!(service.get("/v1/sources/shared").expect(200)["declared_at"].is_string());
    // Put again, a session is declared anew, with a new epoch within the same start.
    let again = service.put("/v1/sessions/own", &session("fit", 200.0)).expect(200);
    assert!(again["epoch"].as_u64() > epochs.into_iter().max() && again.get("restarts").is_none(), "{again}");
    let answer = service.socket("own", "mode=latest").next().unwrap();
    assert_eq!((&answer["epoch"], &answer["node"]), (&again["epoch"], &again["node"]));
}

#[test]
fn sessions_that_cannot_start_say_why() {
    let (folder, files) = (Folder::new("fails"), Folder::new("fails-files"));
    let png = isophote_capture::encode_png(64, 48, PixelFormat::U8, &picture(64, 48, (30.0, 24.0))).unwrap();
    std::fs::write(files.0.join("0.png"), &png).unwrap();
    let recording = json!({"kind": "recording", "path": files.0, "rate_hz": 100, "loop": true});
    let service = start(&folder);
    service.put("/v1/sources/films", &recording).expect(201);
    let document = json!({"source": recording, "model": "spot"});
    service.put("/v1/sessions/film", &document).expect(201);
    service.put("/v1/sessions/shared", &json!({"source": "films", "model": "gaussian"})).expect(201);
    service.put("/v1/sessions/well", &session("fit", 200.0)).expect(201);
    runs(&service, "film");
    service.stop();
    std::fs::remove_file(files.0.join("0.png")).unwrap();

    let service = start(&folder);
    runs(&service, "well");
    let view = service.wait_for("film", |view| view["state"] == "failed");
    assert!(view["reason"].as_str().unwrap().len() > 10, "{view}");
    assert_eq!((&view["source"]["path"], &view["frames"]), (&json!(files.0), &json!(0)));
    assert!(
        view.get("epoch").is_none() && view.get("started_at").is_none() && view["declared_at"].is_string(),
        "{view}"
    );
    service.wait_for("shared", |view| view["state"] == "failed" && view["reason"].to_string().contains("films"));
    assert_eq!(service.get("/v1/sources/films").expect(200)["state"], "failed");
    let names = |list: &str| -> Vec<String> {
        let items = service.get(list).expect(200)["items"].clone();
        items.as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap().to_string()).collect()
    };
    assert_eq!(names("/v1/sessions"), ["film", "shared", "well"]);
    assert_eq!(names("/v1/sources"), ["films"]);
    // Operations that need it running are rejected; nothing of it is lost.
    let answer = service.put("/v1/sessions/film/model", &json!({"model": "gaussian"})).expect(409);
    assert!(answer["detail"].as_str().unwrap().contains("put it again"), "{answer}");
    service.delete("/v1/models/gaussian").expect(409);
    std::fs::write(files.0.join("0.png"), &png).unwrap();
    service.put("/v1/sources/films", &recording).expect(200);
    service.put("/v1/sessions/film", &document).expect(200);
    runs(&service, "film");
    service.delete("/v1/sessions/shared").expect(204);
    service.delete("/v1/models/gaussian").expect(204);
    service.delete("/v1/sources/films").expect(204);
    service.stop();
    let service = start(&folder);
    runs(&service, "film");
    service.get("/v1/sessions/shared").expect(404);
    service.get("/v1/sources/films").expect(404);
}

#[test]
fn only_a_declared_demo_is_kept() {
    let folder = Folder::new("demo");
    Running::start_with(Some(&folder.0), true).stop();
    let service = start(&folder);
    service.get("/v1/sessions/demo").expect(404);
    service.put("/v1/sessions/demo", &session("fit", 200.0)).expect(201);
    service.stop();
    let service = Running::start_with(Some(&folder.0), true);
    assert_eq!(runs(&service, "demo")["source"]["width"], 64);
}

/// Starts the demo as the page's button does.
fn declare_demo(service: &Running) {
    service.put("/v1/sources/demo", &synthetic("realtime", 100.0)).expect(201);
    service.put("/v1/sessions/demo", &json!({"source": "demo", "model": "spot"})).expect(201);
}

#[test]
fn stopped_demos_start_again() {
    let folder = Folder::new("demo-stopped");
    let service = start(&folder);
    declare_demo(&service);
    service.delete("/v1/sessions/demo").expect(204);
    service.stop();
    let service = Running::start_with(Some(&folder.0), true);
    assert_eq!(runs(&service, "demo")["source"], "demo");
    assert_eq!(service.get("/v1/sources/demo").expect(200)["width"], 64, "the source that is declared");
    service.delete("/v1/sessions/demo").expect(204);
    service.delete("/v1/sources/demo").expect(204);
    service.stop();
    let service = Running::start_with(Some(&folder.0), true);
    runs(&service, "demo");
    assert_eq!(service.get("/v1/sources/demo").expect(200)["width"], 640, "its own source");
}

/// If the user's own objects have the demo's names, the service starts without a demo session.
#[test]
fn services_start_without_a_demo_that_cannot() {
    let (folder, files) = (Folder::new("demo-cannot"), Folder::new("demo-cannot-files"));
    let png = isophote_capture::encode_png(64, 48, PixelFormat::U8, &picture(64, 48, (30.0, 24.0))).unwrap();
    std::fs::write(files.0.join("0.png"), &png).unwrap();
    let service = start(&folder);
    let recording = json!({"kind": "recording", "path": files.0, "rate_hz": 100, "loop": true});
    service.put("/v1/sources/demo", &recording).expect(201);
    service.stop();
    let service = Running::start_with(Some(&folder.0), true);
    service.get("/v1/sessions/demo").expect(404);
    service.delete("/v1/sources/demo").expect(204);
    let other = spot().replace("bx", "cx");
    service.put_text("/v1/models/spot", "application/toml", &other).expect(200);
    service.stop();
    let service = Running::start_with(Some(&folder.0), true);
    service.get("/v1/sessions/demo").expect(404);
}

fn killed(folder: &Path) {
    let mut service = served(folder);
    service.child().kill().unwrap();
    service.child().wait().unwrap();
}

fn served(folder: &Path) -> Service {
    let data = folder.to_str().unwrap();
    Service::start(&program().unwrap(), &["--data", data, "--vector-width", "128"], folder).unwrap()
}

#[test]
fn sessions_stay_stopped_after_repeated_crashes() {
    let folder = Folder::new("dying");
    let service = start(&folder);
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    service.stop();
    (0..2).for_each(|_| killed(&folder.0));
    {
        let service = start(&folder); // a graceful stop does not count as a crash
        runs(&service, "one");
        service.stop();
    }
    (0..3).for_each(|_| killed(&folder.0));
    for _ in 0..2 {
        let service = start(&folder);
        let view = service.get("/v1/sessions/one").expect(200);
        assert_eq!(view["state"], "stopped");
        let reason = view["reason"].as_str().unwrap();
        assert!(reason.contains("died") && reason.contains("put it again"), "{reason}");
        service.stop(); // they stay stopped
    }
    let service = start(&folder);
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(200);
    runs(&service, "one");
    service.stop();
    runs(&start(&folder), "one");
}

#[test]
fn old_data_folders_are_migrated_once() {
    let folder = Folder::new("old-data");
    let (old, models) = (isophote_tests::repository().join("tests/old-data/models"), folder.0.join("models"));
    std::fs::create_dir_all(&models).unwrap();
    let names = ["level.json", "other.json", "gaussian.removed"];
    for name in names {
        std::fs::copy(old.join(name), models.join(name)).unwrap();
    }
    let service = start(&folder);
    let level = service.get("/v1/models/level").expect(200);
    assert_eq!((&level["version"], &level["parameters"]["v0"]["start"]), (&json!(3), &json!(7.0)));
    let toml = service.request("GET", "/v1/models/level", &[("accept", "application/toml")], b"");
    assert!(toml.text.contains("# kept by an earlier version"), "{}", toml.text);
    assert_eq!(service.get("/v1/models/other").expect(200)["version"], 1);
    service.get("/v1/models/gaussian").expect(404);
    assert_eq!(service.delete("/v1/models/other").status, 204);
    service.stop();
    let service = start(&folder);
    service.get("/v1/models/other").expect(404);
    assert_eq!(service.get("/v1/models/level").expect(200)["version"], 3);
    for name in names {
        assert_eq!(std::fs::read(models.join(name)).unwrap(), std::fs::read(old.join(name)).unwrap(), "left as it was");
    }
}

#[test]
fn documents_of_a_folder_are_put_at_the_start() {
    let (folder, data) = (Folder::new("models-folder"), Folder::new("models-data"));
    std::fs::write(folder.0.join("mine.toml"), spot()).unwrap();
    std::fs::write(folder.0.join("wrong.toml"), "name = \"wrong\"\n").unwrap();
    std::fs::write(folder.0.join("Not_A_Name.toml"), spot()).unwrap();
    std::fs::write(folder.0.join("README"), "of the folder").unwrap();
    std::os::unix::fs::symlink("/dev/zero", folder.0.join("zero.json")).unwrap();
    let options = Options { data: Some(data.0.clone()), models: Some(folder.0.clone()), ..Running::options() };
    let version = |service: &Running| service.get("/v1/models/mine").expect(200)["version"].clone();
    for _ in 0..2 {
        let service = Running::with(&options);
        assert_eq!(version(&service), 1, "what is there already is no new version");
        for name in ["wrong", "zero", "readme"] {
            service.get(&format!("/v1/models/{name}")).expect(404);
        }
        service.stop();
    }
    std::fs::write(folder.0.join("mine.toml"), spot() + "# changed\n").unwrap();
    assert_eq!(version(&Running::with(&options)), 2);
}
