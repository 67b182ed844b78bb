//! Access control: tokens, roles, hosts and origins; revocation ends what a token began.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use isophote_server::{AccessOptions, Role, TokenFile};
use serde_json::json;

use crate::client::{DEADLINE, Folder, Running, Socket, session};

/// A revoked token is valid for a second at most; a busy machine may take longer to report it.
const SOON: Duration = Duration::from_secs(10);

/// A loopback service that requires tokens, with one token per role and a revoked one.
struct Guarded {
    service: Running,
    file: TokenFile,
    view: String,
    operate: String,
    admin: String,
    revoked: String,
    _folder: Folder,
}

impl Guarded {
    fn start(name: &str) -> Guarded {
        let folder = Folder::new(name);
        let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
        let token = |role| file.add(role, None).unwrap().1.text();
        let [view, operate, admin] = Role::ALL.map(token);
        let revoked = file.add(Role::Admin, Some("old")).unwrap().1.text();
        file.revoke("old").unwrap();
        let access = AccessOptions { tokens: Some(file.path().into()), ..AccessOptions::default() };
        let service = Running::start_with_access(access);
        Guarded { service, file, view, operate, admin, revoked, _folder: folder }
    }

    /// The status of a request without a body.
    fn status(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> u16 {
        self.service.request(method, path, headers, b"").status
    }

    fn put(&self, token: &str, path: &str, document: &serde_json::Value) -> u16 {
        let headers = [("content-type", "application/json"), ("authorization", &format!("Bearer {token}"))];
        self.service.request("PUT", path, &headers, document.to_string().as_bytes()).status
    }

    fn socket(&self, path: &str, token: &str) -> Result<Socket, u16> {
        self.service.open(path, &format!("isophote.v1, isophote.token.{token}"))
    }
}

/// Every route of the router with its methods, parsed from its source, so that a new route must be added to the tables
/// below.
fn routes() -> Vec<(String, String)> {
    let source = include_str!("../../../server/src/http/routes/mod.rs");
    let mut found = Vec::new();
    for line in source.lines().filter_map(|line| line.trim().strip_prefix(".route(\"")) {
        let (path, handlers) = line.split_once('"').unwrap();
        for method in ["get", "put", "post", "delete"] {
            let is_handled = |before: char| handlers.contains(&format!("{before}{method}("));
            if is_handled(' ') || is_handled('.') {
                found.push((method.to_uppercase(), path.to_string()));
            }
        }
    }
    assert!(found.len() > 30, "{found:?}");
    found
}

/// The least role that a route needs, stated independently of the service.
fn least(method: &str, path: &str) -> &'static str {
    match (method, path) {
        ("GET", "/" | "/page.js" | "/page.css" | "/page/{file}" | "/docs" | "/docs/" | "/docs/{*path}") => "nothing",
        ("GET", "/livez" | "/readyz") => "nothing",
        ("GET", "/v1/sessions/{name}/frames") => "operate",
        ("GET", _) => "view",
        ("POST", "/v1/models:check") => "operate",
        (_, path) if path.starts_with("/v1/models") => "admin",
        _ => "operate",
    }
}

#[test]
fn every_route_requires_its_role() {
    let guarded = Guarded::start("every-route");
    let unknown = format!("isophote_{}", "0".repeat(64));
    for (method, route) in routes() {
        let path = route.replace("{name}", "nobody").replace("{device}", "nobody");
        let least = least(&method, &route);
        let bearer = |token: &str| format!("Bearer {token}");
        let kinds: [(&str, Option<String>, &[&str]); 7] = [
            ("none", None, &[]),
            ("malformed", Some(bearer("isophote_12")), &[]),
            ("of another scheme", Some(format!("Basic {}", guarded.admin)), &[]),
            ("revoked", Some(bearer(&guarded.revoked)), &[]),
            ("view", Some(bearer(&guarded.view)), &["view"]),
            ("operate", Some(bearer(&guarded.operate)), &["view", "operate"]),
            ("admin", Some(bearer(&guarded.admin)), &["view", "operate", "admin"]),
        ];
        let unknown = [("unknown", Some(bearer(&unknown)), [].as_slice())];
        for (kind, value, roles) in kinds.iter().chain(&unknown) {
            let headers: Vec<(&str, &str)> = value.iter().map(|value| ("authorization", value.as_str())).collect();
            let answer = guarded.service.request(&method, &path, &headers, b"");
            let expected = match (least == "nothing" || roles.contains(&least), roles.is_empty()) {
                (true, _) => None,
                (false, true) => Some(401),
                (false, false) => Some(403),
            };
            let what = format!("{method} {route}, token: {kind}: {} {}", answer.status, answer.text);
            match expected {
                // The route's own answer to an empty body and an unknown name.
                None => assert!(![401, 403, 500].contains(&answer.status), "{what}"),
                Some(status) => {
                    assert_eq!(answer.status, status, "{what}");
                    assert_eq!(answer.authenticate, if status == 401 { "Bearer" } else { "" }, "{what}");
                    assert!(status == 401 || answer.text.contains(&format!("the role {least}")), "{what}");
                    assert!(!answer.text.contains(&unknown[0].1.as_ref().unwrap()[7..]), "{what}");
                }
            }
        }
    }
    assert_eq!(guarded.status("GET", "/v1/nothing", &[]), 401, "nor is said what there is not");
    assert_eq!(guarded.status("GET", "/v1/nothing", &[("accept", "text/html")]), 404, "but for a page for people");
    assert_eq!(guarded.status("GET", "/v1/sessions", &[("accept", "text/html")]), 401);
}

#[test]
fn readiness_needs_no_token_and_reveals_nothing_more_with_one() {
    let guarded = Guarded::start("ready");
    let answer = guarded.service.get("/readyz");
    assert_eq!((answer.status, answer.text.as_str()), (200, r#"{"status":"ok"}"#));
    assert_eq!(guarded.status("HEAD", "/readyz", &[]), 200);
    assert_eq!(guarded.status("PUT", "/readyz", &[]), 401);
}

#[test]
fn tokens_are_accepted_in_headers_and_subprotocols_only() {
    let guarded = Guarded::start("where-tokens-stand");
    let operate = guarded.operate.clone();
    assert_eq!(guarded.put(&operate, "/v1/sessions/one", &session("realtime", 30.0)), 201);
    let path = "/v1/sessions/one/estimates";
    let mut socket = guarded.socket(path, &guarded.view).unwrap();
    assert_eq!(socket.protocol(), "isophote.v1", "a token is never said back");
    assert_eq!(socket.next().unwrap()["session"], "one");
    assert_eq!(guarded.service.open(path, "isophote.v1").err(), Some(401));
    assert_eq!(guarded.socket(path, &guarded.revoked).err(), Some(401));
    assert_eq!(guarded.socket(path, "").err(), Some(401));
    assert_eq!(guarded.socket("/v1/sessions/one/frames", &guarded.view).err(), Some(403));
    assert_eq!(guarded.socket("/v1/sessions/one/frames", &operate).err(), Some(409), "not pushed, but allowed");
    // As a subprotocol it is valid for WebSockets only.
    let protocols = format!("isophote.v1, isophote.token.{operate}");
    assert_eq!(guarded.status("GET", "/v1/sessions", &[("sec-websocket-protocol", &protocols)]), 401);
    let own = format!("bEaReR {operate}");
    assert_eq!(guarded.status("GET", "/v1/sessions", &[("authorization", &own)]), 200);
    for query in [format!("token={operate}"), format!("mode={operate}"), "access_token=x".into(), "Token=".into()] {
        let answer = guarded.service.request("GET", &format!("{path}?{query}"), &[("authorization", &own)], b"");
        assert_eq!(answer.status, 400, "{}", answer.text);
        assert!(!answer.text.contains("isophote_") && answer.text.contains("revoke"), "{}", answer.text);
    }
    let encoded = operate.replace('_', "%5f");
    for path in [format!("/v1/models/{operate}"), format!("/v1/models/{encoded}"), format!("/{operate}")] {
        let answer = guarded.service.request("GET", &path, &[("authorization", &own)], b"");
        assert_eq!(answer.status, 400, "{}", answer.text);
        assert!(!answer.text.contains(&operate[9..]), "{}", answer.text);
    }
    let twice = [("authorization", own.as_str()), ("authorization", own.as_str())];
    assert_eq!(guarded.status("GET", "/v1/sessions", &twice), 401, "which of the two?");
}

#[test]
fn revoked_tokens_end_their_streams() {
    let guarded = Guarded::start("revoking");
    let pushed = json!({"source": {"kind": "pushed", "width": 8, "height": 8}, "model": "spot"});
    assert_eq!(guarded.put(&guarded.operate, "/v1/sessions/one", &session("realtime", 30.0)), 201);
    assert_eq!(guarded.put(&guarded.operate, "/v1/sessions/two", &pushed), 201);
    let (_, leaver) = guarded.file.add(Role::Operate, Some("leaver")).unwrap();
    let leaver = leaver.text();
    let header = format!("Bearer {leaver}");
    let estimates = "/v1/sessions/one/estimates";
    let begin = Instant::now();
    while guarded.status("GET", "/v1/sessions", &[("authorization", &header)]) != 200 {
        assert!(begin.elapsed() < SOON, "a new token is good within a second");
    }
    let mut live = guarded.socket(estimates, &leaver).unwrap();
    let mut other = guarded.socket(estimates, &guarded.view).unwrap();
    let mut quiet = guarded.socket(&format!("{estimates}?credit=0"), &leaver).unwrap();
    let mut frames = guarded.socket("/v1/sessions/two/frames", &leaver).unwrap();
    let mut lines = TcpStream::connect(&guarded.service.address).unwrap();
    lines.set_read_timeout(Some(DEADLINE)).unwrap();
    let host = &guarded.service.address;
    write!(lines, "GET {estimates} HTTP/1.1\r\nHost: {host}\r\nAuthorization: {header}\r\n\r\n").unwrap();
    live.next().unwrap();

    guarded.file.revoke("leaver").unwrap();
    let begin = Instant::now();
    let ended = |socket: &mut Socket| loop {
        if let Err(code) = socket.next() {
            return code;
        }
    };
    for socket in [&mut live, &mut quiet, &mut frames] {
        assert_eq!(ended(socket), 1008);
    }
    let mut rest = String::new();
    let last_chunk = loop {
        let mut bytes = [0; 4096];
        let read = lines.read(&mut bytes).unwrap();
        rest += &String::from_utf8_lossy(&bytes[..read]);
        if read == 0 || rest.ends_with("\r\n0\r\n\r\n") {
            break rest;
        }
    };
    assert!(last_chunk.starts_with("HTTP/1.1 200"), "{last_chunk}");
    assert_eq!(guarded.status("GET", "/v1/sessions", &[("authorization", &header)]), 401);
    eprintln!("streams ended and requests refused {:?} after the token was revoked", begin.elapsed());
    assert!(begin.elapsed() < SOON, "{:?}", begin.elapsed());
    other.next().unwrap();
}

#[test]
fn shipped_models_are_read_only_with_tokens() {
    let guarded = Guarded::start("shipped");
    let gaussian = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/gaussian.toml")).unwrap();
    let header = format!("Bearer {}", guarded.admin);
    let put = |name: &str| {
        let headers = [("content-type", "application/toml"), ("authorization", header.as_str())];
        guarded.service.request("PUT", &format!("/v1/models/{name}"), &headers, gaussian.as_bytes())
    };
    let refused = put("spot").expect(403);
    assert_eq!(refused["code"], "read-only");
    put("mine").expect(201);
    put("mine").expect(200);
    let delete = |name: &str| guarded.status("DELETE", &format!("/v1/models/{name}"), &[("authorization", &header)]);
    assert_eq!((delete("spot"), delete("mine"), delete("mine")), (403, 204, 404));
}

#[test]
fn compilations_are_rate_limited_per_tenant() {
    let guarded = Guarded::start("compiles");
    let status = |method: &str, path: &str, token: &str| {
        guarded.status(method, path, &[("authorization", &format!("Bearer {token}"))])
    };
    let begin = Instant::now();
    let tries: usize = 40;
    let refused = (0..tries).filter(|_| status("POST", "/v1/models:check", &guarded.operate) == 429).count();
    // Allow for tokens refilled meanwhile, one every two seconds.
    let most = 30 + begin.elapsed().as_secs() as usize / 2 + 1;
    assert!(refused >= tries.saturating_sub(most) && refused <= tries - 30, "{refused} of {tries} refused");
    assert_eq!(status("GET", "/v1/models", &guarded.view), 200);
}

/// The statuses of a request for the session's estimates and of its upgrade to a WebSocket.
#[test]
fn hosts_and_origins_on_http_and_websockets() {
    let folder = Folder::new("hosts-table");
    let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
    let token = file.add(Role::Operate, None).unwrap().1.text();
    let hosts = ["fits.example", "lab.example:8443"].iter().map(|name| name.parse().unwrap()).collect();
    let tokens = Some(file.path().to_path_buf());
    let service = Running::start_with_access(AccessOptions { tokens, hosts, ..AccessOptions::default() });
    let own = service.address.clone();
    let port = own.rsplit_once(':').unwrap().1;
    let headers = [("content-type", "application/json"), ("authorization", &format!("Bearer {token}"))];
    let document = session("realtime", 30.0).to_string();
    service.request("PUT", "/v1/sessions/one", &headers, document.as_bytes()).expect(201);
    let status = |host: &str, origin: Option<&str>, more: &str| {
        let origin = origin.map(|origin| format!("Origin: {origin}\r\n")).unwrap_or_default();
        let request = format!(
            "GET /v1/sessions/one/estimates HTTP/1.1\r\nHost: {host}\r\n{origin}{more}Authorization: Bearer {token}\r\n\r\n"
        );
        let mut stream = TcpStream::connect(&service.address).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut begin = [0; 12];
        stream.read_exact(&mut begin).unwrap();
        String::from_utf8_lossy(&begin[9..]).parse::<u16>().unwrap()
    };
    let (http, https) = (format!("http://{own}"), format!("https://{own}"));
    let (local, local_page) = (format!("localhost:{port}"), format!("http://localhost:{port}"));
    let (named, page) = (format!("fits.example:{port}"), format!("https://fits.example:{port}"));
    let cases: &[(&str, Option<&str>, u16)] = &[
        (&own, None, 200),
        (&own, Some(&http), 200),
        (&own, Some(&https), 200),
        (&own, Some(&local_page), 403),
        (&own, Some("null"), 403),
        (&own, Some("http://127.0.0.1"), 403),
        (&own, Some("http://evil.example"), 403),
        (&own, Some("file://"), 403),
        (&own, Some(&format!("{http}.evil.example")), 403),
        (&own, Some(&format!("{http}/")), 403),
        (&own, Some(&format!("http://user@{own}")), 403),
        (&own, Some(&own), 403),
        (&own, Some("*"), 403),
        (&local, None, 200),
        (&local, Some(&local_page), 200),
        (&local.to_uppercase(), None, 200),
        (&local, Some(&http), 403),
        ("localhost", None, 200),
        ("[::1]", None, 200),
        (&format!("[::1]:{port}"), Some(&format!("http://[::1]:{port}")), 200),
        ("127.0.0.2", None, 200),
        ("fits.example", None, 200),
        ("fits.example", Some("https://fits.example"), 200),
        ("fits.example", Some("http://fits.example"), 200),
        ("FITS.example", Some("https://fits.EXAMPLE"), 200),
        ("fits.example", Some("https://fits.example:8443"), 403),
        ("fits.example", Some("https://lab.example"), 403),
        (&named, None, 200),
        (&named, Some(&page), 200),
        ("lab.example:8443", None, 200),
        ("lab.example:8443", Some("https://lab.example:8443"), 200),
        ("lab.example", None, 421),
        ("lab.example:8444", None, 421),
        ("evil.example", None, 421),
        ("evil.example", Some("http://evil.example"), 421),
        ("fits.example.evil.example", None, 421),
        ("fits.example.", None, 421),
        ("192.0.2.1", None, 421),
        ("0.0.0.0", None, 421),
        ("127.1", None, 421),
        ("2130706433", None, 421),
        ("[::2]", None, 421),
        ("xn--fts-qla.example", None, 421),
        ("user@localhost", None, 421),
        ("", None, 421),
    ];
    assert!(cases.len() >= 40);
    let upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    for (host, origin, expected) in cases {
        assert_eq!(status(host, *origin, ""), *expected, "HTTP: {host} {origin:?}");
        let expected = if *expected == 200 { 101 } else { *expected };
        assert_eq!(status(host, *origin, upgrade), expected, "WebSocket: {host} {origin:?}");
    }
}
