//! `POST /v1/models/{name}:fit`: fits one image statelessly.

use std::sync::Arc;

use isophote_capture::encode_png;
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Frame, Plane, Tracker, TrackerOptions};
use serde_json::{Value, json};

use crate::client::{Answer, Running, picture};

const RAW: &str = "application/octet-stream";
const PNG: &str = "image/png";

fn post(service: &Running, query: &str, media: &str, body: &[u8]) -> Answer {
    service.request("POST", &format!("/v1/models/spot:fit{query}"), &[("content-type", media)], body)
}

fn centre(estimate: &Value) -> (f64, f64) {
    let number = |name: &str| estimate["parameters"][name].as_f64().unwrap();
    (number("bx"), number("by"))
}

fn assert_near((x, y): (f64, f64), (wanted_x, wanted_y): (f64, f64)) {
    assert!((x - wanted_x).abs() < 0.1 && (y - wanted_y).abs() < 0.1, "{x}, {y}: not {wanted_x}, {wanted_y}");
}

/// The tracker's result in a frame of 64 × 48 px without a service.
fn offline(pixels: &[u8]) -> Value {
    let text = std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap();
    let model = Arc::new(Model::from_toml(&text).unwrap());
    let compiled = Arc::new(Compiled::new(model.clone(), Precision::F32).unwrap());
    let frame = Frame::new(&[64, 48], vec![Plane::owned(PixelFormat::U8, pixels.to_vec(), 64)]).unwrap();
    let estimate = Tracker::new(compiled, TrackerOptions::default()).unwrap().track(&frame);
    let named = model.parameters().iter().zip(&estimate.parameters);
    named.map(|(parameter, value)| (parameter.name.clone(), json!(value))).collect::<serde_json::Map<_, _>>().into()
}

#[test]
fn images_are_fitted_as_in_a_session_and_nothing_is_kept() {
    let service = Running::start();
    let pixels = picture(64, 48, (30.25, 22.5));
    let png = encode_png(64, 48, PixelFormat::U8, &pixels).unwrap();
    let answer = post(&service, "", PNG, &png).expect(200);
    let items = answer["items"].as_array().unwrap();
    assert_eq!(items.len(), 1);
    assert_near(centre(&items[0]), (30.25, 22.5));
    assert_eq!((&items[0]["frame"], &items[0]["state"]), (&json!(0), &json!("tracking")));
    for absent in ["session", "capture_ns", "publish_ns", "file"] {
        assert!(items[0].get(absent).is_none(), "{absent}: {}", items[0]);
    }
    let raw = post(&service, "?width=64&height=48&format=u8", RAW, &pixels).expect(200);
    let [from_png, from_raw] = [&answer, &raw].map(|answer| answer["items"][0]["parameters"].clone());
    assert_eq!(from_png, from_raw, "bit for bit");
    assert_eq!(from_png, offline(&pixels), "bit for bit what `isophote fit` finds");

    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/same", &json!({"source": source, "model": "spot"})).expect(201);
    let pushed = service.request("POST", "/v1/sessions/same/frames", &[("content-type", PNG)], &png).expect(200);
    assert_near(centre(&pushed), centre(&items[0])); // prepares finer sampling beside its fits
    service.delete("/v1/sessions/same").expect(204);
    assert_eq!(service.get("/v1/sessions").expect(200)["items"], json!([]));
    assert_eq!(service.get("/v1/sources").expect(200)["items"], json!([]));
}

/// Depth cameras write infinity for out of range. More images than are fitted concurrently, so that an endless fit
/// would hold up the others.
#[test]
fn images_with_infinite_pixels_are_fitted_without_them() {
    let service = Running::start();
    for spoiled in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::NAN].into_iter().cycle().take(8) {
        let mut values: Vec<f32> = picture(64, 48, (30.25, 22.5)).into_iter().map(f32::from).collect();
        values[5 * 64 + 5] = spoiled;
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let answer = post(&service, "?width=64&height=48&format=f32", RAW, &bytes).expect(200);
        assert_near(centre(&answer["items"][0]), (30.25, 22.5));
    }
}

#[test]
fn queries_accept_session_options() {
    let service = Running::start();
    let mut pixels = picture(160, 64, (40.0, 30.0));
    let second = picture(160, 64, (120.5, 34.25));
    pixels.iter_mut().zip(&second).for_each(|(pixel, other)| *pixel = (*pixel).max(*other));
    let size = "?width=160&height=64";
    let both = post(&service, &format!("{size}&targets=2"), RAW, &pixels).expect(200);
    let mut centres: Vec<_> = both["items"].as_array().unwrap().iter().map(centre).collect();
    centres.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert_eq!(centres.len(), 2);
    assert_near(centres[0], (40.0, 30.0));
    assert_near(centres[1], (120.5, 34.25));
    let right = post(&service, &format!("{size}&window=85,0,75,64&precision=f64"), RAW, &pixels).expect(200);
    assert_near(centre(&right["items"][0]), (120.5, 34.25));
    let near = post(&service, &format!("{size}&start=bx=118,by=33"), RAW, &pixels).expect(200);
    assert_near(centre(&near["items"][0]), (120.5, 34.25));
    // Camera and target are documents.
    let dark = post(&service, &format!("{size}&camera=%7B%22saturation%22:60%7D"), RAW, &pixels).expect(200);
    assert!(dark["items"][0]["saturated"].as_f64().unwrap() > 0.1, "{dark}");
}

#[test]
fn wrong_images_and_queries_are_refused() {
    let service = Running::start();
    let pixels = picture(64, 48, (30.0, 22.0));
    let png = encode_png(64, 48, PixelFormat::U8, &pixels).unwrap();
    let code = |answer: Answer, status| answer.expect(status)["type"].as_str().unwrap().to_string();
    let key = |query: &str| post(&service, query, PNG, &png).expect(422)["diagnostics"][0]["key"].clone();
    assert!(code(post(&service, "", "text/plain", b"x"), 415).ends_with("wrong-type"));
    assert!(code(post(&service, "", RAW, &pixels), 400).ends_with("bad-request"), "raw pixels have no size");
    assert!(code(post(&service, "?size=3", PNG, &png), 400).ends_with("bad-request"));
    assert!(code(post(&service, "", PNG, &png[..300]), 422).ends_with("wrong-document"));
    // Options that do not apply to an image are rejected, not ignored.
    for query in ["?width=5", "?height=48", "?format=u16le"] {
        let problem = post(&service, query, PNG, &png).expect(400);
        assert!(problem["detail"].as_str().unwrap().contains("raw pixels"), "{query}: {problem}");
    }
    post(&service, "?width=64&height=47", RAW, &pixels).expect(413);
    post(&service, "?width=64&height=49", RAW, &pixels).expect(422);
    post(&service, "?width=70000&height=70000", RAW, b"").expect(422);
    assert_eq!(key("?start=bz=1"), "start.bz");
    assert_eq!(key("?window=100,0,10,10"), "window");
    assert_eq!(key("?targets=0"), "options.targets");
    assert_eq!(key("?camera=%7B%22saturation%22:0%7D"), "camera.saturation");
    let nobody = service.request("POST", "/v1/models/nobody:fit", &[("content-type", PNG)], &png);
    assert!(code(nobody, 404).ends_with("unknown-name"));
    // A model with another number of coordinates.
    let line = json!({"name": "line", "coordinates": ["x"], "channels": ["phi"], "parameters": {"v0": {"start": 1.0}}, "model": {"intensity": "v0 + 0*x"}});
    service.put("/v1/models/line", &line).expect(201);
    service.request("POST", "/v1/models/line:fit", &[("content-type", PNG)], &png).expect(422);
    assert_eq!(
        service.get("/metrics").text.lines().find(|l| l.starts_with("isophote_frame_bytes_in_flight")),
        Some("isophote_frame_bytes_in_flight 0")
    );
}
