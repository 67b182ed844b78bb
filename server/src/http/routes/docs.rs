//! `/docs`: the book, built into the program. It loads nothing from other origins.

use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};

use super::packed::{PackedFile, find, sent};

/// Sorted by path; made by `build.rs`.
static FILES: &[PackedFile] = include!(concat!(env!("OUT_DIR"), "/book.rs"));

/// Allows the book's own files only; its 404 page sets `base`.
const POLICY: &str =
    "default-src 'self'; img-src 'self' data:; base-uri 'self'; form-action 'none'; frame-ancestors 'self'";

/// Redirects to the first page of the book.
#[utoipa::path(get, path = "/docs", tag = "operation", operation_id = "book",
    responses((status = 308, description = "Redirect to `/docs/`.")))]
pub async fn start() -> Redirect {
    Redirect::permanent("/docs/")
}

/// Returns the first page of the book.
#[utoipa::path(get, path = "/docs/", tag = "operation", operation_id = "book_index",
    responses((status = 200, description = "The page.", body = String, content_type = "text/html")))]
pub async fn index(headers: HeaderMap) -> Response {
    answer("index.html", &headers)
}

/// Returns a file of the book; the extension `.html` may be omitted.
#[utoipa::path(get, path = "/docs/{path}", tag = "operation", operation_id = "book_page",
    params(("path" = String, Path, description = "Path in the book; may contain `/`.")),
    responses((status = 200, description = "The file."), (status = 404, description = "The book has no such file.")))]
pub async fn page(Path(path): Path<String>, headers: HeaderMap) -> Response {
    answer(&path, &headers)
}

fn answer(path: &str, asked: &HeaderMap) -> Response {
    let file = find(FILES, path).or_else(|| find(FILES, &format!("{path}.html")));
    match (file, find(FILES, "404.html")) {
        (Some(file), _) => sent(file, StatusCode::OK, POLICY, asked),
        (None, Some(file)) => sent(file, StatusCode::NOT_FOUND, POLICY, asked),
        (None, None) => StatusCode::NOT_FOUND.into_response(),
    }
}
