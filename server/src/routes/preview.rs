//! `GET /v1/sessions/{name}/preview`: what a session sees, as pictures over a WebSocket.

use axum::extract::rejection::QueryRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, Query};
use axum::http::{HeaderMap, header};
use isophote_tracker::plain;
use isophote_wire::{PreviewFormat, PreviewPart};
use serde::Deserialize;
use utoipa::IntoParams;

use super::parameters::NameParam;
use super::{Answer, App, RawName, raw, upgraded};
use crate::access::Visitor;
use crate::hub::Mode;
use crate::limits::LIMITS;
use crate::preview::PreviewForm;
use crate::problem::Problem;
use crate::streams::preview::{self, PreviewWish};

/// Pictures a second where nothing else is asked for.
const RATE_HZ: f64 = 30.0;
/// Pixels that one may be the mean of, along x and y.
const STEP_MAX: f64 = 65_536.0;

/// What to be shown, and how.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PreviewQuery {
    /// How pixels are sent. `jpeg` becomes coarser, and then smaller, for who reads slowly.
    #[serde(default)]
    #[param(inline)]
    format: PreviewFormat,
    /// What of the frame is shown.
    #[serde(default)]
    #[param(inline)]
    part: PreviewPart,
    /// Pictures a second, above 0 and up to 60, where frames come as fast. Absent: 30.
    rate: Option<f64>,
    /// Above 0 and up to 1, the full size and the default. Pixels are the means of blocks, whose side is the whole number nearest to
    /// 1/scale.
    scale: Option<f64>,
    /// 1: frames that the session's shadow has fitted as well, as it sees them.
    #[serde(default)]
    shadow: u8,
    /// Messages before it is renewed. Absent: as many as the viewer reads.
    credit: Option<u32>,
}

impl PreviewQuery {
    fn wish(&self) -> Result<PreviewWish, Problem> {
        let rate_hz = self.rate.unwrap_or(RATE_HZ);
        let (least, most) = (LIMITS.rate_hz_least, LIMITS.picture_rate_hz);
        if !(least..=most).contains(&rate_hz) {
            return Err(Problem::bad_request(format!(
                "rate is a number of Hz from {least} to {most}, not {}",
                plain(rate_hz)
            )));
        }
        let scale = self.scale.unwrap_or(1.0);
        if !(scale > 0.0 && scale <= 1.0) {
            return Err(Problem::bad_request(format!(
                "scale is above 0 and at most 1, the full size; not {}",
                plain(scale)
            )));
        }
        if self.credit.is_some_and(|credit| credit > LIMITS.credit) {
            return Err(Problem::bad_request(format!("credit is at most {}", LIMITS.credit)));
        }
        if self.shadow > 1 {
            return Err(Problem::bad_request("shadow is 0 or 1"));
        }
        let step = (1.0 / scale).round().min(STEP_MAX) as usize;
        let form = PreviewForm { format: self.format, part: self.part, step, quality: 0 };
        Ok(PreviewWish { form, rate_hz, credit: self.credit })
    }
}

/// What a session sees, as it fits it.
///
/// A WebSocket (subprotocol `isophote.v1`). Each binary message is a frame, the newest: a length in four bytes, the lowest first, JSON
/// of that length (`PreviewHeader`), and the pixels. The client may renew a credit with a `CreditDocument`.
#[utoipa::path(get, path = "/v1/sessions/{name}/preview", tag = "sessions", operation_id = "preview",
    params(NameParam, PreviewQuery),
    responses((status = 101, description = "The socket is open.")))]
pub async fn get(
    app: App,
    Extension(visitor): Extension<Visitor>,
    name: RawName,
    query: Result<Query<PreviewQuery>, QueryRejection>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Answer {
    let name = raw(name)?;
    let session = app.service.session(&name)?;
    let Query(query) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    let wish = query.wish()?;
    if !headers.contains_key(header::UPGRADE) {
        return Err(Problem::bad_request("a preview comes over a WebSocket"));
    }
    let upgrade = upgraded(&headers, upgrade, LIMITS.message_bytes)?;
    let (hub, preview) = match query.shadow {
        0 => (session.hub().clone(), session.preview().clone()),
        _ => session.shadow().map(|shadow| (shadow.hub().clone(), shadow.preview().clone()))?,
    };
    let subscription = hub.subscribe(Mode::End)?.of(visitor);
    let seat = preview.look(&name, app.pictures.clone())?;
    let held = app.stream.clone();
    Ok(upgrade.on_upgrade(async move |socket| {
        preview::serve(socket, seat, subscription, wish).await;
        drop(held);
    }))
}
