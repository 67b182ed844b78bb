//! ETags, `If-Match` and `If-None-Match`: concurrent writers do not overwrite each other's changes, and unchanged
//! resources are not sent again.

use serde_json::{Value, json};

use crate::client::{Answer, Folder, Running, session, synthetic};

fn put(service: &Running, path: &str, document: &Value, condition: (&str, &str)) -> Answer {
    let headers = [("content-type", "application/json"), condition];
    service.request("PUT", path, &headers, document.to_string().as_bytes())
}

fn strong(answer: &Answer) -> String {
    assert!(answer.etag.starts_with('"') && answer.etag.len() > 2, "`{}` of {}", answer.etag, answer.text);
    answer.etag.clone()
}

fn level(start: f64) -> Value {
    json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}})
}

/// Resources with a document: path, and the document in two versions.
fn documents() -> [(&'static str, Value, Value); 3] {
    [
        ("/v1/models/mine", level(1.0), level(2.0)),
        ("/v1/sources/mine", synthetic("fit", 50.0), synthetic("fit", 60.0)),
        ("/v1/sessions/mine", session("fit", 50.0), session("fit", 60.0)),
    ]
}

#[test]
fn stale_changes_of_documents_are_refused() {
    let service = Running::start();
    for (path, first, second) in documents() {
        put(&service, path, &first, ("if-match", "*")).expect(412);
        put(&service, path, &first, ("if-match", "\"1\"")).expect(412);
        service.get(path).expect(404);
        let created = put(&service, path, &first, ("if-none-match", "*"));
        let tag = strong(&created);
        created.expect(201);
        assert_eq!(strong(&service.get(path)), tag, "{path}");
        let problem = put(&service, path, &second, ("if-none-match", "*")).expect(412);
        assert_eq!(problem["code"], "stale");
        put(&service, path, &second, ("if-none-match", &format!("\"other\", W/{tag}"))).expect(412);
        put(&service, path, &second, ("if-match", &format!("W/{tag}"))).expect(412);
        for wrong in ["other", tag.trim_matches('"'), "", "*, *"] {
            for name in ["if-match", "if-none-match"] {
                put(&service, path, &second, (name, wrong)).expect(400);
            }
        }
        assert_eq!(strong(&service.get(path)), tag, "{path} is as it was");

        let replaced = put(&service, path, &second, ("if-match", &format!("\"other\", {tag}")));
        let newer = strong(&replaced);
        replaced.expect(200);
        assert_ne!(newer, tag, "{path}");
        let problem = put(&service, path, &first, ("if-match", &tag)).expect(412);
        assert!(problem["detail"].as_str().unwrap().contains(&newer), "{problem}");
        // Putting the same document again is another change.
        let again = put(&service, path, &second, ("if-none-match", &tag));
        let newest = strong(&again);
        again.expect(200);
        assert_ne!(newest, newer, "{path}");

        let asked = |method: &str, name: &str, tag: &str| service.request(method, path, &[(name, tag)], b"");
        asked("GET", "if-match", &tag).expect(412);
        asked("GET", "if-match", &newest).expect(200);
        asked("DELETE", "if-match", &newer).expect(412);
        asked("DELETE", "if-none-match", "*").expect(412);
        asked("GET", "if-match", &newest).expect(200);
        asked("DELETE", "if-match", &newest).expect(204);
        asked("DELETE", "if-match", &newest).expect(404);
    }
    service.stop();
}

#[test]
fn concurrent_writers_with_one_tag_have_one_winner() {
    let service = Running::start();
    let writers = |path: &str, document: &(dyn Fn(usize) -> Value + Sync), tag: &str| {
        let statuses = std::thread::scope(|scope| {
            let one = |number| {
                let service = &service;
                scope.spawn(move || put(service, path, &document(number), ("if-match", tag)).status)
            };
            let threads: Vec<_> = (0..4).map(one).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<u16>>()
        });
        let count = |status| statuses.iter().filter(|one| **one == status).count();
        assert_eq!((count(200), count(412)), (1, 3), "{path}: {statuses:?}");
    };
    for (path, first, second) in documents() {
        let tag = strong(&service.put(path, &first));
        writers(path, &|_| second.clone(), &tag);
    }
    service.put("/v1/models/spot-2", &service_model(&service)).expect(201);
    let tag = strong(&service.get("/v1/sessions/mine"));
    writers("/v1/sessions/mine/model", &|_| json!({"model": "spot-2"}), &tag);
    for (path, document) in
        [("/v1/sources/mine/scene", json!({"exposure": 0.5})), ("/v1/sources/mine/playback", json!({"paused": true}))]
    {
        let tag = strong(&service.get(path));
        writers(path, &|_| document.clone(), &tag);
    }
    let statuses = std::thread::scope(|scope| {
        let one = |_| scope.spawn(|| put(&service, "/v1/models/new", &level(1.0), ("if-none-match", "*")).status);
        let threads: Vec<_> = (0..4).map(one).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<u16>>()
    });
    assert_eq!(statuses.iter().filter(|status| **status == 201).count(), 1, "{statuses:?}");
    service.stop();
}

/// The document of `spot`.
fn service_model(service: &Running) -> Value {
    let mut document = service.get("/v1/models/spot").expect(200);
    document.as_object_mut().unwrap().retain(|key, _| key != "version" && key != "digest");
    document
}

#[test]
fn unchanged_documents_and_lists_are_not_sent_again() {
    let service = Running::start();
    service.put("/v1/sources/mine", &synthetic("fit", 50.0)).expect(201);
    service.put("/v1/models/mine", &level(1.0)).expect(201);
    let unchanged = |path: &str| {
        let answer = service.get(path);
        let tag = strong(&answer);
        for list in [tag.clone(), format!("W/{tag}"), format!("\"other\", {tag}"), "*".to_string()] {
            let again = service.request("GET", path, &[("if-none-match", &list)], b"");
            assert_eq!(
                (again.status, again.text.as_str(), again.etag.as_str()),
                (304, "", tag.as_str()),
                "{path} {list}"
            );
        }
        service.request("GET", path, &[("if-match", "\"other\"")], b"").expect(412);
        let other = service.request("GET", path, &[("if-none-match", "\"other\"")], b"");
        assert_eq!((other.status, other.text), (200, answer.text), "{path}");
        tag
    };
    let paths = ["/v1/models/mine", "/v1/models", "/v1/models/mine/versions", "/v1/sources/mine/scene"];
    let tags = paths.map(unchanged);
    service.put("/v1/models/mine", &level(2.0)).expect(200);
    service.put("/v1/sources/mine/scene", &json!({"exposure": 0.5})).expect(200);
    for (path, tag) in paths.iter().zip(tags) {
        let changed = service.request("GET", path, &[("if-none-match", &tag)], b"");
        assert_eq!(changed.status, 200, "{path}");
        assert_ne!(strong(&changed), tag, "{path}");
    }
    unchanged("/v1/recordings");
    unchanged("/v1/models/mine/versions?");
    // The text is a different representation.
    let toml = std::fs::read_to_string(isophote_tests::repository().join("models/gaussian.toml")).unwrap();
    service.put_text("/v1/models/text", "application/toml", &toml).expect(201);
    let as_json = strong(&service.get("/v1/models/text"));
    let accept = ("accept", "application/toml");
    let as_text = service.request("GET", "/v1/models/text", &[accept, ("if-none-match", &as_json)], b"");
    assert_eq!((as_text.status, as_text.text.as_str()), (200, toml.as_str()));
    let text_tag = strong(&as_text);
    assert_ne!(text_tag, as_json);
    let again = service.request("GET", "/v1/models/text", &[accept, ("if-none-match", &text_tag)], b"");
    assert_eq!(again.status, 304);
    assert_eq!(service.request("DELETE", "/v1/models/text", &[("if-match", &text_tag)], b"").status, 204);
    service.stop();
}

/// A session's tag is that of its document; since its answer includes state, it is never Not Modified.
#[test]
fn states_are_never_not_modified() {
    let service = Running::start();
    service.put("/v1/sources/mine", &synthetic("realtime", 100.0)).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "mine", "model": "spot"})).expect(201);
    service.put("/v1/sessions/one/shadow", &json!({"model": "gaussian"})).expect(201);
    service.put("/v1/sources/mine/control", &json!({"owner": "me", "timeout_s": 600})).expect(201);
    let first = service.wait_for("one", |view| view["frames"].as_u64() > Some(3));
    for path in [
        "/v1/sessions/one",
        "/v1/sources/mine",
        "/v1/sources/mine/playback",
        "/v1/sources/mine/control",
        "/v1/sessions/one/shadow",
    ] {
        let tag = strong(&service.get(path));
        let again = service.request("GET", path, &[("if-none-match", &tag)], b"");
        assert_eq!((again.status, again.etag.as_str()), (200, tag.as_str()), "{path}");
        assert_eq!(again.cache, "no-store", "{path}: no cache may ask by itself");
    }
    service.wait_for("one", |view| view["frames"].as_u64() > first["frames"].as_u64());
    // The tag of a list covers its whole text, including frame counts.
    let list = service.get("/v1/sessions");
    let frames = list.json()["items"][0]["frames"].clone();
    service.wait_for("one", |view| view["frames"].as_u64() > frames.as_u64());
    let again = service.request("GET", "/v1/sessions", &[("if-none-match", &strong(&list))], b"");
    assert_eq!(again.status, 200);
    service.stop();
}

#[test]
fn changes_of_running_sessions_check_their_tags() {
    let folder = Folder::new("preconditions");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/sources/mine", &synthetic("fit", 100.0)).expect(201);
    service.put("/v1/sessions/one", &json!({"source": "mine", "model": "spot"})).expect(201);
    service.wait_for("one", |view| view["frames"].as_u64() > Some(3));
    let post = |path: &str, tag: &str, body: &Value| {
        let headers = [("content-type", "application/json"), ("if-match", tag)];
        service.request("POST", path, &headers, body.to_string().as_bytes())
    };
    let delete = |path: &str, tag: &str| service.request("DELETE", path, &[("if-match", tag)], b"");
    let stale = "\"stale\"";

    // A swap changes the session's document.
    let tag = strong(&service.get("/v1/sessions/one"));
    let swap = "/v1/sessions/one/model";
    put(&service, swap, &json!({"model": "gaussian"}), ("if-match", stale)).expect(412);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["requested_model"], "spot");
    let swapped = put(&service, swap, &json!({"model": "gaussian"}), ("if-match", &tag));
    let newer = strong(&swapped);
    assert_eq!(swapped.expect(200)["active_model"], "gaussian");
    assert_eq!(strong(&service.get("/v1/sessions/one")), newer);
    put(&service, swap, &json!({"model": "spot"}), ("if-match", &tag)).expect(412);
    put(&service, swap, &json!({"model": "spot"}), ("if-none-match", "*")).expect(412);

    let shadow = "/v1/sessions/one/shadow";
    put(&service, shadow, &json!({"model": "spot"}), ("if-match", "*")).expect(412);
    let begun = put(&service, shadow, &json!({"model": "spot"}), ("if-none-match", "*"));
    let first = strong(&begun);
    begun.expect(201);
    put(&service, shadow, &json!({"model": "spot"}), ("if-none-match", "*")).expect(412);
    let second = strong(&put(&service, shadow, &json!({"model": "spot"}), ("if-match", &first)));
    assert_ne!(second, first);
    post("/v1/sessions/one/shadow:promote", &first, &Value::Null).expect(412);
    delete(shadow, &first).expect(412);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["active_model"], "gaussian");
    service.wait_for("one", |view| view["shadow"]["frames"].as_u64() > Some(3));
    assert_eq!(post("/v1/sessions/one/shadow:promote", &second, &Value::Null).expect(200)["active_model"], "spot");
    assert_ne!(strong(&service.get("/v1/sessions/one")), newer);

    let scene = "/v1/sources/mine/scene";
    let (tag, source_tag) = (strong(&service.get(scene)), strong(&service.get("/v1/sources/mine")));
    put(&service, scene, &json!({"exposure": 0.5}), ("if-match", stale)).expect(412);
    put(&service, scene, &json!({"exposure": 0.5}), ("if-none-match", "*")).expect(412);
    assert_eq!(service.get(scene).expect(200)["exposure"], 1.0);
    let newer = strong(&put(&service, scene, &json!({"exposure": 0.5}), ("if-match", &tag)));
    assert_eq!(strong(&service.get(scene)), newer);
    put(&service, scene, &json!({"exposure": 0.6}), ("if-match", &tag)).expect(412);
    assert_ne!(strong(&service.get("/v1/sources/mine")), source_tag, "its document shows the scene");

    let playback = "/v1/sources/mine/playback";
    let tag = strong(&service.get(playback));
    put(&service, playback, &json!({"speed": 2}), ("if-match", stale)).expect(412);
    put(&service, playback, &json!({"speed": 2}), ("if-match", &tag)).expect(200);
    put(&service, playback, &json!({"speed": 3}), ("if-match", &tag)).expect(412);
    assert_eq!(service.get(playback).expect(200)["speed"], 2.0);

    let control = "/v1/sources/mine/control";
    let mine = json!({"owner": "me", "timeout_s": 600});
    assert_eq!(service.get(control).etag, "", "nobody has a lease");
    put(&service, control, &mine, ("if-match", "*")).expect(412);
    let taken = put(&service, control, &mine, ("if-none-match", "*"));
    let (tag, lease) = (strong(&taken), taken.expect(201)["lease"].as_str().unwrap().to_string());
    let renewal = json!({"owner": "me", "timeout_s": 600, "lease": lease, "exposure": 2});
    put(&service, control, &renewal, ("if-match", stale)).expect(412);
    assert_eq!(service.get(control).expect(200)["last_command"], Value::Null);
    let renewed = strong(&put(&service, control, &renewal, ("if-match", &tag)));
    let at = format!("{control}?lease={lease}");
    delete(&at, &tag).expect(412);
    delete(&at, &renewed).expect(204);

    let recording = "/v1/sessions/one/recording";
    put(&service, recording, &json!({"name": "one"}), ("if-match", "*")).expect(412);
    let begun = put(&service, recording, &json!({"name": "one"}), ("if-none-match", "*"));
    let tag = strong(&begun);
    begun.expect(201);
    put(&service, recording, &json!({"name": "one"}), ("if-none-match", "*")).expect(412);
    assert_eq!(strong(&put(&service, recording, &json!({"name": "one"}), ("if-match", &tag))), tag);
    delete(recording, stale).expect(412);
    service.request("GET", recording, &[("if-match", stale)], b"").expect(412);
    delete(recording, &tag).expect(204);

    let model = "/v1/models/mine";
    let first = strong(&service.put(model, &level(1.0)));
    let second = strong(&service.put(model, &level(2.0)));
    post("/v1/models/mine:rollback", &first, &json!({"version": 1})).expect(412);
    let back = strong(&post("/v1/models/mine:rollback", &second, &json!({"version": 1})));
    assert!(back != first && back != second, "a version that is back is another change");
    service.stop();
}

/// A precondition on a resource without a tag is rejected, not ignored.
#[test]
fn routes_without_tags_refuse_preconditions() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 50.0)).expect(201);
    for (method, path) in [
        ("POST", "/v1/models:check"),
        ("POST", "/v1/models/spot:fit?width=64&height=48"),
        ("POST", "/v1/sessions/one/frames"),
        ("PUT", "/v1/cameras/nobody/controls"),
        ("GET", "/v1/sessions/one/estimates"),
        ("GET", "/v1/cameras"),
        ("GET", "/livez"),
    ] {
        for (name, value) in [("if-match", "\"1\""), ("if-match", "*"), ("if-none-match", "\"1\"")] {
            let headers = [("content-type", "application/json"), (name, value)];
            let problem = service.request(method, path, &headers, b"{}").expect(400);
            assert!(problem["detail"].as_str().unwrap().contains("no ETag"), "{method} {path}: {problem}");
        }
    }
    service.stop();
}

#[test]
fn tags_of_documents_survive_a_restart_and_change_with_them() {
    let folder = Folder::new("preconditions-restart");
    let service = Running::start_with(Some(&folder.0), false);
    for (path, first, _) in documents() {
        service.put(path, &first).expect(201);
    }
    let tags = |service: &Running| documents().map(|(path, ..)| strong(&service.get(path)));
    let before = tags(&service);
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    assert_eq!(tags(&service), before);
    for ((path, _, second), tag) in documents().into_iter().zip(before) {
        put(&service, path, &second, ("if-match", &tag)).expect(200);
        put(&service, path, &second, ("if-match", &tag)).expect(412);
    }
    service.stop();
}

/// The demo is not declared: its tags change with each start.
#[test]
fn the_demo_has_tags_that_change() {
    let service = Running::start_with(None, true);
    let tag = strong(&service.get("/v1/sessions/demo"));
    let swap = |tag: &str, model: &str| {
        put(&service, "/v1/sessions/demo/model", &json!({"model": model, "allow_slow": true}), ("if-match", tag))
    };
    let swapped = swap(&tag, "thesis-spot");
    let newer = strong(&swapped);
    swapped.expect(200);
    swap(&tag, "spot").expect(412);
    let back = strong(&swap(&newer, "spot"));
    assert!(back != tag && back != newer);
    let tag = strong(&service.get("/v1/sources/demo"));
    service.put("/v1/sources/demo/scene", &json!({"exposure": 0.5})).expect(200);
    service.request("DELETE", "/v1/sources/demo", &[("if-match", &tag)], b"").expect(412);
    service.stop();
}
