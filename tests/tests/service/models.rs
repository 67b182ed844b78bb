//! Models: life cycle, statuses, versions, storage.

use serde_json::{Value, json};

use crate::client::{Folder, Running, session};

/// A document with one parameter.
fn document(start: f64) -> Value {
    json!({"name": "level", "description": "one number", "coordinates": ["x", "y"], "channels": ["phi"],
           "parameters": {"v0": {"start": start}}, "model": {"intensity": "v0"}})
}

#[test]
fn the_shipped_models_are_there() {
    let service = Running::start();
    let items = service.get("/v1/models").expect(200);
    let names: Vec<&str> =
        items["items"].as_array().unwrap().iter().map(|item| item["name"].as_str().unwrap()).collect();
    let shipped = [
        "bead",
        "blob-3d",
        "blob-4d",
        "bright-disc",
        "dark-disc",
        "gaussian",
        "gaussian-pixel",
        "laser-beam",
        "moffat",
        "profile-1d",
        "raised-spot-pose",
        "rational-spot",
        "ring",
        "spot",
        "spot-lobe",
        "spot-motion",
        "spot-plane",
        "spot-pose",
        "spot-psf",
        "spot-quadratic",
        "thesis-spot",
        "three-spots",
        "three-spots-pose",
        "three-spots-pose-lens",
        "three-spots-pose-raw",
        "three-spots-raw",
    ];
    assert_eq!(names, shipped);
    let spot = service.get("/v1/models/spot").expect(200);
    assert_eq!(spot["name"], "spot");
    assert_eq!(spot["version"], 1);
    assert!(spot["digest"].as_str().unwrap().starts_with("sha256:"));
    assert_eq!(spot["model"]["domain"], "s <= 2.2");
    let toml = service.request("GET", "/v1/models/spot", &[("accept", "application/toml")], b"");
    let file = std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap();
    assert_eq!((toml.media.as_str(), toml.text), ("application/toml", file), "comments are kept");
}

#[test]
fn uploads_report_expected_accuracy() {
    let service = Running::start();
    let spot = std::fs::read_to_string(isophote_tests::repository().join("models/spot.toml")).unwrap();
    let toml = [("content-type", "application/toml")];
    let answer = service.request("PUT", "/v1/models/mine", &toml, spot.as_bytes()).expect(201);
    let checked = service.request("POST", "/v1/models:check", &toml, spot.as_bytes()).expect(200);
    for report in [&answer, &checked] {
        assert!(report["stages"][0]["condition"].as_f64().unwrap() > 1e-3, "{report}");
        assert!(report["stages"][0]["condition_saturated"].as_f64().unwrap() > 1e-3, "{report}");
        let bound = &report["bound"];
        assert_eq!(
            (&bound["noise"], &bound["saturated"]),
            (&json!(null), &json!(0.0)),
            "the model has noise of its own"
        );
        assert_eq!(bound["parameters"].as_object().unwrap().len(), 9);
        assert_eq!(bound["deviation"].as_object().unwrap().len(), 7, "of the last stage: {bound}");
        assert!(bound["deviation"]["bx"].as_f64().unwrap() > 0.0);
        let goals: Vec<&str> =
            report["exposure"].as_array().unwrap().iter().map(|advice| advice["goal"].as_str().unwrap()).collect();
        assert_eq!((goals, &report["warnings"]), (vec!["centre", "brightness"], &json!([])));
    }
    let free = spot.replace("\"a3\", \"v0\"", "\"a3\", \"k1\", \"k2\", \"v0\"");
    let flat = free.replace("start = -0.5", "start = -1.5").replace("start = -0.3", "start = 0.0");
    for (method, path) in [("PUT", "/v1/models/flat"), ("POST", "/v1/models:check")] {
        let refused = service.request(method, path, &toml, flat.as_bytes()).expect(422);
        let fault = &refused["diagnostics"][0];
        assert_eq!((&fault["code"], &fault["severity"]), (&json!("degenerate"), &json!("error")), "{refused}");
        let words = format!("{} {}", fault["message"], fault["help"]);
        assert!(["`a1`", "`a3`", "`k1`", "`k2`"].iter().all(|name| words.contains(name)), "{words}");
        assert!(fault["line"].as_u64().unwrap() > 1, "{fault}");
    }
    service.get("/v1/models/flat").expect(404);
    let unread = spot.replace("v1 = {", "z9 = { start = 1.0 }\nv1 = {");
    let warned = service.request("PUT", "/v1/models/unread", &toml, unread.as_bytes()).expect(201);
    assert_eq!(
        (&warned["warnings"][0]["code"], &warned["warnings"][0]["severity"]),
        (&json!("unused"), &json!("warning"))
    );
}

#[test]
fn life_cycle() {
    let service = Running::start();
    let created = service.put("/v1/models/level", &document(1.0));
    let tag = created.etag.clone();
    let created = created.expect(201);
    assert_eq!((&created["model"], &created["version"]), (&json!("level"), &json!(1)));
    assert_eq!(created["stages"][0]["parameters"], json!(["v0"]));
    for key in ["flops_per_pixel", "accumulators", "flops_per_row", "flops_per_pass", "compile_ms"] {
        assert!(created["stages"][0][key].is_number(), "{key}: {created}");
    }
    assert!(created["stages"][0]["calls"].is_object());

    let again = service.put("/v1/models/level", &document(1.0)).expect(200);
    assert_eq!((&again["version"], &again["digest"]), (&json!(2), &created["digest"]));
    let other = service.put("/v1/models/level", &document(2.0)).expect(200);
    assert_ne!(other["digest"], created["digest"]);

    let put = |tag: &str| {
        let headers = [("content-type", "application/json"), ("if-match", tag)];
        service.request("PUT", "/v1/models/level", &headers, document(3.0).to_string().as_bytes())
    };
    put(&tag).expect(412);
    let tag = service.get("/v1/models/level").etag;
    put(&tag).expect(200);
    put(&tag).expect(412);
    put("*").expect(200);
    service.request("DELETE", "/v1/models/level", &[("if-match", "\"9\"")], b"").expect(412);
    assert_eq!(service.delete("/v1/models/level").status, 204);
    service.get("/v1/models/level").expect(404);
    service.delete("/v1/models/level").expect(404);
    put("*").expect(412);
}

#[test]
fn the_same_document_as_toml_and_json_has_one_digest() {
    let service = Running::start();
    let toml = "name = \"level\"\ndescription = \"one number\" # here\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n\
                [parameters]\nv0 = { start = 1.0 }\n[model]\nintensity = \"v0\"\n";
    let first = service.put_text("/v1/models/a", "application/toml; charset=utf-8", toml).expect(201);
    let second = service.put("/v1/models/b", &document(1.0)).expect(201);
    assert_eq!(first["digest"], second["digest"]);
}

#[test]
fn what_is_refused() {
    let service = Running::start();
    let text = document(1.0).to_string();
    service.put_text("/v1/models/level", "text/plain", &text).expect(415);
    service.request("PUT", "/v1/models/level", &[], text.as_bytes()).expect(415);
    let padded = |bytes: usize| format!("{text}{}", " ".repeat(bytes - text.len()));
    for (bytes, status) in [(1 << 20, 201), ((1 << 20) + 1, 422), (1 << 21, 422), ((1 << 21) + 1, 413), (1 << 22, 413)]
    {
        service.put_text("/v1/models/long", "application/json", &padded(bytes)).expect(status);
    }
    for name in ["Level", "-a", "a_b", &"a".repeat(65), "%FF"] {
        let status = service.put(&format!("/v1/models/{name}"), &document(1.0)).status;
        assert!([404, 422].contains(&status), "{name}: {status}");
    }
    let wrong = json!({"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": 1}},
                       "model": {"intensity": "v0 + glare"}});
    let problem = service.put("/v1/models/level", &wrong).expect(422);
    let diagnostic = &problem["diagnostics"][0];
    assert_eq!((&diagnostic["code"], &diagnostic["key"]), (&json!("unknown-name"), &json!("model.intensity")));
    assert_eq!(diagnostic["severity"], "error");
    assert!(diagnostic["line"] == 1 && diagnostic["column"].as_u64().unwrap() > 1, "{diagnostic}");
    assert!(diagnostic["span"].as_array().unwrap().len() == 2);
    service.get("/v1/models/level").expect(404);
    for (method, path, allowed) in [
        ("POST", "/v1/models/spot", "GET,HEAD,PUT,DELETE"),
        ("PUT", "/v1/models/spot:fit", "POST"),
        ("GET", "/v1/models/spot%3Arollback", "POST"),
        ("OPTIONS", "/v1/models/spot", "GET,HEAD,PUT,DELETE"),
        ("OPTIONS", "/v1/models/spot:fit", "POST"),
    ] {
        let answer = service.request(method, path, &[], b"");
        assert_eq!(answer.allow, allowed, "{method} {path}");
        answer.expect(405);
    }
    service.request("POST", "/v1/models/spot:sing", &[], b"").expect(404);
}

/// The service opens no file named by a document; a document with inline samples is an ordinary model.
#[test]
fn tables_come_with_their_samples() {
    let service = Running::start();
    let of = |samples: &str| {
        format!(
            "name = \"measured\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[tables.psf]\nfirst = -2\nstep = 1\n{samples}\n\
             [parameters]\nbx = {{ start = 1.0 }}\n[model]\nintensity = 'table(\"psf\", x - bx)'\n"
        )
    };
    let put = |samples: &str| service.put_text("/v1/models/measured", "application/toml", &of(samples));
    let problem = put("file = \"/etc/hostname\"").expect(422);
    let diagnostic = &problem["diagnostics"][0];
    assert_eq!((&diagnostic["code"], &diagnostic["key"]), (&json!("missing-key"), &json!("tables.psf.values")));
    assert!(diagnostic["message"].as_str().unwrap().contains("/etc/hostname"), "{diagnostic}");
    let [one, other] = [("0.5", 201), ("0.6", 200)]
        .map(|(sample, status)| put(&format!("values = [0, {sample}, 1, 0.5, 0]")).expect(status));
    assert_ne!(one["digest"], other["digest"]);
}

#[test]
fn models_in_use_cannot_be_removed() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 100.0)).expect(201);
    service.delete("/v1/models/spot").expect(409);
    assert_eq!(service.delete("/v1/sessions/one").status, 204);
    assert_eq!(service.delete("/v1/models/spot").status, 204);
}

#[test]
fn checks_and_explanations_keep_nothing() {
    let service = Running::start();
    let check = |text: &str| {
        service.request("POST", "/v1/models:check", &[("content-type", "application/json")], text.as_bytes())
    };
    let checked = check(&document(1.0).to_string()).expect(200);
    assert_eq!(checked["model"], "level");
    assert!(checked["formulas"].as_str().unwrap().contains("data-key=\"model.intensity\""), "{checked}");
    check("{").expect(422);
    service.get("/v1/models/level").expect(404);

    let explained = service.get("/v1/models/thesis-spot/explain?parameters=bx,by&show=program").expect(200);
    assert_eq!(explained["parameters"], json!(["bx", "by"]));
    assert!(explained["flops_per_pixel"].as_u64().unwrap() <= 60, "{explained}");
    let text = explained["text"].as_str().unwrap();
    assert!(text.contains("pixel:"), "{explained}");
    let lines = explained["lines"].as_array().unwrap();
    assert_eq!(lines.len(), text.lines().count());
    for (line, place) in text.lines().zip(lines) {
        let value = line.strip_prefix("  v").and_then(|rest| rest.split(' ').next());
        assert_eq!(value, place["value"].as_u64().map(|value| value.to_string()).as_deref(), "{line}");
    }
    assert!(lines.iter().any(|place| place["span"].is_array()), "{explained}");
    for (query, status) in [
        ("parameters=nobody", 400),
        ("parameters=bx,bx", 400),
        ("show=poem", 400),
        ("colour=red", 400),
        ("show=latex", 200),
        ("show=mathml", 200),
        ("show=formulas", 200),
        ("show=table&parameters=bx,by", 200),
        ("", 200),
    ] {
        service.get(&format!("/v1/models/thesis-spot/explain?{query}")).expect(status);
    }
    service.get("/v1/models/nobody/explain").expect(404);
    let table = service.get("/v1/models/thesis-spot/explain?parameters=bx,by&show=table").expect(200);
    let joint = &table["loops"][2];
    assert_eq!(joint["sums"], "joint", "{table}");
    assert_eq!(joint["compiled"]["flops_per_pixel"], table["flops_per_pixel"]);
    assert!(joint["differentiated"]["ns_per_pixel"].as_f64().unwrap() > 0.0, "{table}");
}

#[test]
fn models_survive_a_restart_in_the_data_folder() {
    let folder = Folder::new("data");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/models/level", &document(1.0)).expect(201);
    let put = service.put("/v1/models/level", &document(2.0)).expect(200);
    service.put("/v1/models/gone", &document(2.0)).expect(201);
    service.delete("/v1/models/gone");
    service.stop();
    let service = Running::start_with(Some(&folder.0), false);
    let found = service.get("/v1/models/level").expect(200);
    assert_eq!((&found["version"], &found["digest"]), (&put["version"], &put["digest"]));
    service.get("/v1/models/gone").expect(404);
}
