//! Stacks of slices through the service: synthetic, recorded, and rejected with the wrong key.

use serde_json::json;

use crate::client::{Folder, Running};

#[test]
fn sessions_track_a_blob_through_stacks() {
    let service = Running::start();
    let source = json!({"kind": "synthetic", "model": "blob-3d", "width": 24, "height": 20, "depth": 12, "samples": 1, "pace": "fit",
                        "rate_hz": 200, "set": {"by": 9.4}, "motion": {"bx": "11 + sin(t)"}});
    let document = json!({"source": source, "model": "blob-3d", "window": {"x": 0, "y": 0, "width": 24, "height": 20, "z": 1, "depth": 10}});
    let put = service.put("/v1/sessions/deep", &document).expect(201);
    assert_eq!((&put["source"]["depth"], &put["window"]["depth"]), (&json!(12), &json!(10)));
    let view = service.wait_for("deep", |view| view["last"]["frame"].as_u64().unwrap_or(0) > 5);
    let last = &view["last"];
    assert_eq!(last["state"], "tracking", "{last}");
    for name in ["bx", "by", "bz"] {
        let error = last["parameters"][name].as_f64().unwrap() - last["truth"][name].as_f64().unwrap();
        assert!(error.abs() < 0.02, "{name} is {error} off: {last}");
    }
}

#[test]
fn a_recorded_stack_is_one_frame() {
    let service = Running::start();
    let folder = Folder::new("stack");
    // Ten slices of 16 × 14 pixels with a blob.
    let value = |i: usize| {
        let (x, y, z) = ((i % 16) as f64, (i / 16 % 14) as f64, (i / 224) as f64);
        let s = ((x - 7.3) / 5.0).powi(2) + ((y - 6.4) / 4.0).powi(2) + ((z - 4.6) / 3.0).powi(2);
        (20.0 + 180.0 * (-2.0 * s).exp()).round() as u8
    };
    let pixels: Vec<u8> = (0..2240).map(value).collect();
    let tiff = isophote_capture::encode_tiff(16, 14, isophote_jit::PixelFormat::U8, &pixels).unwrap();
    std::fs::write(folder.0.join("stack.tiff"), tiff).unwrap();
    let source =
        json!({"kind": "recording", "path": folder.0.join("stack.tiff"), "pace": "fit", "rate_hz": 100, "loop": true});
    service.put("/v1/sessions/deep", &json!({"source": source, "model": "blob-3d"})).expect(201);
    let view = service.wait_for("deep", |view| view["last"]["state"] == "tracking");
    for (name, value) in [("bx", 7.3), ("by", 6.4), ("bz", 4.6)] {
        let error = view["last"]["parameters"][name].as_f64().unwrap() - value;
        assert!(error.abs() < 0.02, "{name} is {error} off: {view}");
    }
    // The same pages are pictures for a two-dimensional model; a four-dimensional one refuses them.
    service.put("/v1/sessions/flat", &json!({"source": source, "model": "gaussian"})).expect(201);
    service.wait_for("flat", |view| view["frames"].as_u64().unwrap() > 10);
    let refused = service.put("/v1/sessions/four", &json!({"source": source, "model": "blob-4d"})).expect(422);
    let diagnostic = &refused["diagnostics"][0];
    assert_eq!(diagnostic["key"], "source.path", "{refused}");
    assert!(diagnostic["message"].as_str().unwrap().contains("a TIFF of 10 pages"), "{refused}");
}

#[test]
fn impossible_sizes_are_refused_at_their_key() {
    let service = Running::start();
    let put = |source: serde_json::Value| {
        service.put("/v1/sessions/deep", &json!({"source": source, "model": "blob-3d"})).expect(422)
    };
    let too_large = put(json!({"kind": "synthetic", "model": "blob-3d", "width": 1024, "height": 1024, "depth": 64}));
    assert_eq!(too_large["diagnostics"][0]["key"], "source.width", "{too_large}");
    let flat = put(json!({"kind": "synthetic", "model": "blob-3d", "width": 32, "height": 32, "depth": 1}));
    assert!(flat["diagnostics"][0]["message"].as_str().unwrap().contains("depth is 1"), "{flat}");
    let pictures = json!({"kind": "synthetic", "model": "spot", "width": 32, "height": 32});
    let refused = service.put("/v1/sessions/deep", &json!({"source": pictures, "model": "blob-3d"}));
    assert_eq!(refused.status, 422, "{}", refused.text);
    assert!(refused.text.contains("3 coordinates"), "{}", refused.text);
}
