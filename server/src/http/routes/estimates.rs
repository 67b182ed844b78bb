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
use crate::http::streams::{body, websocket};
use crate::hub::Mode;
use crate::hub::written::TraceWish;
use crate::limits::LIMITS;
use crate::net::socket::ClientLink;
use crate::problem::Problem;

/// Options of a stream of estimates.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct EstimatesQuery {
    /// `latest` (the default): the newest estimate of each target; `all`: every estimate.
    #[serde(default)]
    #[param(inline)]
    mode: Mode,
    /// Minimum difference of the frame numbers of successive estimates, 1 (the default) or more. `dropped` counts the frames in
    /// between.
    #[serde(default = "one")]
    every: u32,
    /// WebSocket: number of messages before the client renews the credit; as many as the client reads when absent.
    credit: Option<u32>,
    /// `1`: only frames that the session's shadow has fitted as well, with its estimate in `shadow`.
    #[serde(default)]
    shadow: u8,
    /// `1`: adds `trace`, the points that the fit tried.
    #[serde(default)]
    #[param(inline)]
    trace: TraceWish,
}

fn one() -> u32 {
    1
}

/// Streams the estimates of a session.
///
/// If the client upgrades, a WebSocket (subprotocol `isophote.v1`): each text message is an `EstimateView`, and the client renews its
/// credit with a `CreditDocument`. Otherwise server-sent events or lines of JSON, by `Accept`. Events have ids: a client that
/// reconnects with the last id as `Last-Event-ID` continues after that event.
#[utoipa::path(get, path = "/v1/sessions/{name}/estimates", tag = "sessions", operation_id = "estimates",
    params(NameParam, EstimatesQuery, ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that the client received.")),
    responses((status = 101, description = "The socket is open."),
              (status = 200, description = "Estimates, until the session ends.",
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
        // A credit is the client's own pace.
        let link = link.filter(|_| query.credit.is_none()).map(|Extension(link)| link);
        Ok::<_, Problem>(subscription.paced(link))
    };
    if headers.contains_key(header::UPGRADE) {
        let upgrade = upgraded(&headers, upgrade, LIMITS.message_bytes)?;
        let subscription = subscribe()?;
        let held = app.stream.clone();
        return Ok(upgrade.on_upgrade(async move |socket| {
            websocket::serve(socket, subscription, query.credit).await;
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
