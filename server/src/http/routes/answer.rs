//! Shared by the handlers: answers, names in paths, and upgrades.

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::http::preconditions::{EntityTag, Preconditions, Reading};
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::service::Put;

/// The name of the WebSockets' subprotocol.
const PROTOCOL: &str = "isophote.v1";

/// The result of a handler.
pub type Answer = Result<Response, Problem>;

/// A JSON body.
pub fn json(status: StatusCode, value: &impl Serialize) -> Answer {
    let body = serde_json::to_vec(value).map_err(|error| Problem::bug(error.to_string()))?;
    let mut response = (status, body).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Ok(response)
}

/// A JSON body with an entity tag.
pub fn tagged(status: StatusCode, value: &impl Serialize, tag: Option<&EntityTag>) -> Answer {
    let mut response = json(status, value)?;
    if let Some(tag) = tag {
        response.headers_mut().insert(header::ETAG, tag.header()?);
    }
    Ok(response)
}

/// The whole `response` with its tag, or 304 if the client has it. Clients may cache it and revalidate.
pub fn representation(preconditions: &Preconditions, what: &str, tag: &EntityTag, response: Response) -> Answer {
    let mut response = match preconditions.read(what, tag)? {
        Reading::Whole => response,
        Reading::NotModified => StatusCode::NOT_MODIFIED.into_response(),
    };
    let headers = response.headers_mut();
    headers.insert(header::ETAG, tag.header()?);
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    Ok(response)
}

/// A JSON body tagged by its bytes.
pub fn listed(preconditions: &Preconditions, value: &impl Serialize) -> Answer {
    let body = serde_json::to_vec(value).map_err(|error| Problem::bug(error.to_string()))?;
    let tag = EntityTag::of_bytes(&body);
    let response = ([(header::CONTENT_TYPE, "application/json")], body).into_response();
    representation(preconditions, "this answer", &tag, response)
}

/// A document with its state. The tag covers the document only, so the answer must not be cached.
pub fn stateful(preconditions: &Preconditions, what: &str, tag: Option<&EntityTag>, value: &impl Serialize) -> Answer {
    let mut response = match preconditions.read_state(what, tag)? {
        Reading::Whole => tagged(StatusCode::OK, value, tag)?,
        Reading::NotModified => StatusCode::NOT_MODIFIED.into_response(),
    };
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// The name in the path as sent, not looked up yet.
pub type RawName = Result<Path<String>, PathRejection>;

/// The name in the path as text; 404 if it is not UTF-8.
pub fn raw(name: RawName) -> Result<String, Problem> {
    name.map(|Path(name)| name).map_err(|_| Problem::unknown("name", "(not UTF-8)"))
}

/// The name of a new resource: 422 if it is malformed.
pub fn new_name(name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    let message = "a name is made of 1 to 64 of a-z, 0-9 and -, and does not begin with -";
    Name::parse(&name).ok_or_else(|| Problem::wrong_key("wrong-name", "name", message))
}

/// The name of an existing resource: 404 if it is malformed.
pub fn old_name(what: &str, name: RawName) -> Result<Name, Problem> {
    let name = raw(name)?;
    Name::parse(&name).ok_or_else(|| Problem::unknown(what, &name))
}

/// Upgrades to the subprotocol, for messages of at most `message_bytes` from the client.
pub(super) fn upgraded(
    headers: &HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
    message_bytes: usize,
) -> Result<WebSocketUpgrade, Problem> {
    let upgrade = upgrade.map_err(|error| Problem::bad_request(error.body_text()))?;
    let is_offered = headers.contains_key(header::SEC_WEBSOCKET_PROTOCOL);
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(message_bytes).max_frame_size(message_bytes);
    // Each socket holds both buffers while it is open.
    let upgrade = upgrade.read_buffer_size(LIMITS.websocket_bytes).write_buffer_size(LIMITS.websocket_bytes);
    if is_offered && upgrade.selected_protocol().is_none() {
        return Err(Problem::bad_request(format!("the subprotocol is {PROTOCOL}")));
    }
    Ok(upgrade)
}

/// 201 or 200.
pub(super) fn put_status(put: Put) -> StatusCode {
    match put {
        Put::Created => StatusCode::CREATED,
        Put::Replaced => StatusCode::OK,
    }
}
