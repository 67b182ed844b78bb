//! `/docs`: the book, as it was built into the program. Nothing of it comes from elsewhere.

use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};

use super::packed::{PackedFile, find, sent};

/// In name order; made by `build.rs`.
static FILES: &[PackedFile] = include!(concat!(env!("OUT_DIR"), "/book.rs"));

/// Styles and scripts are the book's own files; the page of what is not found names its folder (`base`).
const POLICY: &str =
    "default-src 'self'; img-src 'self' data:; base-uri 'self'; form-action 'none'; frame-ancestors 'self'";

/// The way to the book's first page.
#[utoipa::path(get, path = "/docs", tag = "operation", operation_id = "book",
    responses((status = 308, description = "It begins at `/docs/`.")))]
pub async fn start() -> Redirect {
    Redirect::permanent("/docs/")
}

/// The book's first page.
#[utoipa::path(get, path = "/docs/", tag = "operation", operation_id = "book_index",
    responses((status = 200, description = "The page.", body = String, content_type = "text/html")))]
pub async fn index(headers: HeaderMap) -> Response {
    answer("index.html", &headers)
}

/// Any file of the book; a page without its ending, too.
#[utoipa::path(get, path = "/docs/{path}", tag = "operation", operation_id = "book_page",
    params(("path" = String, Path, description = "From the book's top, with `/`.")),
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
