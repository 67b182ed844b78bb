//! Sessions with several targets, confidence and prediction.

use serde_json::{Value, json};

use crate::client::{Running, session};

/// Two discs with soft rims on 200 × 120 px.
fn frame(number: u32) -> Vec<u8> {
    let step = f64::from(number);
    let spots = [(50.0 + step, 60.0), (150.0 - step, 70.0)];
    let pixel = |i: u32| {
        let (x, y) = (f64::from(i % 200), f64::from(i / 200));
        let light = |(cx, cy): (f64, f64)| {
            let s = ((x - cx) / 16.0).powi(2) + ((y - cy) / 12.0).powi(2);
            if s < 1.0 { 120.0 * (1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s) } else { 0.0 }
        };
        let grain = f64::from((i * 7919 + number * 104_729) % 5) - 2.0;
        (20.0 + grain + light(spots[0]) + light(spots[1])).round() as u8
    };
    (0..200 * 120).map(pixel).collect()
}

#[test]
fn targets_keep_their_names() {
    let service = Running::start();
    let document =
        json!({"source": {"kind": "pushed", "width": 200, "height": 120}, "model": "spot", "options": {"targets": 2}});
    service.put("/v1/sessions/two", &document).expect(201);
    let mut socket = service.socket("two", "mode=all");
    let mut centres: Vec<[f64; 2]> = Vec::new();
    for number in 0..8 {
        let raw = [("content-type", "application/octet-stream")];
        let answer = service.request("POST", "/v1/sessions/two/frames", &raw, &frame(number)).expect(200);
        assert_eq!((&answer["target"], &answer["frame"]), (&json!("0"), &json!(number)));
        for target in 0..2 {
            let estimate: Value = socket.next().unwrap();
            assert_eq!((&estimate["target"], &estimate["frame"]), (&json!(target.to_string()), &json!(number)));
            assert_eq!((&estimate["dropped"], &estimate["state"]), (&json!(0), &json!("tracking")), "{estimate}");
            assert!(estimate["confidence"].as_f64().unwrap() > 0.5, "{estimate}");
            assert!(estimate["log_likelihood"].as_f64().unwrap() < 0.0, "{estimate}");
            let centre = ["bx", "by"].map(|name| estimate["parameters"][name].as_f64().unwrap());
            if number == 0 {
                centres.push(centre);
            }
            let before = &mut centres[target];
            assert!((centre[0] - before[0]).hypot(centre[1] - before[1]) < 2.0, "it is the same: {estimate}");
            *before = centre;
        }
    }
    assert!((centres[0][0] - centres[1][0]).abs() > 20.0, "and they are two: {centres:?}");
}

#[test]
fn sessions_predict_on_request() {
    let service = Running::start();
    let mut document = session("realtime", 60.0);
    document["options"] = json!({"predict": {"horizon_s": 0.5, "steps": 10}, "motion": {"acceleration_px_s2": 300}});
    let put = service.put("/v1/sessions/one", &document).expect(201);
    assert_eq!(put["options"]["predict"]["steps"], 10);
    let view = service.wait_for("one", |view| view["frames"].as_u64().unwrap() > 5);
    let ahead = view["last"]["predict"].as_array().unwrap();
    assert_eq!(ahead.len(), 10);
    let variance = |one: &Value| one["covariance"][0][0].as_f64().unwrap();
    assert!(ahead.windows(2).all(|pair| variance(&pair[1]) > variance(&pair[0])), "{ahead:?}");
    assert_eq!((ahead[9]["after_s"].as_f64(), ahead[9]["centre"].as_array().unwrap().len()), (Some(0.5), 2));
}
