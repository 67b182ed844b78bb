//! Streams estimates as a response body: server-sent events, or one JSON object per line.

use std::convert::Infallible;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;

use crate::http::app::StreamHold;
use crate::hub::written::SentEstimate;
use crate::hub::{Next, Subscription};
use crate::limits::LIMITS;

/// Framing of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framing {
    /// `text/event-stream`
    Events,
    /// `application/x-ndjson`
    Lines,
}

impl Framing {
    /// The first framing that `Accept` names; lines for wildcards.
    pub fn accepted(accept: &str) -> Option<Framing> {
        accept.split(',').find_map(|item| match item.split(';').next().unwrap_or_default().trim() {
            "text/event-stream" => Some(Framing::Events),
            "application/x-ndjson" | "application/*" | "*/*" => Some(Framing::Lines),
            _ => None,
        })
    }

    fn media(self) -> &'static str {
        match self {
            Framing::Events => "text/event-stream",
            Framing::Lines => "application/x-ndjson",
        }
    }

    fn message(self, estimate: &SentEstimate) -> String {
        let json = estimate.json();
        match self {
            Framing::Events => format!("id: {}\ndata: {json}\n\n", estimate.event_id()),
            Framing::Lines => format!("{json}\n"),
        }
    }
}

/// The response; it ends with the session or the service.
pub fn response(subscription: Subscription, format: Framing, held: StreamHold) -> Response {
    let stream = stream::unfold((subscription, held), move |(mut subscription, held)| async move {
        let quiet = if format == Framing::Events { LIMITS.ping_time } else { Duration::MAX };
        let message = match tokio::time::timeout(quiet, subscription.next()).await {
            Err(_) => Bytes::from_static(b": still here\n\n"),
            Ok(Next::Estimate(estimate)) => {
                let mut message = format.message(&estimate);
                while let Some(more) = subscription.more() {
                    message += &format.message(&more);
                }
                subscription.sent(message.len());
                message.into()
            }
            Ok(Next::End(_)) => return None,
        };
        Some((Ok::<Bytes, Infallible>(message), (subscription, held)))
    });
    let mut response = Body::from_stream(stream).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(format.media()));
    // Proxies must neither buffer the stream nor compress it.
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store, no-transform"));
    headers.insert(HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accept_picks_the_format() {
        assert_eq!(Framing::accepted("text/event-stream"), Some(Framing::Events));
        assert_eq!(Framing::accepted("text/html, application/x-ndjson;q=0.9"), Some(Framing::Lines));
        assert_eq!(Framing::accepted("*/*"), Some(Framing::Lines));
        assert_eq!(Framing::accepted("image/png"), None);
    }
}
