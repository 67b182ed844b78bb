//! `/`: the sessions and their estimates, live. One page and one script, nothing from elsewhere.

use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};

/// Everything comes from here, and nothing stands in the page itself; its icon is empty.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// A page for people: sessions and their estimates, live.
#[utoipa::path(get, path = "/", tag = "operation", operation_id = "page",
    responses((status = 200, description = "The page.", body = String, content_type = "text/html")))]
pub async fn html() -> Response {
    asset("text/html; charset=utf-8", include_str!("../../web/index.html"))
}

/// Its script.
#[utoipa::path(get, path = "/page.js", tag = "operation", operation_id = "page_script",
    responses((status = 200, description = "The script.", body = String, content_type = "text/javascript")))]
pub async fn script() -> Response {
    asset("text/javascript; charset=utf-8", include_str!("../../web/page.js"))
}

/// Its style.
#[utoipa::path(get, path = "/page.css", tag = "operation", operation_id = "page_style",
    responses((status = 200, description = "The style.", body = String, content_type = "text/css")))]
pub async fn style() -> Response {
    asset("text/css; charset=utf-8", include_str!("../../web/page.css"))
}

fn asset(media: &'static str, text: &'static str) -> Response {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(media));
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    (headers, text).into_response()
}
