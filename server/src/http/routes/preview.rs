//! `GET /v1/sessions/{name}/preview`: pictures of a session's frames over a WebSocket.

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
use crate::http::streams::preview::{self, PreviewWish};
use crate::hub::Mode;
use crate::limits::LIMITS;
use crate::preview::PreviewForm;
use crate::problem::Problem;

/// Default rate of pictures.
const RATE_HZ: f64 = 30.0;
/// Largest reduction along x and y.
const STEP_MAX: f64 = 65_536.0;

/// Content and format of a preview.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PreviewQuery {
    /// Encoding of the pixels. If the client reads slowly, `jpeg` becomes coarser, then smaller.
    #[serde(default)]
    #[param(inline)]
    format: PreviewFormat,
    /// Part or quantity to show.
    #[serde(default)]
    #[param(inline)]
    part: PreviewPart,
    /// Maximum number of pictures per second, 0.001 to 60; 30 when absent.
    rate: Option<f64>,
    /// Scale, above 0 and up to 1 (full size, the default). Pixels are means of blocks, whose side is the integer nearest to 1/scale.
    scale: Option<f64>,
    /// `1`: only frames that the session's shadow has fitted as well, with its estimates, residuals and contours.
    #[serde(default)]
    shadow: u8,
    /// Number of messages before the client renews the credit; as many as the client reads when absent.
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

/// Streams previews of the frames that a session fits.
///
/// A WebSocket (subprotocol `isophote.v1`). Each binary message contains the newest frame: a length in four bytes (little-endian),
/// JSON of that length (`PreviewHeader`), and the pixels. The client may renew its credit with a `CreditDocument`.
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
