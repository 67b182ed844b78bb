//! Files that `build.rs` packed into the program, as answers: kept by browsers, and asked for again by their tags.

use std::io::Read;

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::read::GzDecoder;

use crate::preconditions::{EntityTag, Preconditions, Reading};

/// A file of the page or of the book.
pub struct PackedFile {
    /// From the folder's top, with `/`.
    pub path: &'static str,
    /// Its type.
    pub media: &'static str,
    /// Changes with the file.
    pub etag: &'static str,
    /// `bytes` are those of gzip.
    pub is_compressed: bool,
    /// What it holds.
    pub bytes: &'static [u8],
}

/// The file of this path; `files` are in the order of theirs.
pub fn find(files: &'static [PackedFile], path: &str) -> Option<&'static PackedFile> {
    files.binary_search_by(|file| file.path.cmp(path)).ok().and_then(|at| files.get(at))
}

/// A file, as whoever asks can read it; `policy` says what a browser may load for it.
pub fn sent(file: &PackedFile, status: StatusCode, policy: &'static str, asked: &HeaderMap) -> Response {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(file.media));
    headers.insert(header::ETAG, HeaderValue::from_static(file.etag));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache")); // kept, and asked for again by its tag
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

/// Whether a header that lists things, separated by commas, has this one among them; `gzip;q=0` says that it has not.
pub fn names(asked: &HeaderMap, header: &HeaderName, wanted: &str) -> bool {
    let lists = asked.get_all(header).into_iter().filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',')).any(|one| {
        let (name, quality) = one.split_once(";q=").unwrap_or((one, "1"));
        name.trim() == wanted && quality.trim().parse() != Ok(0.0)
    })
}
