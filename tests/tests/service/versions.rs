//! Versions of models: kept by name, restored, and collected when there are too many.

use serde_json::{Value, json};

use crate::client::{Folder, Running, session};

fn level(start: f64) -> Value {
    json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": start}},
           "model": {"intensity": "v0"}})
}

fn versions(service: &Running, name: &str) -> Vec<(u64, bool)> {
    let list = service.get(&format!("/v1/models/{name}/versions")).expect(200);
    let one = |item: &Value| (item["version"].as_u64().unwrap(), item["active"].as_bool().unwrap());
    list["items"].as_array().unwrap().iter().map(one).collect()
}

fn roll_back(service: &Running, name: &str, version: u64, tag: Option<&str>) -> crate::client::Answer {
    let headers: Vec<_> =
        [("content-type", "application/json")].into_iter().chain(tag.map(|tag| ("if-match", tag))).collect();
    let body = json!({"version": version}).to_string();
    service.request("POST", &format!("/v1/models/{name}:rollback"), &headers, body.as_bytes())
}

#[test]
fn rollbacks_restore_kept_versions() {
    for folder in [None, Some(Folder::new("versions"))] {
        let service = Running::start_with(folder.as_ref().map(|folder| folder.0.as_path()), false);
        let put = |start: f64| service.put("/v1/models/level", &level(start));
        let first = put(1.0);
        let (first_tag, first) = (first.etag.clone(), first.expect(201));
        let second = put(2.0);
        let (second_tag, second) = (second.etag.clone(), second.expect(200));
        assert_eq!(versions(&service, "level"), [(2, true), (1, false)]);
        let items = service.get("/v1/models/level/versions").expect(200)["items"].clone();
        assert_eq!((&items[0]["digest"], &items[1]["digest"]), (&second["digest"], &first["digest"]));
        assert_eq!(items[0]["bytes"].as_u64(), Some(level(2.0).to_string().len() as u64));
        assert!(items[0]["created_at"].as_str().unwrap().ends_with('Z'), "{items}");

        roll_back(&service, "level", 1, Some(&first_tag)).expect(412);
        let back = roll_back(&service, "level", 1, Some(&second_tag));
        let back_tag = back.etag.clone();
        let back = back.expect(200);
        assert_eq!((&back["version"], &back["digest"], &back["name"]), (&json!(1), &first["digest"], &json!("level")));
        assert!(back["stages"].is_array(), "as PUT answers: {back}");
        assert_eq!(versions(&service, "level"), [(2, false), (1, true)]);
        let found = service.get("/v1/models/level");
        assert_eq!(found.etag, back_tag);
        assert_eq!(found.expect(200)["version"], 1);
        // A rollback changes the tag: holders of the first version's tag must read again.
        assert_ne!(back_tag, first_tag);
        let stale = [("content-type", "application/json"), ("if-match", first_tag.as_str())];
        service.request("PUT", "/v1/models/level", &stale, level(3.0).to_string().as_bytes()).expect(412);

        assert_eq!(put(3.0).expect(200)["version"], 3, "numbers are used once");
        assert_eq!(versions(&service, "level"), [(3, true), (2, false), (1, false)]);
        roll_back(&service, "level", 4, None).expect(404);
        roll_back(&service, "nobody", 1, None).expect(404);
        service.get("/v1/models/nobody/versions").expect(404);
        let post = |body: &str| {
            let json = [("content-type", "application/json")];
            service.request("POST", "/v1/models/level:rollback", &json, body.as_bytes())
        };
        post("{\"version\": \"1\"}").expect(422);
        post("{\"version\": 1, \"now\": true}").expect(422);
        assert_eq!(service.delete("/v1/models/level").status, 204);
        roll_back(&service, "level", 1, None).expect(404);
        assert_eq!(put(1.0).expect(201)["version"], 1);
        assert_eq!(versions(&service, "level"), [(1, true)]);
    }
}

#[test]
fn shipped_models_are_first_versions() {
    let folder = Folder::new("shipped-versions");
    let service = Running::start_with(Some(&folder.0), false);
    let shipped = service.get("/v1/models/gaussian").expect(200);
    assert_eq!(versions(&service, "gaussian"), [(1, true)]);
    assert_eq!(service.put("/v1/models/gaussian", &level(1.0)).expect(200)["version"], 2);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    assert_eq!(versions(&service, "gaussian"), [(2, true), (1, false)]);
    assert_eq!(roll_back(&service, "gaussian", 1, None).expect(200)["digest"], shipped["digest"]);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    assert_eq!(service.get("/v1/models/gaussian").expect(200), shipped);
    let toml = service.request("GET", "/v1/models/gaussian", &[("accept", "application/toml")], b"");
    let file = std::fs::read_to_string(isophote_tests::repository().join("models/gaussian.toml")).unwrap();
    assert_eq!(toml.text, file, "comments and all");
}

#[test]
fn oldest_versions_are_collected_and_reported() {
    let folder = Folder::new("collected");
    let service = Running::start_with(Some(&folder.0), false);
    for start in 1..=32u32 {
        let answer = service.put("/v1/models/level", &level(f64::from(start)));
        assert_eq!(answer.json().get("collected"), None);
    }
    roll_back(&service, "level", 1, None).expect(200);
    let answer = service.put("/v1/models/level", &level(33.0)).expect(200);
    assert_eq!(answer["collected"], json!([1]), "of those that have the name no longer");
    let list = service.get("/v1/models/level/versions").expect(200);
    assert_eq!((list["items"].as_array().unwrap().len(), &list["collected"]), (32, &json!(1)));
    roll_back(&service, "level", 1, None).expect(404);
    roll_back(&service, "level", 2, None).expect(200);
    // A version restored by a rollback is collected after the next document.
    let again = service.put("/v1/models/level", &level(34.0)).expect(200);
    assert_eq!((&again["version"], &again["collected"]), (&json!(34), &json!([2])));
}

#[test]
fn puts_keep_sessions_and_swaps_move_them() {
    let service = Running::start();
    let spot = std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap();
    service.put_text("/v1/models/mine", "application/toml", &spot).expect(201);
    let mut document = session("fit", 200.0);
    document["model"] = json!("mine");
    let started = service.put("/v1/sessions/one", &document).expect(201);
    let other = spot.replace("start = -0.5", "start = -0.45");
    assert_ne!(other, spot);
    let put = service.put_text("/v1/models/mine", "application/toml", &other).expect(200);
    assert_ne!(put["digest"], started["active_digest"]);
    let view = service.wait_for("one", |view| view["frames"].as_u64() > Some(3));
    assert_eq!(view["active_digest"], started["active_digest"]);
    assert!(view["last"]["model"].as_str().unwrap().ends_with(started["active_digest"].as_str().unwrap()));
    let swapped = service.put("/v1/sessions/one/model", &json!({"model": "mine"})).expect(200);
    assert_eq!(swapped["active_digest"], put["digest"]);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["active_digest"], put["digest"]);
}

#[test]
fn models_refused_by_a_session_are_not_stored() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 50.0)).expect(201);
    let colours = |start: f64| {
        let mut document = level(start);
        document["channels"] = json!(["r", "g", "b"]);
        document["model"]["observed"] = json!("r");
        document
    };
    for used in ["swap", "shadow"] {
        let name = format!("level-{used}");
        let (model, path) = (format!("/v1/models/{name}"), format!("/v1/models/{name}?{used}=one"));
        service.put(&path, &colours(1.0)).expect(409);
        service.get(&model).expect(404);
        service.put(&format!("{model}?{used}=nobody"), &level(1.0)).expect(404);
        service.put(&path, &level(1.0)).expect(201);
        service.put(&path, &colours(2.0)).expect(409);
        assert_eq!(versions(&service, &name), [(1, true)]);
        // Stored, but not for this session.
        service.put(&model, &colours(2.0)).expect(200);
        service.put(&model, &level(3.0)).expect(200);
        let back = |version: u64| {
            let body = json!({"version": version}).to_string();
            let path = format!("{model}:rollback?{used}=one");
            service.request("POST", &path, &[("content-type", "application/json")], body.as_bytes())
        };
        back(2).expect(409);
        assert_eq!(versions(&service, &name), [(3, true), (2, false), (1, false)]);
        back(1).expect(200);
    }
    service.put("/v1/models/level?session=one", &level(1.0)).expect(400);
    let view = service.wait_for("one", |view| view["frames"].as_u64() > Some(2));
    assert_eq!((&view["active_model"], &view["requested_model"]), (&json!("spot"), &json!("spot")));
    assert!(view.get("shadow").is_none(), "{view}");
}
