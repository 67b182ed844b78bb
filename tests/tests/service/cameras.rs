//! Camera requests on a machine without cameras, or whose cameras must not be touched: wrong requests are rejected.

use serde_json::{Value, json};

use crate::client::Running;

fn session(source: &Value) -> Value {
    json!({"source": source, "model": "spot"})
}

#[test]
fn missing_cameras_are_refused_at_their_key() {
    let service = Running::start();
    let cases = [
        (json!({"kind": "camera", "device": "/dev/video-none"}), "source.device", "there is no camera"),
        (json!({"kind": "camera", "device": "no-such-camera-0001"}), "source.device", "there is no camera"),
        (json!({"kind": "camera", "device": "/dev/zero"}), "source.device", "isophote cameras"),
        (json!({"kind": "camera", "device": "/dev/zero", "width": 640}), "source", "height is missing"),
        (json!({"kind": "camera", "device": "/dev/zero", "rate_hz": -1.0}), "source.rate_hz", "above 0"),
    ];
    for (source, key, message) in cases {
        let problem = service.put("/v1/sessions/one", &session(&source)).expect(422);
        let diagnostic = &problem["diagnostics"][0];
        assert_eq!(diagnostic["key"], key, "{problem}");
        assert!(diagnostic["message"].as_str().unwrap().contains(message), "{problem}");
    }
    for wrong in [json!({"kind": "camera"}), json!({"kind": "camera", "device": "/dev/zero", "colour": "pink"})] {
        service.put("/v1/sessions/one", &session(&wrong)).expect(422);
    }
    assert_eq!(service.get("/v1/sessions/one").status, 404);
}

#[test]
fn cameras_are_listed_and_asked_by_name() {
    let service = Running::start();
    let cameras = service.get("/v1/cameras").expect(200);
    assert!(cameras["items"].is_array(), "{cameras}");
    assert_eq!(service.get("/v1/cameras/no-such-camera-0001").expect(404)["code"], "unknown-name");
    assert_eq!(service.get("/v1/cameras/%2Fdev%2Fzero").status, 404);
    service.put("/v1/cameras/no-such-camera-0001/controls", &json!({"gain": 1})).expect(404);
    service.put("/v1/cameras/no-such-camera-0001/controls", &json!({"gain": [1]})).expect(422);
}
