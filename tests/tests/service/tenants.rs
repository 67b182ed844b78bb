//! Tenants: each has its own names and its share of the limits.

use std::time::Instant;

use isophote_server::{AccessOptions, Options, Role, TokenFile};
use serde_json::{Value, json};

use crate::client::{Answer, DEADLINE, Folder, Running, names, session};

/// A service with tenants, each with an admin token.
struct Shared {
    service: Running,
    tokens: Vec<String>,
    options: Options,
    folder: Folder,
}

const TENANTS: [&str; 3] = ["default", "acme", "zeta"];
const DEFAULT: usize = 0;
const ACME: usize = 1;
const ZETA: usize = 2;

impl Shared {
    fn start(name: &str) -> Shared {
        let folder = Folder::new(name);
        let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
        let tokens = TENANTS.map(|tenant| file.add_for(tenant, Role::Admin, None).unwrap().1.text()).to_vec();
        let access = AccessOptions { tokens: Some(file.path().into()), ..AccessOptions::default() };
        let options = Options { access, data: Some(folder.0.join("data")), ..Running::options() };
        Shared { service: Running::with(&options), tokens, options, folder }
    }

    fn restarted(self) -> Shared {
        let Shared { service, tokens, options, folder } = self;
        service.stop();
        Shared { service: Running::with(&options), tokens, options, folder }
    }

    fn ask(&self, tenant: usize, method: &str, path: &str, body: &Value) -> Answer {
        let bearer = format!("Bearer {}", self.tokens[tenant]);
        let headers = [("content-type", "application/json"), ("authorization", bearer.as_str())];
        let body = if body.is_null() { String::new() } else { body.to_string() };
        self.service.request(method, path, &headers, body.as_bytes())
    }

    fn get(&self, tenant: usize, path: &str) -> Value {
        self.ask(tenant, "GET", path, &Value::Null).expect(200)
    }

    fn names_of(&self, tenant: usize, list: &str) -> Vec<String> {
        let items = self.get(tenant, list)["items"].as_array().unwrap().clone();
        items.iter().map(|item| item["name"].as_str().unwrap().to_string()).collect()
    }

    fn tracks(&self, tenant: usize, name: &str) -> Value {
        let protocol = format!("isophote.v1, isophote.token.{}", self.tokens[tenant]);
        let open = || self.service.open(&format!("/v1/sessions/{name}/estimates"), &protocol);
        // Right after a start it may not run yet, which is a conflict.
        let mut socket = loop {
            match open() {
                Err(409) => std::thread::yield_now(),
                socket => break socket.unwrap(),
            }
        };
        loop {
            let estimate = socket.next().unwrap();
            if estimate["state"] == "tracking" {
                return estimate;
            }
        }
    }
}

fn model(name: &str) -> Value {
    json!({"name": name, "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": 1}},
           "model": {"intensity": "v0"}})
}

#[test]
fn tenants_have_own_names_across_restarts() {
    let shared = Shared::start("tenants");
    for tenant in [ACME, ZETA] {
        shared.ask(tenant, "PUT", "/v1/models/mine", &model("mine")).expect(201);
        shared.ask(tenant, "PUT", "/v1/sessions/one", &session("realtime", 30.0)).expect(201);
    }
    let own = json!({"kind": "synthetic", "model": "spot", "width": 64, "height": 48, "samples": 1, "rate_hz": 30});
    shared.ask(ACME, "PUT", "/v1/sources/eye", &own).expect(201);
    assert_ne!(shared.tracks(ACME, "one")["node"], shared.tracks(ZETA, "one")["node"], "two sessions of one name");

    // One tenant's changes affect no other: models, sources, sessions, running state and metrics.
    shared.ask(ZETA, "DELETE", "/v1/models/mine", &Value::Null).expect(204);
    shared.ask(ZETA, "DELETE", "/v1/sessions/one", &Value::Null).expect(204);
    assert_eq!(shared.names_of(ACME, "/v1/sessions"), ["one"]);
    assert_eq!(shared.names_of(ACME, "/v1/sources"), ["eye"]);
    for other in [DEFAULT, ZETA] {
        assert!(shared.names_of(other, "/v1/sessions").is_empty() && shared.names_of(other, "/v1/sources").is_empty());
        assert!(!shared.names_of(other, "/v1/models").contains(&"mine".to_string()));
        let counted = shared.ask(other, "GET", "/metrics", &Value::Null).text;
        assert!(counted.contains("isophote_ready") && !counted.contains("session=\"one\""), "{counted}");
        let of_acme = [
            ("GET", "/v1/models/mine"),
            ("GET", "/v1/models/mine/explain"),
            ("GET", "/v1/models/mine/versions"),
            ("DELETE", "/v1/models/mine"),
            ("GET", "/v1/sources/eye"),
            ("GET", "/v1/sources/eye/scene"),
            ("GET", "/v1/sources/eye/playback"),
            ("GET", "/v1/sources/eye/control"),
            ("DELETE", "/v1/sources/eye"),
            ("GET", "/v1/sessions/one"),
            ("GET", "/v1/sessions/one/estimates"),
            ("GET", "/v1/sessions/one/preview"),
            ("GET", "/v1/sessions/one/recording"),
            ("GET", "/v1/sessions/one/shadow"),
            ("DELETE", "/v1/sessions/one/shadow"),
            ("DELETE", "/v1/sessions/one"),
        ];
        for (method, path) in of_acme {
            let answer = shared.ask(other, method, path, &Value::Null);
            assert_eq!(answer.status, 404, "{method} {path}: {}", answer.text);
        }
        let on_another = json!({"source": "eye", "model": "spot"});
        assert_eq!(shared.ask(other, "PUT", "/v1/sessions/two", &on_another).status, 404);
    }
    assert_eq!(
        names(&shared.get(DEFAULT, "/v1/models")["items"][0]),
        names(&shared.get(ACME, "/v1/models")["items"][0])
    );

    let shared = shared.restarted();
    shared.tracks(ACME, "one");
    assert_eq!(shared.names_of(ACME, "/v1/sources"), ["eye"]);
    assert!(shared.names_of(ZETA, "/v1/sessions").is_empty());
    let data = shared.folder.0.join("data/tenants");
    let mut folders: Vec<_> = std::fs::read_dir(data).unwrap().map(|one| one.unwrap().file_name()).collect();
    folders.sort();
    assert_eq!(folders, ["acme", "zeta"], "the first tenant's is the data folder itself");
}

#[test]
fn recordings_belong_to_their_tenant() {
    let shared = Shared::start("tenants-recordings");
    shared.ask(ACME, "PUT", "/v1/sessions/one", &session("realtime", 30.0)).expect(201);
    shared.tracks(ACME, "one");
    let begun = shared.ask(ACME, "PUT", "/v1/sessions/one/recording", &json!({"name": "night"})).expect(201);
    assert_eq!(begun["state"], "recording", "{begun}");
    while shared.get(ACME, "/v1/sessions/one/recording")["recorded_frames"].as_u64().unwrap() < 2 {
        std::thread::yield_now();
    }
    shared.ask(ACME, "DELETE", "/v1/sessions/one/recording", &Value::Null).expect(204);
    let items = shared.get(ACME, "/v1/recordings")["items"].clone();
    let file = items[0]["file"].as_str().unwrap_or_else(|| panic!("{items}")).to_string();
    let replay = json!({"kind": "recording", "path": file});
    for other in [DEFAULT, ZETA] {
        assert_eq!(shared.get(other, "/v1/recordings")["items"], json!([]));
        for method in ["GET", "DELETE"] {
            assert_eq!(shared.ask(other, method, &format!("/v1/recordings/{file}"), &Value::Null).status, 404);
        }
        for path in [file.clone(), format!("../../acme/recordings/{file}"), format!("tenants/acme/recordings/{file}")] {
            let document = json!({"kind": "recording", "path": path});
            let answer = shared.ask(other, "PUT", "/v1/sources/played", &document);
            assert_eq!(answer.status, 422, "{path}: {}", answer.text);
        }
    }
    shared.ask(ACME, "PUT", "/v1/sources/played", &replay).expect(201);
}

/// Here the default tenant is restricted like others: it plays its own recordings only.
#[test]
fn tenants_replay_their_own_recordings() {
    let shared = Shared::start("tenants-replays");
    for tenant in [DEFAULT, ACME] {
        shared.ask(tenant, "PUT", "/v1/sessions/one", &session("realtime", 30.0)).expect(201);
        shared.tracks(tenant, "one");
        shared
            .ask(tenant, "PUT", "/v1/sessions/one/recording", &json!({"name": TENANTS[tenant], "csv": true}))
            .expect(201);
        while shared.get(tenant, "/v1/sessions/one/recording")["recorded_frames"].as_u64().unwrap() < 2 {
            std::thread::yield_now();
        }
        shared.ask(tenant, "DELETE", "/v1/sessions/one/recording", &Value::Null).expect(204);
        let item = shared.get(tenant, "/v1/recordings")["items"][0].clone();
        let file = item["file"].as_str().unwrap().to_string();
        let replay = json!({"kind": "recording", "path": file, "pace": "fit"});
        let view = shared.ask(tenant, "PUT", "/v1/sources/played", &replay).expect(201);
        assert_eq!(view["path"], file.as_str());
        let csv = format!("/v1/recordings/{}", item["csv"]["file"].as_str().unwrap());
        assert_eq!(shared.ask(tenant, "GET", &csv, &Value::Null).status, 200);
        for other in [DEFAULT, ACME, ZETA].into_iter().filter(|other| *other != tenant) {
            assert_eq!(shared.ask(other, "GET", &csv, &Value::Null).status, 404);
            assert_eq!(shared.ask(other, "PUT", "/v1/sources/theirs", &replay).status, 422);
        }
        let data = shared.folder.0.join("data");
        for path in
            ["/etc/hostname", "../recordings/absent.mcap", "absent.mcap", data.join("tokens.json").to_str().unwrap()]
        {
            let document = json!({"kind": "recording", "path": path});
            assert_eq!(shared.ask(tenant, "PUT", "/v1/sources/wrong", &document).status, 422, "{path}");
        }
    }
    // A declared source plays again after a restart.
    let shared = shared.restarted();
    let (on_it, begin) = (json!({"source": "played", "model": "spot"}), Instant::now());
    loop {
        let answer = shared.ask(DEFAULT, "PUT", "/v1/sessions/two", &on_it);
        if answer.status == 201 {
            break;
        }
        assert!(answer.status == 409 && begin.elapsed() < DEADLINE, "{}", answer.text);
        std::thread::yield_now();
    }
}

/// A kernel compiled for one tenant is compiled again for another, so that counters and times reveal nothing.
#[test]
fn kernel_counters_do_not_leak_other_tenants_formulas() {
    let shared = Shared::start("tenants-kernels");
    let counted = |tenant| {
        let text = shared.ask(tenant, "GET", "/metrics", &Value::Null).text;
        let is_of_kernels = |line: &&str| line.starts_with("isophote_kernel");
        text.lines().filter(is_of_kernels).map(str::to_string).collect::<Vec<String>>()
    };
    let put = |tenant| {
        let mut secret = model("mine");
        secret["model"]["intensity"] = json!("v0*exp(-0.37*x*x)");
        let answer = shared.ask(tenant, "PUT", "/v1/models/mine", &secret).expect(201);
        assert!(answer["stages"][0]["compile_ms"].as_f64().unwrap() > 0.0, "{answer}");
        counted(tenant)
    };
    assert_eq!(counted(ACME), counted(ZETA));
    let of_the_first = put(ACME);
    assert_ne!(of_the_first, counted(ZETA));
    assert_eq!(put(ZETA), of_the_first);

    // Only the operator's tenant sees all metrics.
    let text = |tenant| shared.ask(tenant, "GET", "/metrics", &Value::Null).text;
    let all = text(DEFAULT);
    for tenant in TENANTS {
        assert!(all.contains(&format!("isophote_tenant_kernel_bytes{{tenant=\"{tenant}\"}} ")), "{all}");
    }
    assert!([ACME, ZETA].iter().all(|tenant| !text(*tenant).contains("isophote_tenant")));
}

#[test]
fn tenants_are_limited_to_their_share() {
    let shared = Shared::start("tenants-shares");
    let pushed = json!({"source": {"kind": "pushed", "width": 16, "height": 16, "format": "u8"}, "model": "gaussian"});
    let put = |tenant, number: usize| shared.ask(tenant, "PUT", &format!("/v1/sessions/s-{number}"), &pushed);
    let share = 64_usize.div_ceil(TENANTS.len());
    (0..share).for_each(|number| drop(put(ZETA, number).expect(201)));
    let refused = put(ZETA, share).expect(429);
    assert_eq!(refused["code"], "over-limit");
    assert!(refused["detail"].as_str().unwrap().contains(&share.to_string()), "{refused}");
    assert_eq!(put(ZETA, 0).status, 200, "what it has may be replaced");
    put(ACME, 0).expect(201);
}
