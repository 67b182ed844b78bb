//! `GET /v1/sessions/{name}/estimates`: WebSocket where the client upgrades, else server-sent events or NDJSON by `Accept`.

use std::sync::Arc;

use axum::extract::rejection::QueryRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, Query};
use axum::http::{HeaderMap, StatusCode, header};
use isophote_wire::EstimateView;
use serde::Deserialize;
use utoipa::IntoParams;

use super::parameters::NameParam;
use super::{Answer, App, RawName, raw, upgraded};
use crate::access::Visitor;
use crate::hub::Mode;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::prompt::prompt;
use crate::socket::ClientLink;
use crate::streams::{body, websocket};
use crate::written::TraceWish;

/// How to be sent estimates.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct EstimatesQuery {
    /// The newest of each target, or all of them.
    #[serde(default)]
    #[param(inline)]
    mode: Mode,
    /// 1 or more: of so many frames one. `dropped` counts those between as well.
    #[serde(default = "one")]
    every: u32,
    /// WebSocket only. Absent: as many messages as the socket takes.
    credit: Option<u32>,
    /// 1: those that the session's shadow has fitted as well, with what it says of them in `shadow`.
    #[serde(default)]
    shadow: u8,
    /// `1`: estimates also have `trace`, the points that their fits tried.
    #[serde(default)]
    #[param(inline)]
    trace: TraceWish,
}

fn one() -> u32 {
    1
}

/// The estimates of a session as they come.
///
/// A WebSocket (subprotocol `isophote.v1`) where the client upgrades: each text message is an `EstimateView`, and the client renews
/// its credit with a `CreditDocument`. Else server-sent events or lines of JSON, by `Accept`. Events have ids: a reader that comes
/// back with the last one as `Last-Event-ID` goes on behind it.
#[utoipa::path(get, path = "/v1/sessions/{name}/estimates", tag = "sessions", operation_id = "estimates",
    params(NameParam, EstimatesQuery, ("Last-Event-ID" = Option<String>, Header, description = "The id of the last event that the reader has had.")),
    responses((status = 101, description = "The socket is open."),
              (status = 200, description = "Until the session ends.",
               content((EstimateView = "application/x-ndjson"), (EstimateView = "text/event-stream")))))]
pub async fn get(
    app: App,
    Extension(visitor): Extension<Visitor>,
    name: RawName,
    query: Result<Query<EstimatesQuery>, QueryRejection>,
    headers: HeaderMap,
    link: Option<Extension<Arc<ClientLink>>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let Query(query) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    if query.credit.is_some_and(|credit| credit > LIMITS.credit) {
        return Err(Problem::bad_request(format!("credit is at most {}", LIMITS.credit)));
    }
    if query.every == 0 {
        return Err(Problem::bad_request("every is 1 or more: of so many frames one"));
    }
    let hub = match query.shadow {
        0 => session.hub().clone(),
        1 if query.trace == TraceWish::With => {
            return Err(Problem::bad_request("trace tells of the session's own fits; leave shadow out"));
        }
        1 => session.shadow()?.hub().clone(),
        _ => return Err(Problem::bad_request("shadow is 0 or 1")),
    };
    let subscribe = || {
        let subscription = hub.subscribe(query.mode)?.of(visitor).with_trace(query.trace).every(query.every.into());
        // Credit says how much the client has time for.
        let link = link.filter(|_| query.credit.is_none()).map(|Extension(link)| link);
        Ok::<_, Problem>(subscription.paced(link))
    };
    if headers.contains_key(header::UPGRADE) {
        let upgrade = upgraded(&headers, upgrade, LIMITS.message_bytes)?;
        let subscription = subscribe()?;
        let held = app.stream.clone();
        return Ok(upgrade.on_upgrade(async move |socket| {
            prompt(websocket::serve(socket, subscription, query.credit)).await;
            drop(held);
        }));
    }
    let accept = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok()).unwrap_or("*/*");
    let format = body::Framing::accepted(accept).ok_or_else(|| {
        let detail = "estimates come as text/event-stream, application/x-ndjson, or over a WebSocket";
        Problem::new(StatusCode::NOT_ACCEPTABLE, "not-acceptable", detail)
    })?;
    let mut subscription = subscribe()?;
    if format == body::Framing::Events {
        let last = headers.get("last-event-id").and_then(|id| id.to_str().ok()?.parse().ok());
        subscription = subscription.returning(last);
    }
    Ok(body::response(subscription, format, app.stream.clone()))
}
