//! `/`: the page for people, as `server/web/app` was built. Nothing of it comes from elsewhere.

use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::packed::{PackedFile, find, names, sent};
use crate::problem::Problem;

/// In name order; made by `build.rs`.
static FILES: &[PackedFile] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Everything comes from here, and nothing stands in the page itself; its icon is empty.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// A page for people: what is seen and fitted, live; models to edit; sources to set.
#[utoipa::path(get, path = "/", tag = "operation", operation_id = "page",
    responses((status = 200, description = "The page.", body = String, content_type = "text/html")))]
pub async fn html(headers: HeaderMap) -> Result<Response, Problem> {
    answer("index.html", &headers)
}

/// Its script.
#[utoipa::path(get, path = "/page.js", tag = "operation", operation_id = "page_script",
    responses((status = 200, description = "The script.", body = String, content_type = "text/javascript")))]
pub async fn script(headers: HeaderMap) -> Result<Response, Problem> {
    answer("page.js", &headers)
}

/// Its style.
#[utoipa::path(get, path = "/page.css", tag = "operation", operation_id = "page_style",
    responses((status = 200, description = "The style.", body = String, content_type = "text/css")))]
pub async fn style(headers: HeaderMap) -> Result<Response, Problem> {
    answer("page.css", &headers)
}

/// A part of its script that is loaded when it is first needed.
#[utoipa::path(get, path = "/page/{file}", tag = "operation", operation_id = "page_part",
    params(("file" = String, Path, description = "Its name.")),
    responses((status = 200, description = "The script.", body = String, content_type = "text/javascript"),
              (status = 404, description = "There is no such part.")))]
pub async fn part(Path(file): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    answer(&format!("page/{file}"), &headers)
}

/// No route has this path: a browser gets a page with links, an API client a problem document.
pub async fn unknown_route(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let page = find(FILES, "404.html").filter(|_| is_navigation(&method, &headers));
    let mut response = match page {
        Some(page) => sent(page, StatusCode::NOT_FOUND, POLICY, &headers),
        None => Problem::unknown("route", uri.path()).into_response(),
    };
    response.headers_mut().append(header::VARY, HeaderValue::from_static("accept"));
    response
}

/// Whether a browser's user opens an address: HTML is accepted by name, and JSON is not.
pub fn is_navigation(method: &Method, asked: &HeaderMap) -> bool {
    let accepts = |media: &str| names(asked, &header::ACCEPT, media);
    let is_read = matches!(*method, Method::GET | Method::HEAD);
    is_read && accepts("text/html") && !accepts("application/json") && !accepts("application/problem+json")
}

fn answer(path: &str, asked: &HeaderMap) -> Result<Response, Problem> {
    let file = find(FILES, path).ok_or_else(|| Problem::unknown("file of the page", path))?;
    Ok(sent(file, StatusCode::OK, POLICY, asked))
}
