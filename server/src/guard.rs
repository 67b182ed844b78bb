//! What every request passes before a route sees it: loopback is reachable from any web page the user has open, so the
//! `Host` must be this machine's (else DNS rebinding, 421) and an `Origin` must be our own (else a foreign page, 403).

use std::net::Ipv4Addr;
use std::panic::AssertUnwindSafe;

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;

use crate::problem::Problem;

/// The middleware. A panic behind it is an answer (500), not a broken connection.
pub async fn guard(request: Request, next: Next) -> Response {
    if let Err(problem) = check(request.uri().authority().map(|a| a.as_str()), request.headers()) {
        return problem.into_response();
    }
    let answered = AssertUnwindSafe(next.run(request)).catch_unwind().await;
    let mut response = answered.unwrap_or_else(|_| Problem::bug("the request's handler panicked").into_response());
    let headers = response.headers_mut();
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

fn check(authority: Option<&str>, headers: &HeaderMap) -> Result<(), Problem> {
    let text = |name| headers.get(name).map(|value: &HeaderValue| value.to_str().unwrap_or_default());
    let host = authority.or(text(header::HOST)).unwrap_or_default();
    if headers.get_all(header::HOST).iter().count() > 1 || !is_loopback(host) {
        let detail = "the Host of a request must be localhost, an address of 127.0.0.0/8, or [::1]";
        return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, "foreign-host", detail));
    }
    match text(header::ORIGIN) {
        Some(origin) if !is_same(origin, host) => {
            let detail = "the request comes from a page of another origin";
            Err(Problem::new(StatusCode::FORBIDDEN, "foreign-origin", detail))
        }
        _ => Ok(()),
    }
}

fn is_same(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://").is_some_and(|authority| authority.eq_ignore_ascii_case(host))
}

fn is_loopback(host: &str) -> bool {
    let (name, port) = match host.strip_prefix('[') {
        Some(rest) => match rest.split_once(']') {
            Some((name, port)) => (name, port),
            None => return false,
        },
        None => host.split_at(host.find(':').unwrap_or(host.len())),
    };
    let is_port = port.is_empty() || port.strip_prefix(':').is_some_and(|digits| digits.parse::<u16>().is_ok());
    let is_bracketed = host.starts_with('[');
    let is_ours = |name: &str| name.parse::<Ipv4Addr>().is_ok_and(|address| address.is_loopback());
    is_port && if is_bracketed { name == "::1" } else { is_ours(name) || name.eq_ignore_ascii_case("localhost") }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn hosts_and_origins() {
        let cases: &[(&str, Option<&str>, u16)] = &[
            ("localhost", None, 200),
            ("LocalHost:7240", None, 200),
            ("127.0.0.1:1", None, 200),
            ("[::1]:7240", None, 200),
            ("127.0.0.2:7240", Some("http://127.0.0.2:7240"), 200),
            ("127.255.1.2", None, 200),
            ("[::1]", Some("http://[::1]"), 200),
            ("localhost:7240", Some("http://localhost:7240"), 200),
            ("localhost:7240", Some("http://localhost:3000"), 403),
            ("localhost:7240", Some("https://localhost:7240"), 403),
            ("localhost:7240", Some("http://evil.example"), 403),
            ("localhost:7240", Some("http://localhost:7240.evil.example"), 403),
            ("localhost:7240", Some("null"), 403),
            ("localhost:7240", Some(""), 403),
            ("evil.example", None, 421),
            ("evil.example", Some("http://evil.example"), 421),
            ("localhost.evil.example", None, 421),
            ("127.0.0.1.evil.example", None, 421),
            ("localhost:7240@evil.example", None, 421),
            ("localhost:x", None, 421),
            ("::1", None, 421),
            ("128.0.0.1", None, 421),
            ("127.1", None, 421),
            ("0127.0.0.1", None, 421),
            ("127.0.0.1.", None, 421),
            ("[::2]", None, 421),
            ("[localhost]", None, 421),
            ("0.0.0.0", None, 421),
            ("", None, 421),
        ];
        for (host, origin, status) in cases {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            let found = check(None, &headers).map_or_else(|problem| problem.status.as_u16(), |()| 200);
            assert_eq!(found, *status, "{host} {origin:?}");
        }
        assert_eq!(check(None, &HeaderMap::new()).unwrap_err().status, StatusCode::MISDIRECTED_REQUEST);
    }
}
