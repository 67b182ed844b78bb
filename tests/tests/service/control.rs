//! Leases: one session or client at a time controls a source.

use std::time::Instant;

use serde_json::{Value, json};

use crate::client::{DEADLINE, Running, synthetic};

const CONTROL: &str = "/v1/sources/lamp/control";

/// A source that loses no frame, and a session that only observes it.
fn start_lamp(service: &Running) {
    let mut source = synthetic("fit", 200.0);
    (source["full_well_e"], source["read_noise_e"]) = (json!(5000), json!(15));
    service.put("/v1/sources/lamp", &source).expect(201);
    service.put("/v1/sessions/eye", &json!({"source": "lamp", "model": "spot"})).expect(201);
}

/// A session that sets the exposure as it advises.
fn controlling(service: &Running, name: &str) {
    let options = json!({"exposure": {"goal": "brightness", "control": true}});
    let document = json!({"source": "lamp", "model": "spot", "options": options});
    service.put(&format!("/v1/sessions/{name}"), &document).expect(201);
}

fn lease_of(view: &Value) -> String {
    let id = view["lease"].as_str().unwrap();
    assert_eq!(id.len(), 32, "{view}");
    id.to_string()
}

/// Polls until the condition holds.
fn wait_for(service: &Running, is_so: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let view = service.get(CONTROL).expect(200);
        if is_so(&view) {
            return view;
        }
        assert!(begin.elapsed() < DEADLINE, "{view}");
        std::thread::yield_now();
    }
}

#[test]
fn one_client_at_a_time_has_the_lease() {
    let service = Running::start();
    start_lamp(&service);
    let mut socket = service.socket("eye", "mode=all");
    socket.next().unwrap();
    assert_eq!(service.get(CONTROL).expect(200), json!({}));
    let first = service.put(CONTROL, &json!({"owner": "agc", "timeout_s": 600, "exposure": 1.5})).expect(201);
    assert_eq!((&first["owner"], &first["last_command"]), (&json!("agc"), &json!({"exposure": 1.5})), "{first}");
    assert!((590.0..=600.0).contains(&first["expires_in_s"].as_f64().unwrap()), "{first}");
    let (lease, since) = (lease_of(&first), first["since_frame"].as_u64().unwrap());
    let light = loop {
        let estimate = socket.next().unwrap();
        let (frame, light) = (estimate["frame"].as_u64().unwrap(), estimate["truth"]["v1"].as_f64().unwrap());
        // A frame begun in between may show it.
        assert!(frame + 1 >= since || light == 150.0, "{frame} of {since}: {light}");
        if frame >= since {
            break light;
        }
    };
    assert_eq!(light, 225.0);
    // Other clients learn the owner and the remaining time, whatever they call themselves.
    for owner in ["other", "agc"] {
        let problem = service.put(CONTROL, &json!({"owner": owner, "exposure": 0.5})).expect(409);
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains("`agc`") && detail.contains(" s"), "{problem}");
    }
    service.put(CONTROL, &json!({"owner": "agc", "lease": "0".repeat(32), "exposure": 0.5})).expect(409);
    assert_eq!(service.delete(CONTROL).status, 409);
    assert_eq!(service.delete(&format!("{CONTROL}?lease=1")).status, 409);
    let renewed = service.put(CONTROL, &json!({"owner": "agc", "lease": lease, "timeout_s": 60})).expect(200);
    assert_eq!(
        (&renewed["last_command"], &renewed["since_frame"]),
        (&json!({"exposure": 1.5}), &json!(since)),
        "{renewed}"
    );
    let view = service.get(CONTROL).expect(200);
    assert!(view.get("lease").is_none() && view["owner"] == "agc", "its id is its own: {view}");
    assert_eq!(service.get("/v1/sources/lamp").expect(200)["control"]["owner"], "agc");
    // Settings persist after the lease is released.
    assert_eq!(service.delete(&format!("{CONTROL}?lease={lease}")).status, 204);
    assert_eq!(service.delete(&format!("{CONTROL}?lease={lease}")).status, 404);
    let view = service.get(CONTROL).expect(200);
    assert_eq!(view, json!({"last_command": {"exposure": 1.5}, "since_frame": since}));
    assert!(service.get("/v1/sources/lamp").expect(200).get("control").is_none());
    let light = |estimate: &Value| estimate["truth"]["v1"].as_f64();
    assert_eq!(light(&socket.next().unwrap()), Some(225.0));
    service.stop();
}

#[test]
fn expired_leases_change_nothing() {
    let service = Running::start();
    start_lamp(&service);
    let first = service.put(CONTROL, &json!({"owner": "one", "timeout_s": 0.1, "exposure": 2})).expect(201);
    wait_for(&service, |view| view.get("owner").is_none());
    let late = json!({"owner": "one", "lease": lease_of(&first), "exposure": 4});
    let problem = service.put(CONTROL, &late).expect(409);
    assert!(problem["detail"].as_str().unwrap().contains("run out"), "{problem}");
    let second = service.put(CONTROL, &json!({"owner": "two", "timeout_s": 600, "exposure": 0.5})).expect(201);
    assert!(service.put(CONTROL, &late).expect(409)["detail"].as_str().unwrap().contains("`two`"));
    assert_eq!(service.delete(&format!("{CONTROL}?lease={}", lease_of(&first))).status, 409);
    let since = second["since_frame"].as_u64().unwrap();
    let view = service.wait_for("eye", |view| view["last"]["frame"].as_u64() > Some(since));
    assert_eq!(view["last"]["truth"]["v1"], 75.0, "{view}");
    service.stop();
}

#[test]
fn second_controlling_sessions_wait() {
    let service = Running::start();
    start_lamp(&service);
    controlling(&service, "first");
    service.wait_for("first", |view| view["exposure_control"]["held"] == true);
    let view = wait_for(&service, |view| view["last_command"].is_object());
    assert_eq!(view["owner"], "session `first`", "{view}");
    assert!(view.get("expires_in_s").is_none(), "{view}");
    controlling(&service, "second");
    let second = service.wait_for("second", |view| view["exposure_control"]["held"] == false);
    assert!(second["exposure_control"]["reason"].as_str().unwrap().contains("session `first`"), "{second}");
    assert_eq!(second["state"], "running");
    let problem = service.put(CONTROL, &json!({"owner": "client", "exposure": 9})).expect(409);
    assert!(problem["detail"].as_str().unwrap().contains("session `first`"), "{problem}");
    assert!(service.get("/v1/sessions/eye").expect(200).get("exposure_control").is_none());
    assert_eq!(service.delete("/v1/sessions/first").status, 204);
    service.wait_for("second", |view| view["exposure_control"]["held"] == true);
    assert_eq!(service.get(CONTROL).expect(200)["owner"], "session `second`");
    service.stop();
}

#[test]
fn sessions_wait_for_a_client_and_continue_from_its_exposure() {
    let service = Running::start();
    start_lamp(&service);
    let lease = service.put(CONTROL, &json!({"owner": "client", "timeout_s": 600, "exposure": 0.25})).expect(201);
    controlling(&service, "one");
    let view =
        service.wait_for("one", |view| view["exposure_control"].is_object() && view["frames"].as_u64() > Some(10));
    assert_eq!(view["exposure_control"]["held"], false, "{view}");
    assert!(view["exposure_control"]["reason"].as_str().unwrap().contains("`client`"), "{view}");
    let since = lease["since_frame"].as_u64().unwrap();
    let dark = service.wait_for("one", |view| view["last"]["frame"].as_u64() > Some(since + 5));
    assert_eq!(dark["last"]["truth"]["v1"], 37.5, "it only looks: {dark}");
    service.delete(&format!("{CONTROL}?lease={}", lease_of(&lease)));
    service.wait_for("one", |view| view["last"]["truth"]["v1"].as_f64() > Some(75.0));
    service.stop();
}

#[test]
fn uncontrollable_sources_are_rejected() {
    let service = Running::start();
    start_lamp(&service);
    let wrong = [
        (json!({"owner": ""}), 422, "owner"),
        (json!({"owner": "x".repeat(65)}), 422, "owner"),
        (json!({"owner": "a\nb"}), 422, "owner"),
        (json!({"owner": "a", "timeout_s": 0}), 422, "timeout_s"),
        (json!({"owner": "a", "timeout_s": 1e9}), 422, "timeout_s"),
        (json!({"owner": "a", "exposure": 0}), 422, "exposure"),
        (json!({"owner": "a", "exposure": 1e6}), 422, "exposure"),
        (json!({"owner": "a", "gain": 3}), 422, "gain"),
        (json!({"exposure": 2}), 422, ""),
        (json!({"owner": "a", "controls": {"gain": 3}}), 409, "only cameras"),
    ];
    for (document, status, what) in wrong {
        let problem = service.put(CONTROL, &document).expect(status);
        match status {
            422 => assert_eq!(problem["diagnostics"][0]["key"], what, "{problem}"),
            _ => assert!(problem["detail"].as_str().unwrap().contains(what), "{problem}"),
        }
        assert_eq!(service.get(CONTROL).expect(200), json!({}), "nobody has it: {document}");
    }
    service.put("/v1/sources/pushed", &json!({"kind": "pushed", "width": 64, "height": 48})).expect(201);
    for method in ["GET", "PUT", "DELETE"] {
        let ask =
            |path: &str| service.request(method, path, &[("content-type", "application/json")], br#"{"owner": "a"}"#);
        let problem = ask("/v1/sources/pushed/control").expect(409);
        assert!(problem["detail"].as_str().unwrap().contains("nothing to control"), "{problem}");
        ask("/v1/sources/absent/control").expect(404);
    }
    service.stop();
}
