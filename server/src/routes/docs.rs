//! `/docs`: the book, as it was built into the program. Nothing of it comes from elsewhere.

use std::io::Read;

use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use flate2::read::GzDecoder;

/// A file of the book.
struct Page {
    /// From the book's top, with `/`.
    path: &'static str,
    media: &'static str,
    /// Changes with the file.
    etag: &'static str,
    /// `bytes` are those of gzip.
    is_compressed: bool,
    bytes: &'static [u8],
}

/// In name order; made by `build.rs`.
static PAGES: &[Page] = include!(concat!(env!("OUT_DIR"), "/book.rs"));

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

/// Any file of the book.
#[utoipa::path(get, path = "/docs/{*path}", tag = "operation", operation_id = "book_page",
    params(("path" = String, Path, description = "From the book's top, with `/`.")),
    responses((status = 200, description = "The file."), (status = 404, description = "The book has no such file.")))]
pub async fn page(Path(path): Path<String>, headers: HeaderMap) -> Response {
    answer(&path, &headers)
}

fn answer(path: &str, asked: &HeaderMap) -> Response {
    let find = |path: &str| PAGES.binary_search_by(|page| page.path.cmp(path)).ok().and_then(|at| PAGES.get(at));
    match (find(path), find("404.html")) {
        (Some(page), _) => sent(page, StatusCode::OK, asked),
        (None, Some(page)) => sent(page, StatusCode::NOT_FOUND, asked),
        (None, None) => StatusCode::NOT_FOUND.into_response(),
    }
}

fn sent(page: &Page, status: StatusCode, asked: &HeaderMap) -> Response {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(page.media));
    headers.insert(header::ETAG, HeaderValue::from_static(page.etag));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache")); // kept, and asked for again by its tag
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    if status == StatusCode::OK && names(asked, &header::IF_NONE_MATCH, page.etag) {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    if !page.is_compressed {
        return (status, headers, page.bytes).into_response();
    }
    if names(asked, &header::ACCEPT_ENCODING, "gzip") {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        return (status, headers, page.bytes).into_response();
    }
    let mut plain = Vec::new();
    match GzDecoder::new(page.bytes).read_to_end(&mut plain) {
        Ok(_) => (status, headers, plain).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Whether a header that lists things, separated by commas, has this one among them; `gzip;q=0` says that it has not.
fn names(asked: &HeaderMap, header: &HeaderName, wanted: &str) -> bool {
    let lists = asked.get_all(header).into_iter().filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',')).any(|one| {
        let (name, quality) = one.split_once(";q=").unwrap_or((one, "1"));
        name.trim().trim_start_matches("W/") == wanted && quality.trim().parse() != Ok(0.0)
    })
}
