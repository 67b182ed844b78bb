//! Exposure: advice in every estimate, and sessions that apply it.

use serde_json::{Value, json};

use crate::client::{Running, session};

/// A session whose source shows a spot of that height on a background of a twentieth of it.
fn document(height: f64, goal: &str, control: bool) -> Value {
    let mut document = session("fit", 0.0);
    document["source"]["set"]["v0"] = json!(0.05 * height);
    document["source"]["set"]["v1"] = json!(height);
    document["source"]["full_well_e"] = json!(5000);
    document["source"]["read_noise_e"] = json!(15);
    document["options"] = json!({"exposure": {"goal": goal, "control": control}});
    document
}

/// The saturated share of the outline: the domain of models/spot.toml is 2.2 outlines large.
fn share(estimate: &Value) -> f64 {
    2.2 * estimate["saturated"].as_f64().unwrap()
}

#[test]
fn exposure_control_converges_to_the_best_exposure_of_the_centre() {
    let service = Running::start();
    for height in [560.0, 2.0] {
        service.put("/v1/sessions/one", &document(height, "centre", true)).expect(201);
        let mut socket = service.socket("one", "mode=all");
        let mut last = Value::Null;
        let mut changes = 0;
        loop {
            let estimate = socket.next().unwrap();
            let frame = estimate["frame"].as_u64().unwrap();
            if (20..60).contains(&frame) {
                assert_eq!(estimate["state"], "tracking", "{estimate}");
                assert!((0.1..0.32).contains(&share(&estimate)), "{height}: {estimate}");
                let light = |estimate: &Value| estimate["truth"]["v1"].as_f64().unwrap();
                changes += usize::from(!last.is_null() && light(&last) != light(&estimate));
                last = estimate;
            } else if frame >= 60 {
                break;
            }
        }
        assert!(changes <= 2, "{height}: it holds still, {changes}");
        assert_eq!(service.delete("/v1/sessions/one").status, 204);
    }
}

#[test]
fn advice_depends_on_the_goal() {
    let service = Running::start();
    let mut factors = Vec::new();
    for goal in ["centre", "brightness"] {
        service.put("/v1/sessions/one", &document(120.0, goal, false)).expect(201);
        let view = service.wait_for("one", |view| view["last"]["exposure_advice"].is_object());
        let advice = &view["last"]["exposure_advice"];
        assert_eq!(advice["goal"], goal);
        assert!(advice["why"].as_str().unwrap().contains("saturated"), "{advice}");
        assert_eq!(view["last"]["truth"]["v1"], 120.0, "nobody touches the exposure");
        factors.push(advice["factor"].as_f64().unwrap());
        assert_eq!(service.delete("/v1/sessions/one").status, 204);
    }
    assert!(factors[0] > factors[1] && factors[1] > 1.2, "{factors:?}");
}

#[test]
fn sources_without_exposure_are_rejected() {
    let service = Running::start();
    let pushed = json!({"source": {"kind": "pushed", "width": 64, "height": 64}, "model": "spot",
                        "options": {"exposure": {"control": true}}});
    let problem = service.put("/v1/sessions/one", &pushed).expect(422);
    assert_eq!(problem["diagnostics"][0]["key"], "options.exposure.control");
}

#[test]
fn models_without_exposure_advice_are_rejected() {
    let service = Running::start();
    let source = json!({"kind": "synthetic", "model": "three-spots-raw", "width": 64, "height": 64, "pace": "fit"});
    let document = |control: bool| json!({"source": source, "model": "three-spots", "options": {"exposure": {"control": control}}});
    let problem = service.put("/v1/sessions/one", &document(true)).expect(422);
    let fault = &problem["diagnostics"][0];
    assert_eq!(fault["key"], "options.exposure.control");
    assert!(fault["message"].as_str().unwrap().contains("not mixed"), "{problem}");
    service.put("/v1/sessions/one", &document(false)).expect(201);
}

/// Documents without a stated domain, with several targets, several channels or a pose: sessions control their
/// exposure, or are refused.
#[test]
fn sessions_with_exposure_control_get_advice() {
    let service = Running::start();
    let spots = json!({"xr": 100, "yr": 60, "xg": 40, "yg": 110, "xb": 160, "yb": 110});
    for (model, set) in [
        ("gaussian-pixel", json!({"bx": 80, "by": 60, "wx": 9, "wy": 7, "v0": 10, "v1": 60})),
        ("spot-lobe", json!({"bx": 80, "by": 60, "a1": 0.004, "a3": 0.004, "v0": 10, "v1": 60, "lh": 20})),
        ("profile-1d", json!({"b": 80, "w": 9, "v0": 10, "v1": 60})),
        ("three-spots-raw", spots),
        ("spot-pose", json!({"tz": 1000})),
    ] {
        let mut source = json!({"kind": "synthetic", "model": model, "set": set, "pace": "fit", "full_well_e": 5000, "read_noise_e": 15});
        match model {
            "profile-1d" => source["width"] = json!(200),
            "spot-pose" => (source["width"], source["height"]) = (json!(640), json!(480)),
            _ => (source["width"], source["height"]) = (json!(200), json!(150)),
        }
        let options = json!({"exposure": {"goal": "brightness", "control": true}, "allow_slow": true});
        service.put("/v1/sessions/one", &json!({"source": source, "model": model, "options": options})).expect(201);
        let view = service.wait_for("one", |view| view["last"]["exposure_advice"].is_object());
        assert_eq!(view["last"]["state"], "tracking", "{model}: {view}");
        assert_eq!(service.delete("/v1/sessions/one").status, 204);
    }
    let source = json!({"kind": "synthetic", "model": "blob-4d", "width": 24, "height": 24, "pace": "fit"});
    let document =
        json!({"source": source, "model": "blob-4d", "options": {"exposure": {"goal": "centre", "control": true}}});
    let problem = service.put("/v1/sessions/one", &document).expect(422);
    assert_eq!(problem["diagnostics"][0]["key"], "options.exposure.control", "{problem}");
}
