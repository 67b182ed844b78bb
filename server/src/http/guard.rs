//! Middleware before all routes: checks the host and origin of a request and the role of its token. Routes find a [`Visitor`].

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;

use crate::access::{
    Access, ChangeRequest, LocalAddress, Secret, Visitor, WEBSOCKET_PREFIX, is_compiling, role_needed,
};
use crate::http::routes::is_navigation;
use crate::limits::LIMITS;
use crate::problem::Problem;

/// Query keys that usually carry tokens.
const TOKEN_KEYS: [&str; 5] = ["token", "access_token", "bearer", "authorization", "api_key"];

/// The middleware. A panic of a handler is answered with 500; the connection stays.
pub async fn guard(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    let route = route(&request);
    let response = match admit(&access, &request, &route) {
        Err(problem) => problem.into_response(),
        Ok(visitor) => {
            let change = ChangeRequest::of(&visitor, request.method(), &route, request.uri().path());
            request.extensions_mut().insert(visitor);
            let answered = AssertUnwindSafe(next.run(request)).catch_unwind().await;
            let answered = answered.unwrap_or_else(|_| Problem::bug("the request's handler panicked").into_response());
            if let Some(change) = change {
                change.answered(answered.status());
            }
            answered
        }
    };
    hardened(response)
}

/// Browsers neither sniff media types nor send a `Referer`.
fn hardened(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    response
}

fn admit(access: &Access, request: &Request, route: &str) -> Result<Visitor, Problem> {
    let (uri, headers) = (request.uri(), request.headers());
    let arrival = request.extensions().get::<LocalAddress>().ok_or_else(|| Problem::bug("a request from nowhere"))?;
    access.hosts.check(*arrival, uri.authority().map(|a| a.as_str()), headers)?;
    refuse_tokens_in(uri)?;
    let is_known = request.extensions().get::<MatchedPath>().is_some();
    if !is_known && is_navigation(request.method(), headers) {
        return Ok(Visitor::Anyone); // the page of unknown routes is public
    }
    identify(access, request.method(), route, headers)
}

/// The router's pattern, for actions of models with the verb; the path if no route matches.
fn route(request: &Request) -> String {
    let path = request.uri().path();
    with_verb(request.extensions().get::<MatchedPath>().map_or(path, MatchedPath::as_str), path)
}

/// Refuses tokens in URLs, which end up in logs and histories. The answer does not quote them.
fn refuse_tokens_in(uri: &Uri) -> Result<(), Problem> {
    let query = uri.query().unwrap_or_default();
    let names = query.split('&').map(|pair| pair.split('=').next().unwrap_or_default());
    let is_named = |name: &str| TOKEN_KEYS.iter().any(|key| key.eq_ignore_ascii_case(name));
    if !names.into_iter().any(is_named) && !Secret::is_in(query) && !Secret::is_in(uri.path()) {
        return Ok(());
    }
    let detail = "there is a token in the address, which others may have seen: revoke it, and send the next one as \
                  `Authorization: Bearer …`";
    Err(Problem::new(StatusCode::BAD_REQUEST, "token-in-address", detail))
}

/// `/v1/models/{name}:fit`: the router takes the verb for a part of the name.
fn with_verb(route: &str, path: &str) -> String {
    match path.rsplit_once(':') {
        Some((_, verb)) if route == "/v1/models/{name}" => format!("{route}:{verb}"),
        _ => route.to_string(),
    }
}

fn identify(access: &Access, method: &Method, route: &str, headers: &HeaderMap) -> Result<Visitor, Problem> {
    let Some(keyring) = &access.keyring else { return Ok(Visitor::Anyone) };
    let Some(role) = role_needed(method, route) else { return Ok(Visitor::Anyone) };
    let secret = secret(headers)?;
    let unknown = || unauthorized("the token is not known, or was revoked; `isophote token new` makes another one");
    let identity = keyring.identify(&secret).ok_or_else(unknown)?;
    if identity.role() < role {
        let detail = format!("this needs the role {role}; the token `{}` has {}", identity.name(), identity.role());
        return Err(Problem::new(StatusCode::FORBIDDEN, "role-too-low", detail));
    }
    if is_compiling(method, route) && !keyring.compiles.take(identity.tenant(), Instant::now()) {
        let detail = format!("no more than {} documents a minute are compiled for a tenant", LIMITS.compiles_a_minute);
        return Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "too-often", detail));
    }
    Ok(Visitor::Known(identity, keyring.clone()))
}

/// The token of a request: from `Authorization`, or from a WebSocket's subprotocols.
fn secret(headers: &HeaderMap) -> Result<Secret, Problem> {
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let text = match (values.next(), values.next()) {
        (Some(value), None) => value.to_str().ok().and_then(bearer),
        (Some(_), Some(_)) => None,
        (None, _) => match subprotocol(headers) {
            None => return Err(unauthorized("this needs a token: `Authorization: Bearer isophote_…`")),
            token => token,
        },
    };
    let malformed =
        || unauthorized("this is no token: one is `Bearer isophote_` and 64 digits, as it was printed once");
    text.and_then(Secret::parse).ok_or_else(malformed)
}

fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn subprotocol(headers: &HeaderMap) -> Option<&str> {
    let is_upgrade = headers.contains_key(header::UPGRADE);
    let offered = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).iter().filter(|_| is_upgrade);
    let mut names = offered.filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(','));
    names.find_map(|name| name.trim().strip_prefix(WEBSOCKET_PREFIX))
}

fn unauthorized(detail: &str) -> Problem {
    Problem::new(StatusCode::UNAUTHORIZED, "no-token", detail)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use axum::Router;
    use axum::body::{Body, to_bytes};
    use axum::routing::{get, put};
    use tower::ServiceExt;
    use tracing::Level;

    use super::*;
    use crate::access::{AccessOptions, Role, TokenFile};
    use crate::test_log::logged;

    fn request(method: &str, path: &str, token: &str) -> Request {
        let request = Request::builder().method(method).uri(path).header(header::HOST, "localhost");
        let mut request = request.header(header::AUTHORIZATION, format!("Bearer {token}")).body(Body::empty()).unwrap();
        request.extensions_mut().insert(LocalAddress { local: [127, 0, 0, 1].into() });
        request
    }

    #[test]
    fn a_change_is_logged_if_the_client_disconnects_before_the_answer() {
        let data = std::env::temp_dir().join(format!("isophote-hang-up-{}", std::process::id()));
        let file = TokenFile::of(None, Some(&data)).unwrap();
        let token = file.add(Role::Operate, None).unwrap().1.text();
        let options = AccessOptions { tokens: Some(file.path().to_path_buf()), ..AccessOptions::default() };
        let access = Arc::new(options.open(([127, 0, 0, 1], 0).into(), None).unwrap());
        let (never, done) = (put(std::future::pending::<()>), put(|| async {}));
        let routes = Router::new().route("/v1/sessions/{name}/shadow", never).route("/v1/sessions/{name}", done);
        let router = routes.layer(axum::middleware::from_fn_with_state(access, guard));
        let events = logged(|| {
            assert!(router.clone().oneshot(request("PUT", "/v1/sessions/one", &token)).now_or_never().is_some());
            assert!(router.oneshot(request("PUT", "/v1/sessions/one/shadow", &token)).now_or_never().is_none());
        });
        let events = events.iter().filter(|event| event.level <= Level::INFO);
        let messages: Vec<&String> = events.filter_map(|event| event.fields.get("message")).collect();
        assert_eq!(messages, ["change made", "change not answered: connection closed"]);
        std::fs::remove_dir_all(&data).unwrap();
    }

    /// A panic planted in a route is answered with 500, and the next request is answered.
    #[tokio::test]
    async fn a_panic_in_a_route_is_answered_with_500() {
        let access = Arc::new(AccessOptions::default().open(([127, 0, 0, 1], 0).into(), None).unwrap());
        let panics = || async { if std::hint::black_box(true) { panic!("planted") } else { "well" } };
        let routes = Router::new().route("/panics", get(panics)).route("/works", get(|| async { "well" }));
        let router = routes.layer(axum::middleware::from_fn_with_state(access, guard));
        for (path, status, said) in [("/panics", 500, "\"bug\""), ("/works", 200, "well"), ("/panics", 500, "\"bug\"")]
        {
            let response = router.clone().oneshot(request("GET", path, "")).await.unwrap();
            assert_eq!(response.status().as_u16(), status, "{path}");
            let body = to_bytes(response.into_body(), 10_000).await.unwrap();
            assert!(String::from_utf8_lossy(&body).contains(said), "{body:?}");
        }
    }
}
