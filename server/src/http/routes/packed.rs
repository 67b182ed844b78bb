//! Serves files that `build.rs` packed into the program; browsers cache and revalidate them by ETag.

use std::io::Read;

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::read::GzDecoder;

use crate::http::preconditions::{EntityTag, Preconditions, Reading};

/// A file of the page or of the book.
pub struct PackedFile {
    /// Path from the folder's root, with `/`.
    pub path: &'static str,
    /// Its media type.
    pub media: &'static str,
    /// Its entity tag, by content.
    pub etag: &'static str,
    /// Whether `bytes` are gzip.
    pub is_compressed: bool,
    /// Its content.
    pub bytes: &'static [u8],
}

/// Finds a file by path; `files` are sorted by path.
pub fn find(files: &'static [PackedFile], path: &str) -> Option<&'static PackedFile> {
    files.binary_search_by(|file| file.path.cmp(path)).ok().and_then(|at| files.get(at))
}

/// Sends a file, decompressed if the client does not accept gzip; `policy` is its Content-Security-Policy.
pub fn sent(file: &PackedFile, status: StatusCode, policy: &'static str, asked: &HeaderMap) -> Response {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(file.media));
    headers.insert(header::ETAG, HeaderValue::from_static(file.etag));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache")); // cached, and revalidated by its tag
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy));
    if status == StatusCode::OK {
        let tag = EntityTag::new(file.etag.trim_matches('"'));
        match Preconditions::of(asked).and_then(|preconditions| preconditions.read("the file", &tag)) {
            Ok(Reading::Whole) => {}
            Ok(Reading::NotModified) => return (StatusCode::NOT_MODIFIED, headers).into_response(),
            Err(problem) => return problem.into_response(),
        }
    }
    if !file.is_compressed {
        return (status, headers, file.bytes).into_response();
    }
    if names(asked, &header::ACCEPT_ENCODING, "gzip") {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        return (status, headers, file.bytes).into_response();
    }
    let mut plain = Vec::new();
    match GzDecoder::new(file.bytes).read_to_end(&mut plain) {
        Ok(_) => (status, headers, plain).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Whether a comma-separated header names a value; not with `gzip;q=0`.
pub fn names(asked: &HeaderMap, header: &HeaderName, wanted: &str) -> bool {
    let lists = asked.get_all(header).into_iter().filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',')).any(|one| {
        let (name, quality) = one.split_once(";q=").unwrap_or((one, "1"));
        name.trim() == wanted && quality.trim().parse() != Ok(0.0)
    })
}
