//! Realtime sources: each frame has its interval as a budget, swaps to slower models are refused, and searches take
//! turns.

use std::fmt::Write;

use serde_json::{Value, json};

use crate::client::{Running, session, synthetic};

/// A spot whose profile is so costly that a fit of it in 640 × 480 px takes about 0.1 s.
pub fn heavy() -> String {
    let profile = (1..=40).map(|i| format!("exp(-{i}*s/20)")).collect::<Vec<_>>().join(" + ");
    format!(
        r#"
name = "heavy"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = {{ start = "centroid.x" }}
by = {{ start = "centroid.y" }}
a1 = {{ start = "extent.xx", min = 0 }}
a2 = {{ start = "extent.xy" }}
a3 = {{ start = "extent.yy", min = 0 }}
v0 = {{ start = "background" }}
v1 = {{ start = "amplitude", min = 0 }}
[roles]
centre = ["bx", "by"]
shape = ["a1", "a2", "a3"]
background = "v0"
brightness = "v1"
[definitions]
s = "a1 * (x - bx)^2 + 2 * a2 * (x - bx) * (y - by) + a3 * (y - by)^2"
[model]
intensity = "v0 + v1 * ({profile}) / 40"
constraint = ["a1*a3 - a2^2 > 0"]
"#
    )
}

/// A shared source of 640 × 480 px whose spot moves at most `step_px` per frame.
pub fn large(pace: &str, rate_hz: f64, step_px: f64) -> Value {
    let angular_hz = step_px * rate_hz / (2.0 * std::f64::consts::PI * 100.0);
    json!({"kind": "synthetic", "model": "spot", "samples": 1, "rate_hz": rate_hz, "pace": pace,
           "set": {"a1": 0.003, "a2": 0.0, "a3": 0.004, "v0": 20, "v1": 150},
           "motion": {"bx": format!("320 + 100*sin(2*pi*{angular_hz}*t)"), "by": format!("240 + 100*cos(2*pi*{angular_hz}*t)")}})
}

fn number(view: &Value, key: &str) -> f64 {
    view[key].as_f64().unwrap_or_else(|| panic!("{key}: {view}"))
}

fn is_tracking(view: &Value) -> bool {
    view["last"]["state"] == "tracking"
}

#[test]
fn swaps_to_slow_models_are_refused() {
    let service = Running::start();
    service.put_text("/v1/models/heavy", "application/toml", &heavy()).expect(201);
    let mut source = large("realtime", 50.0, 1.0);
    (source["width"], source["height"]) = (json!(1000), json!(800));
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let view = service.wait_for("one", is_tracking);
    assert_eq!((number(&view, "frame_budget_ms"), view["search_budget_ms"].is_number()), (20.0, true), "{view}");

    let refused = service.put("/v1/sessions/one/model", &json!({"model": "heavy"})).expect(409);
    assert_eq!(refused["code"], "too-slow", "{refused}");
    let figures = &refused["figures"];
    assert!(number(figures, "fit_ms") > number(figures, "budget_ms"), "{refused}");
    assert_eq!(number(figures, "budget_ms"), 20.0);
    let view = service.wait_for("one", |now| number(now, "frames") > number(&view, "frames"));
    for key in ["model", "active_model", "requested_model"] {
        assert_eq!(view[key], "spot", "{view}");
    }

    // Nor can it be promoted from a shadow.
    service.put("/v1/sessions/one/shadow", &json!({"model": "heavy"})).expect(201);
    let refused = service.request("POST", "/v1/sessions/one/shadow:promote", &[], b"").expect(409);
    assert_eq!(refused["code"], "too-slow", "{refused}");
    assert_eq!(service.delete("/v1/sessions/one/shadow").status, 204);
    assert_eq!(service.get("/v1/sessions/one").expect(200)["requested_model"], "spot");

    // `allow_slow` accepts it: fits end with their best so far, and report it.
    service.put("/v1/sessions/one/model", &json!({"model": "heavy", "allow_slow": true})).expect(200);
    let view = service.wait_for("one", |view| number(view, "over_budget") > 5.0 && view["last"]["ending"] == "budget");
    assert_eq!((&view["active_model"], &view["last"]["converged"]), (&json!("heavy"), &json!(false)), "{view}");
    service.put("/v1/sessions/one/model", &json!({"model": "spot"})).expect(200);
    service.wait_for("one", is_tracking);
    service.stop();
}

/// The session's state does not locate such a model's bumps.
#[test]
fn a_slow_model_that_carries_nothing_over_is_refused() {
    let service = Running::start();
    service.put_text("/v1/models/slow", "application/toml", &crate::bounds::slow()).expect(201);
    let mut source = large("realtime", 30.0, 1.0);
    (source["width"], source["height"]) = (json!(1200), json!(1200));
    let document = json!({"source": source, "model": "spot", "options": {"precision": "f64"}});
    service.put("/v1/sessions/one", &document).expect(201);
    service.wait_for("one", is_tracking);
    let refused = service.put("/v1/sessions/one/model", &json!({"model": "slow"})).expect(409);
    assert_eq!(refused["code"], "too-slow", "{refused}");
    assert_eq!(service.get("/v1/sessions/one").expect(200)["requested_model"], "spot");
    service.stop();
}

/// Eight bumps for one spot: the next fit after a search, which ends at once, loses the result again. Each frame would
/// need a search.
#[test]
fn models_that_lose_the_target_each_frame_are_too_slow() {
    let (mut parameters, mut intensity, mut all) = (String::new(), String::from("0"), Vec::new());
    for bump in 0..8 {
        for (name, start) in [("x", 60 + 70 * bump), ("y", 420 - 50 * bump), ("w", 30 + 5 * bump), ("v", 30)] {
            writeln!(parameters, "{name}{bump} = {{ start = {start} }}").unwrap();
            all.push(format!("\"{name}{bump}\""));
        }
        write!(intensity, " + v{bump} * exp(-((x - x{bump})^2 + (y - y{bump})^2) / w{bump}^2)").unwrap();
    }
    let text = format!(
        "name = \"bumps\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}[model]\n\
         intensity = \"{intensity}\"\n[[stages]]\nparameters = [{}]\nmethod = \"newton\"\niterations = 100\n",
        all.join(", ")
    );
    let service = Running::start();
    service.put_text("/v1/models/bumps", "application/toml", &text).expect(201);
    let mut source = large("realtime", 30.0, 3.0);
    (source["full_well_e"], source["read_noise_e"]) = (json!(5000), json!(15));
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    service.wait_for("one", is_tracking);
    for number in 0..6 {
        let refused = service.put("/v1/sessions/one/model", &json!({"model": "bumps"})).expect(409);
        assert_eq!(refused["code"], "too-slow", "{number}: {refused}");
        let figures = &refused["figures"];
        assert!(self::number(figures, "fit_ms") > 100.0, "{number}: {refused}");
    }
    assert_eq!(service.get("/v1/sessions/one").expect(200)["active_model"], "spot");
    service.stop();
}

#[test]
fn a_session_may_allow_slow_models_and_frames_that_wait_have_no_budget() {
    let service = Running::start();
    service.put_text("/v1/models/heavy", "application/toml", &heavy()).expect(201);
    let options = json!({"allow_slow": true});
    let document = json!({"source": large("realtime", 100.0, 1.0), "model": "spot", "options": options});
    assert_eq!(service.put("/v1/sessions/slow", &document).expect(201)["options"]["allow_slow"], true);
    service.wait_for("slow", is_tracking);
    service.put("/v1/sessions/slow/model", &json!({"model": "heavy"})).expect(200);
    service.delete("/v1/sessions/slow").expect(204);

    let document = json!({"source": large("fit", 100.0, 1.0), "model": "spot"});
    service.put("/v1/sessions/waits", &document).expect(201);
    let view = service.wait_for("waits", is_tracking);
    assert!(view["frame_budget_ms"].is_null() && view["search_budget_ms"].is_null(), "{view}");
    service.put("/v1/sessions/waits/model", &json!({"model": "heavy"})).expect(200);
    let since = number(&service.get("/v1/sessions/waits").expect(200), "frames");
    let view = service.wait_for("waits", |view| number(view, "frames") > since + 1.0);
    assert_eq!(view["dropped"], 0, "{view}");
    service.put("/v1/sessions/waits/model", &json!({"model": "spot", "allow_slow": 1})).expect(422);
    service.stop();
}

const SESSIONS: usize = 16;

/// Starts sessions on one source; a busy machine may lack the capacity for all of them.
fn crowd(service: &Running, source: &Value) -> Vec<String> {
    service.put("/v1/sources/shared", source).expect(201);
    let names = (0..SESSIONS).map(|number| format!("s{number}"));
    let is_there = |name: &String| {
        let document = json!({"source": "shared", "model": "spot"});
        let answer = service.put(&format!("/v1/sessions/{name}"), &document);
        match answer.status {
            201 => true,
            _ => answer.expect(429)["code"] == "over-capacity" && name != "s0",
        }
    };
    names.filter(is_there).filter(|name| service.get(&format!("/v1/sessions/{name}")).status == 200).collect()
}

/// Waits until all track, and prints the frames dropped in the next two seconds.
fn wait_until_tracking(service: &Running, what: &str, names: &[String]) {
    let begin = std::time::Instant::now();
    let tracking: Vec<Value> = names.iter().map(|name| service.wait_for(name, is_tracking)).collect();
    eprintln!("{what}: {} sessions track after {:?}", names.len(), begin.elapsed());
    let (mut frames, mut dropped) = (0.0, 0.0);
    for (name, before) in names.iter().zip(&tracking) {
        let is_later = |now: &Value| {
            number(now, "frames") + number(now, "dropped")
                >= number(before, "frames") + number(before, "dropped") + 120.0
        };
        let now = service.wait_for(name, is_later);
        frames += number(&now, "frames") - number(before, "frames");
        dropped += number(&now, "dropped") - number(before, "dropped");
        assert!(number(&now, "searches") <= number(&now, "frames") && now["searches_postponed"].is_u64(), "{now}");
    }
    eprintln!("{what}: then {frames} frames fitted, {dropped} dropped");
}

/// All start with a search of the whole frame, while their targets move on.
#[test]
fn sessions_search_in_turn_and_all_of_them_find_their_targets() {
    let service = Running::start();
    let mut names = crowd(&service, &large("realtime", 60.0, 8.0));
    wait_until_tracking(&service, "640 × 480 px, 8 px a frame", &names);
    for name in names.split_off(names.len() / 2) {
        service.delete(&format!("/v1/sessions/{name}")).expect(204);
    }
    wait_until_tracking(&service, "after half of them have gone", &names);
    service.stop();
}

#[test]
fn sessions_of_small_frames_keep_their_rate() {
    let service = Running::start();
    let mut source = synthetic("realtime", 60.0);
    source["height"] = json!(64);
    let names = crowd(&service, &source);
    wait_until_tracking(&service, "64 × 64 px", &names);
    service.stop();
}

/// Trials use the last frame shown before the source was paused.
#[test]
fn session_costs_are_known_while_the_source_is_paused() {
    let service = Running::start();
    service.put_text("/v1/models/heavy", "application/toml", &heavy()).expect(201);
    let mut source = large("realtime", 1000.0, 0.1);
    (source["width"], source["height"]) = (json!(1000), json!(800));
    service.put("/v1/sources/fast", &source).expect(201);
    service.put("/v1/sessions/first", &json!({"source": "fast", "model": "thesis-spot"})).expect(201);
    service.wait_for("first", is_tracking);
    service.put("/v1/sources/fast/playback", &json!({"paused": true})).expect(200);
    let refused = service.put("/v1/sessions/first/model", &json!({"model": "heavy"})).expect(409);
    assert_eq!(refused["code"], "too-slow", "{refused}");
    // The second swap is tried on that frame as well, though its model has found nothing in it.
    service.put("/v1/sessions/first/model", &json!({"model": "spot"})).expect(200);
    service.put("/v1/sessions/first/model", &json!({"model": "heavy"})).expect(409);
    service.put("/v1/sessions/first/model", &json!({"model": "thesis-spot"})).expect(200);
    // None of them has fitted a frame: each counts with the cost of its trial.
    let put = |number: usize| {
        service.put(&format!("/v1/sessions/more-{number}"), &json!({"source": "fast", "model": "thesis-spot"}))
    };
    let refused = (0..60).map(put).find(|answer| answer.status != 201).unwrap().expect(429);
    assert_eq!(refused["code"], "over-capacity", "{refused}");
    service.stop();
}

#[test]
fn source_costs_count_towards_capacity() {
    let service = Running::start();
    // Its fits cost little compared with rendering its frames.
    let own = json!({"source": large("realtime", 250.0, 0.1), "model": "thesis-spot"});
    let refused = (0..40).find_map(|number| {
        let answer = service.put(&format!("/v1/sessions/own-{number}"), &own);
        if answer.status == 429 {
            return Some(answer.expect(429));
        }
        answer.expect(201);
        service.wait_for(&format!("own-{number}"), |view| {
            view["cost_ms"].is_number() && self::number(view, "frames") > 3.0
        });
        None
    });
    let refused = refused.unwrap();
    assert_eq!(refused["code"], "over-capacity", "{refused}");
    let figures = &refused["figures"];
    assert!(number(figures, "load") > number(figures, "capacity"), "{refused}");
    service.stop();
}

#[test]
fn sessions_over_capacity_are_refused() {
    let service = Running::start();
    let mut source = large("realtime", 1000.0, 0.1);
    (source["width"], source["height"]) = (json!(1000), json!(800));
    service.put("/v1/sources/fast", &source).expect(201);
    service.put("/v1/sessions/witness", &session("realtime", 30.0)).expect(201);
    // No frame has been shown yet, so their cost is unknown.
    service.put("/v1/sessions/first", &json!({"source": "fast", "model": "thesis-spot"})).expect(201);
    // However fast the machine, some are too many.
    let refused = (0..100).find_map(|number| {
        service.wait_for("first", |view| view["cost_ms"].is_number() && is_tracking(view));
        let path = format!("/v1/sessions/more-{number}");
        let answer = service.put(&path, &json!({"source": "fast", "model": "thesis-spot"}));
        if answer.status == 429 {
            service.get(&path).expect(404);
            return Some(answer.expect(429));
        }
        answer.expect(201);
        service.wait_for(&format!("more-{number}"), |view| view["cost_ms"].is_number());
        None
    });
    let refused = refused.unwrap();
    assert_eq!(refused["code"], "over-capacity", "{refused}");
    let figures = &refused["figures"];
    let wanted = figures["fit_ms"].as_f64().map_or(0.0, |fit_ms| fit_ms * number(figures, "rate_hz") / 1e3);
    assert!(number(figures, "load") + wanted.min(1.0) > number(figures, "capacity"), "{refused}");
    // Sources in pace `fit` use the remaining capacity.
    service.put("/v1/sessions/waits", &json!({"source": synthetic("fit", 1000.0), "model": "spot"})).expect(201);
    let frames = number(&service.get("/v1/sessions/witness").expect(200), "frames");
    service.wait_for("witness", |view| number(view, "frames") > frames && is_tracking(view));
    service.stop();
}
