//! The service's answers conform to its OpenAPI description, field by field.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use crate::client::{Answer, Running, picture, session, synthetic};

/// The description, and violations found so far.
struct Description {
    api: Value,
    faults: Vec<String>,
}

impl Description {
    fn of(service: &Running) -> Description {
        let text = service.get("/openapi.json");
        let page = std::fs::read_to_string(isophote_tests::repository().join("docs/openapi.json")).unwrap();
        assert_eq!(text.text, page, "what is served is what is committed");
        let api = text.json();
        let is_template = |path: &String| !path.contains('*'); // `*` is the router's own syntax for further segments
        assert!(api["paths"].as_object().unwrap().keys().all(is_template));
        Description { api, faults: Vec::new() }
    }

    /// Checks an answer against the schema of that path and method.
    fn check_answer(&mut self, method: &str, path: &str, answer: &Answer) {
        let responses = self.api["paths"][path][method]["responses"].clone();
        let status = answer.status.to_string();
        let response = if responses[&status].is_object() { &responses[&status] } else { &responses["default"] };
        let schema = &response["content"][&answer.media]["schema"];
        let place = format!("{method} {path} {status} {}", answer.media);
        if answer.text.is_empty() && response["content"].is_null() && response.is_object() {
            return;
        }
        if !schema.is_object() {
            return self.faults.push(format!("{place}: not described"));
        }
        let value = answer.text.lines().next().filter(|_| answer.media == "application/x-ndjson");
        let value = value.map_or_else(|| answer.json(), |line| serde_json::from_str(line).unwrap());
        self.check(schema, &value, &place);
        self.check_known(schema, &value, &place);
    }

    fn resolved(&self, schema: &Value) -> Value {
        match schema["$ref"].as_str() {
            Some(reference) => self.api.pointer(reference.trim_start_matches('#')).unwrap().clone(),
            None => schema.clone(),
        }
    }

    fn is_valid(&self, schema: &Value, value: &Value) -> bool {
        let mut trial = Description { api: self.api.clone(), faults: Vec::new() };
        trial.check(schema, value, "");
        trial.faults.is_empty()
    }

    /// Checks types, required fields and enumerations.
    fn check(&mut self, schema: &Value, value: &Value, place: &str) {
        let schema = self.resolved(schema);
        for part in schema["allOf"].as_array().into_iter().flatten() {
            self.check(part, value, place);
        }
        if let Some(choices) = schema["oneOf"].as_array().or(schema["anyOf"].as_array())
            && !choices.iter().any(|choice| self.is_valid(choice, value))
        {
            self.faults.push(format!("{place}: none of its choices is {value}"));
        }
        let types = match &schema["type"] {
            Value::String(one) => vec![one.as_str()],
            Value::Array(all) => all.iter().map(|one| one.as_str().unwrap()).collect(),
            _ => Vec::new(),
        };
        if !types.is_empty() && !types.iter().any(|name| is_of_type(value, name)) {
            self.faults.push(format!("{place}: {value} is not {types:?}"));
        }
        if schema["enum"].as_array().is_some_and(|words| !words.contains(value)) {
            self.faults.push(format!("{place}: {value} is no word of {}", schema["enum"]));
        }
        for (index, item) in value.as_array().into_iter().flatten().enumerate() {
            self.check(&schema["items"], item, &format!("{place}[{index}]"));
        }
        let Some(object) = value.as_object() else { return };
        for name in schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            if !object.contains_key(name) {
                self.faults.push(format!("{place}: `{name}` is missing"));
            }
        }
        for (name, field) in object {
            let described = &schema["properties"][name];
            let described = if described.is_null() { &schema["additionalProperties"] } else { described };
            self.check(described, field, &format!("{place}.{name}"));
        }
    }

    /// Checks that every field is described.
    fn check_known(&mut self, schema: &Value, value: &Value, place: &str) {
        for (index, item) in value.as_array().into_iter().flatten().enumerate() {
            let items = self.resolved(schema)["items"].clone();
            self.check_known(&items, item, &format!("{place}[{index}]"));
        }
        let (mut known, mut is_open) = (Vec::new(), false);
        self.gather(schema, value, &mut known, &mut is_open);
        for (name, field) in value.as_object().into_iter().flatten() {
            match known.iter().find(|(known, _)| known == name) {
                Some((_, schema)) => self.check_known(&schema.clone(), field, &format!("{place}.{name}")),
                None if is_open => {}
                None => self.faults.push(format!("{place}: `{name}` is not described")),
            }
        }
    }

    /// Collects the fields of a schema and of its parts.
    fn gather(&self, schema: &Value, value: &Value, known: &mut Vec<(String, Value)>, is_open: &mut bool) {
        let schema = self.resolved(schema);
        let choices = schema["oneOf"].as_array().or(schema["anyOf"].as_array()).into_iter().flatten();
        let taken = choices.filter(|choice| self.is_valid(choice, value));
        for part in schema["allOf"].as_array().into_iter().flatten().chain(taken) {
            self.gather(part, value, known, is_open);
        }
        let properties = schema["properties"].as_object();
        known.extend(properties.into_iter().flatten().map(|(name, schema)| (name.clone(), schema.clone())));
        *is_open |= schema["additionalProperties"].is_object() || (schema["type"] == "object" && properties.is_none());
    }
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        _ => false,
    }
}

#[test]
fn answers_are_what_the_description_says() {
    let service = Running::start();
    let mut description = Description::of(&service);
    let mut held = BTreeSet::new();
    let mut check_answer = |method: &str, path: &str, answer: Answer| {
        held.insert(format!("{method} {path}"));
        description.check_answer(method, path, &answer);
        answer
    };
    for path in ["/livez", "/readyz", "/v1/time", "/v1/models", "/v1/sources", "/v1/sessions", "/v1/cameras"] {
        check_answer("get", path, service.get(path));
    }
    let spot = check_answer("get", "/v1/models/{name}", service.get("/v1/models/three-spots-pose-lens")).json();
    let mut document = spot.as_object().unwrap().clone();
    document.retain(|key, _| key != "version" && key != "digest");
    check_answer("put", "/v1/models/{name}", service.put("/v1/models/mine", &document.clone().into()));
    let json = [("content-type", "application/json")];
    let text = Value::from(document).to_string();
    check_answer("post", "/v1/models:check", service.request("POST", "/v1/models:check", &json, text.as_bytes()));
    check_answer("get", "/v1/models/{name}/explain", service.get("/v1/models/spot/explain?parameters=bx,by&show=sums"));
    check_answer("delete", "/v1/models/{name}", service.delete("/v1/models/mine"));
    check_answer("delete", "/v1/models/{name}", service.delete("/v1/models/mine"));
    check_answer("put", "/v1/models/{name}", service.put("/v1/models/mine", &json!({"name": "wrong"})));
    check_answer("get", "/v1/models", service.get("/v1/models?limit=2"));

    let mut bright = synthetic("fit", 0.0);
    bright["light"] = json!({"glare": [{"x": 40, "y": 20, "sigma_px": 5, "height": "20 + t"}], "hot": [{"share": 0.001, "least": 5, "most": 9}]});
    check_answer("put", "/v1/sources/{name}", service.put("/v1/sources/bright", &bright));
    check_answer("get", "/v1/sources/{name}", service.get("/v1/sources/bright"));
    let mut one = session("fit", 0.0);
    one["options"] = json!({"predict": {"horizon_s": 0.1, "steps": 2}, "exposure": {"goal": "brightness"}});
    one["camera"] = json!({"electrons_per_dn": 19.6, "read_noise_e": 15, "intrinsics": {"width": 64, "height": 48, "fx": 80, "fy": 80, "cx": 31.5, "cy": 23.5}});
    check_answer("put", "/v1/sessions/{name}", service.put("/v1/sessions/one", &one));
    service.wait_for("one", |view| view["frames"].as_u64() >= Some(20));
    check_answer("get", "/v1/sessions/{name}", service.get("/v1/sessions/one"));
    check_answer("get", "/v1/sessions", service.get("/v1/sessions"));
    check_answer(
        "put",
        "/v1/sessions/{name}/model",
        service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})),
    );
    check_answer(
        "put",
        "/v1/sessions/{name}/model",
        service.put("/v1/sessions/one/model", &json!({"model": "nobody"})),
    );
    check_answer(
        "put",
        "/v1/sessions/{name}",
        service.put("/v1/sessions/two", &json!({"source": "bright", "model": "spot", "windw": 1})),
    );

    let pixels = picture(64, 48, (30.0, 22.0));
    let raw = [("content-type", "application/octet-stream")];
    let fitted = service.request("POST", "/v1/models/spot:fit?width=64&height=48", &raw, &pixels);
    check_answer("post", "/v1/models/{name}:fit", fitted);
    check_answer("post", "/v1/models/{name}:fit", service.request("POST", "/v1/models/spot:fit", &raw, &pixels));
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/three", &json!({"source": source, "model": "spot"})).expect(201);
    check_answer(
        "post",
        "/v1/sessions/{name}/frames",
        service.request("POST", "/v1/sessions/three/frames", &raw, &pixels),
    );
    check_answer("delete", "/v1/sessions/{name}", service.delete("/v1/sessions/one"));
    check_answer("delete", "/v1/sources/{name}", service.delete("/v1/sources/bright"));
    check_answer("get", "/v1/cameras/{device}", service.get("/v1/cameras/nobody"));
    let none = service.put("/v1/cameras/nobody/controls", &json!({"gain": 1}));
    check_answer("put", "/v1/cameras/{device}/controls", none);
    assert!(held.len() > 20, "{held:?}");
    assert!(description.faults.is_empty(), "{:#?}", description.faults);
}

#[test]
fn planted_faults_are_caught() {
    let service = Running::start();
    let mut description = Description::of(&service);
    let answer = |text: Value| Answer {
        status: 200,
        media: "application/json".into(),
        etag: String::new(),
        cache: String::new(),
        authenticate: String::new(),
        allow: String::new(),
        text: text.to_string(),
    };
    let mut faults = |text: Value| {
        description.check_answer("get", "/v1/time", &answer(text));
        std::mem::take(&mut description.faults).len()
    };
    assert_eq!(faults(json!({"monotonic_ns": 1, "unix_ns": 2})), 0);
    assert_eq!(faults(json!({"monotonic_ns": 1})), 1);
    assert_eq!(faults(json!({"monotonic_ns": "1", "unix_ns": 2})), 1);
    assert_eq!(faults(json!({"monotonic_ns": 1, "unix_ns": 2, "more": 3})), 1);
}
