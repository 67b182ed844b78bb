//! Hosts, origins, health, the page, and malformed requests.

use std::io::{Read, Write};
use std::net::TcpStream;

use crate::client::{DEADLINE, Running};

/// Sends bytes and reads until the service closes.
fn raw(service: &Running, request: &str) -> String {
    let mut stream = TcpStream::connect(&service.address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).ok(); // a reset may follow the answer
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn health_and_time() {
    let service = Running::start();
    service.get("/livez").expect(200);
    service.get("/readyz").expect(200);
    let first = service.get("/v1/time").expect(200)["monotonic_ns"].as_u64().unwrap();
    assert!(service.get("/v1/time").expect(200)["monotonic_ns"].as_u64().unwrap() > first);
}

#[test]
fn the_page_loads_nothing_external() {
    let service = Running::start();
    let page = service.get("/");
    assert_eq!((page.status, page.media.as_str()), (200, "text/html; charset=utf-8"));
    let (script, style) = (service.get("/page.js"), service.get("/page.css"));
    assert_eq!((script.status, style.status, style.media.as_str()), (200, 200, "text/css; charset=utf-8"));
    for inline in ["<style", "style=", "onclick", "onload", "onsubmit", "javascript:"] {
        assert!(!page.text.contains(inline), "the page has {inline} in itself");
    }
    let parts =
        ["/page/Model.js", "/page/Explorer.js", "/page/Sources.js", "/page/Plots.js"].map(|path| service.get(path));
    assert!(parts.iter().all(|part| part.status == 200 && part.media.starts_with("text/javascript")));
    service.get("/page/nobody.js").expect(404);
    for text in [&page, &script, &style].into_iter().chain(&parts).map(|answer| &answer.text) {
        // XML namespaces are mere names.
        let plain = text.replace("http://www.w3.org/", "");
        let found = plain.find("https://").or_else(|| plain.find("http://"));
        assert!(found.is_none(), "{:.200}", &plain[found.unwrap_or(0)..]);
    }
    for path in ["/", "/page.js", "/page.css", "/page/Model.js"] {
        let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        let answer = raw(&service, &request).to_ascii_lowercase();
        let policy = "content-security-policy: default-src 'self'; img-src 'self' data:; object-src 'none'; ";
        for header in
            [policy, "frame-ancestors 'none'", "referrer-policy: no-referrer", "x-content-type-options: nosniff"]
        {
            assert!(answer.contains(header), "{path} has no {header}: {answer:.600}");
        }
        assert!(!answer.contains("unsafe-"), "{answer:.600}");
    }
}

#[test]
fn unknown_paths_are_a_page_for_browsers_and_a_problem_for_programs() {
    let service = Running::start();
    let browser = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
    let ask = |method: &str, path: &str, accept: &str| service.request(method, path, &[("accept", accept)], b"");
    for path in ["/nothing", "/docs.html", "/v2/sessions", "/v1/sessions/demo/nothing"] {
        let page = ask("GET", path, browser);
        assert_eq!((page.status, page.media.as_str()), (404, "text/html; charset=utf-8"), "{path}");
        assert!(page.text.contains("href=\"/\"") && page.text.contains("href=\"/docs/\""), "{}", page.text);
        for accept in ["*/*", "application/json", "application/json, text/html;q=0.5", "text/html;q=0, */*"] {
            ask("GET", path, accept).expect(404);
        }
        ask("POST", path, browser).expect(404);
    }
    // Unknown names in the API are always problems.
    ask("GET", "/v1/sessions/nobody", browser).expect(404);
}

#[test]
fn hosts_and_origins() {
    let service = Running::start();
    let status = |host: &str, more: &str| {
        let request = format!("GET /livez HTTP/1.1\r\nHost: {host}\r\n{more}Connection: close\r\n\r\n");
        raw(&service, &request).split(' ').nth(1).unwrap_or_default().to_string()
    };
    let own = service.address.clone();
    assert_eq!(status(&own, ""), "200");
    assert_eq!(status("localhost", ""), "200");
    assert_eq!(status("evil.example", ""), "421");
    assert_eq!(status("evil.example", "Origin: http://evil.example\r\n"), "421");
    assert_eq!(status(&own, &format!("Origin: http://{own}\r\n")), "200");
    assert_eq!(status(&own, "Origin: http://evil.example\r\n"), "403");
    assert_eq!(status(&own, "Origin: null\r\n"), "403");
    let upgrade = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\
                   Origin: http://evil.example\r\n";
    assert_eq!(status(&own, upgrade), "403", "WebSockets as well");
}

#[test]
fn malformed_requests_are_answered_or_closed() {
    let service = Running::start();
    let long = format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "a".repeat(200_000));
    let host = "Host: localhost\r\n";
    let requests = [
        "\r\n\r\n\r\n".to_string(),
        "\u{0}\u{1}\u{2}".repeat(100),
        "GET / HTTP/9.9\r\n\r\n".to_string(),
        format!("GET /v1/models/%00%ff HTTP/1.1\r\n{host}Connection: close\r\n\r\n"),
        format!("GET /v1/models/..%2f..%2fetc HTTP/1.1\r\n{host}Connection: close\r\n\r\n"),
        format!("PUT /v1/models/a HTTP/1.1\r\n{host}Content-Length: -5\r\n\r\n"),
        format!("PUT /v1/models/a HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\n\r\nzz\r\n"),
        format!("DELETE /v1/sessions/{} HTTP/1.1\r\n{host}Connection: close\r\n\r\n", "x".repeat(500)),
        long,
    ];
    for request in requests {
        let answer = raw(&service, &request);
        let status = answer.split(' ').nth(1).unwrap_or_default();
        assert!(status.is_empty() || status.starts_with('4'), "{request:.60}: {answer:.200}");
        service.get("/livez").expect(200);
    }
}
