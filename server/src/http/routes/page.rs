//! `/`: the web page built from `server/web/app`. It loads nothing from other origins.

use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::packed::{PackedFile, find, names, sent};
use crate::problem::Problem;

/// Sorted by path; made by `build.rs`.
static FILES: &[PackedFile] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Allows files of this origin only and nothing inline, except the empty icon.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// Returns the web page: live frames and fits, a model editor, and source settings.
#[utoipa::path(get, path = "/", tag = "operation", operation_id = "page",
    responses((status = 200, description = "The page.", body = String, content_type = "text/html")))]
pub async fn html(headers: HeaderMap) -> Result<Response, Problem> {
    answer("index.html", &headers)
}

/// Returns the script of the web page.
#[utoipa::path(get, path = "/page.js", tag = "operation", operation_id = "page_script",
    responses((status = 200, description = "The script.", body = String, content_type = "text/javascript")))]
pub async fn script(headers: HeaderMap) -> Result<Response, Problem> {
    answer("page.js", &headers)
}

/// Returns the style sheet of the web page.
#[utoipa::path(get, path = "/page.css", tag = "operation", operation_id = "page_style",
    responses((status = 200, description = "The style sheet.", body = String, content_type = "text/css")))]
pub async fn style(headers: HeaderMap) -> Result<Response, Problem> {
    answer("page.css", &headers)
}

/// Returns a script that the web page loads on demand.
#[utoipa::path(get, path = "/page/{file}", tag = "operation", operation_id = "page_part",
    params(("file" = String, Path, description = "File name.")),
    responses((status = 200, description = "The script.", body = String, content_type = "text/javascript"),
              (status = 404, description = "The page has no such file.")))]
pub async fn part(Path(file): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    answer(&format!("page/{file}"), &headers)
}

/// Answers an unknown route: with a page of links for a browser, a problem document for an API client.
pub async fn unknown_route(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let page = find(FILES, "404.html").filter(|_| is_navigation(&method, &headers));
    let mut response = match page {
        Some(page) => sent(page, StatusCode::NOT_FOUND, POLICY, &headers),
        None => Problem::unknown("route", uri.path()).into_response(),
    };
    response.headers_mut().append(header::VARY, HeaderValue::from_static("accept"));
    response
}

/// Whether a browser navigates: `Accept` names HTML, and not JSON.
pub fn is_navigation(method: &Method, asked: &HeaderMap) -> bool {
    let accepts = |media: &str| names(asked, &header::ACCEPT, media);
    let is_read = matches!(*method, Method::GET | Method::HEAD);
    is_read && accepts("text/html") && !accepts("application/json") && !accepts("application/problem+json")
}

fn answer(path: &str, asked: &HeaderMap) -> Result<Response, Problem> {
    let file = find(FILES, path).ok_or_else(|| Problem::unknown("file of the page", path))?;
    Ok(sent(file, StatusCode::OK, POLICY, asked))
}
