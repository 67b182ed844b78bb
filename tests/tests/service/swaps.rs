//! Hot swaps happen between two frames, without lost or mixed ones.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::client::{Running, names, session};

const SWAPS: usize = 1000;

#[test]
fn thousand_swaps_lose_and_mix_no_frames() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 2000.0)).expect(201);
    let models = ["gaussian", "spot"];
    let parameters: BTreeMap<String, Vec<String>> = models
        .iter()
        .map(|name| {
            let document = service.get(&format!("/v1/models/{name}")).expect(200);
            let id = format!("{name}@{}", document["digest"].as_str().unwrap());
            (id, names(&document["parameters"]))
        })
        .collect();
    assert_ne!(parameters.values().next(), parameters.values().last(), "the test needs two parameter sets");

    let mut socket = service.socket("one", "mode=all");
    let first = socket.next().unwrap();
    let (last_frame, until) = std::sync::mpsc::sync_channel::<u64>(1);
    let reader = std::thread::Builder::new().name("reader".into()).spawn(move || {
        let mut estimates = vec![first];
        let mut last = u64::MAX;
        while estimates.last().unwrap()["frame"].as_u64().unwrap() < last {
            estimates.push(socket.next().unwrap());
            last = until.try_recv().unwrap_or(last);
        }
        estimates
    });
    let reader = reader.unwrap();
    // promised model by first frame number
    let mut promised = vec![(0, "spot".to_string())];
    for swap in 0..SWAPS {
        let model = models[swap % 2];
        let answer = service.put("/v1/sessions/one/model", &json!({"model": model})).expect(200);
        assert_eq!((&answer["requested_model"], &answer["active_model"]), (&json!(model), &json!(model)));
        assert!(answer["compile_ms"].is_number() && answer["carried"].is_array() && answer["reset"].is_array());
        promised.push((answer["active_since_frame"].as_u64().unwrap(), model.to_string()));
    }
    let view = service.wait_for("one", |view| view["last"]["frame"].as_u64().unwrap() > promised[SWAPS].0);
    assert_eq!((&view["active_since_frame"], &view["model"]), (&json!(promised[SWAPS].0), &json!(models[1])));
    last_frame.send(view["last"]["frame"].as_u64().unwrap()).unwrap();
    let estimates: Vec<Value> = reader.join().unwrap();

    let mut used: BTreeMap<&str, usize> = BTreeMap::new();
    for pair in estimates.windows(2) {
        let (before, after) = (pair[0]["frame"].as_u64().unwrap(), pair[1]["frame"].as_u64().unwrap());
        assert_eq!((after, &pair[1]["dropped"]), (before + 1, &json!(0)), "a frame is missing");
    }
    for estimate in &estimates {
        let (frame, id) = (estimate["frame"].as_u64().unwrap(), estimate["model"].as_str().unwrap());
        let (_, name) = promised.iter().rev().find(|(since, _)| *since <= frame).unwrap();
        assert_eq!(id.split('@').next().unwrap(), name, "frame {frame} was promised to {name}");
        let known = &parameters[id];
        if estimate["state"] == "tracking" {
            assert_eq!(&names(&estimate["parameters"]), known, "frame {frame}");
        } else {
            assert!(names(&estimate["parameters"]).iter().all(|name| known.contains(name)), "frame {frame}");
        }
        assert!(
            estimate["order"]
                .as_array()
                .unwrap()
                .iter()
                .all(|name| known.contains(&name.as_str().unwrap().to_string()))
        );
        *used.entry(name).or_default() += 1;
    }
    assert!(used.values().all(|frames| *frames > SWAPS / 20), "{used:?}");
}

#[test]
fn shared_parameters_are_carried() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    service.wait_for("one", |view| view["last"]["state"] == "tracking");
    let answer = service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})).expect(200);
    let carried: Vec<&str> = answer["carried"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    assert!(carried.contains(&"bx") && carried.contains(&"by"), "{answer}");
    let since = answer["active_since_frame"].as_u64().unwrap();
    let view = service.wait_for("one", |view| view["last"]["frame"].as_u64().unwrap() >= since);
    assert!(view["last"]["model"].as_str().unwrap().starts_with("gaussian@sha256:"), "{view}");
    assert_eq!(view["last"]["state"], "tracking");
}

#[test]
fn wrong_swaps_keep_the_running_model() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    for (document, status) in [
        (json!({"model": "nobody"}), 404),
        (json!({"model": "profile-1d"}), 409),
        (json!({"model": 3}), 422),
        (json!({"model": "spot", "when": "now"}), 422),
        (json!({}), 422),
    ] {
        service.put("/v1/sessions/one/model", &document).expect(status);
    }
    service.put("/v1/sessions/nobody/model", &json!({"model": "spot"})).expect(404);
    let before = service.wait_for("one", |view| view["frames"].as_u64().unwrap() > 0);
    assert_eq!((&before["requested_model"], &before["active_model"]), (&json!("spot"), &json!("spot")));
    assert_eq!(before["active_since_frame"], 0);
    service.wait_for("one", |view| view["frames"].as_u64() > before["frames"].as_u64());
}

#[test]
fn swaps_in_flight_are_ordered() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 200.0)).expect(201);
    let put = |model: &str| {
        service.put("/v1/sessions/one/model", &json!({"model": model})).expect(200)["active_since_frame"]
            .as_u64()
            .unwrap()
    };
    // each of four clients swaps to its own model; the session ends up with the one active since the last frame
    let mut answers: Vec<(u64, &str)> = std::thread::scope(|scope| {
        let swaps: Vec<_> = ["gaussian", "rational-spot", "spot", "dark-disc"]
            .map(|model| scope.spawn(move || (0..10).map(|_| (put(model), model)).collect::<Vec<_>>()))
            .into_iter()
            .collect();
        swaps.into_iter().flat_map(|swap| swap.join().unwrap()).collect()
    });
    answers.sort_unstable();
    let view = service.get("/v1/sessions/one").expect(200);
    let last = answers.last().unwrap().0;
    assert_eq!(view["active_since_frame"], last);
    assert_eq!(view["requested_model"], view["active_model"]);
    assert!(answers.iter().any(|(since, model)| *since == last && view["active_model"] == *model), "{view}");
}
