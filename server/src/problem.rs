//! `Problem`: an error answer (RFC 9457).

use std::collections::BTreeMap;

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use isophote_jit::CompileError;
use isophote_symbolic::{Diagnostic, Diagnostics};
use isophote_tracker::CompileFailure;
use isophote_wire::ProblemDocument;
use isophote_wire::explain::ExplainError;

/// An error with its status, a stable code, a sentence, and diagnostics where a document is wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The HTTP status.
    pub status: StatusCode,
    /// Stable code, to branch on.
    pub code: &'static str,
    /// A sentence for people.
    pub detail: String,
    /// Faults of the document.
    pub diagnostics: Diagnostics,
    /// Measured figures, by name.
    pub figures: BTreeMap<String, f64>,
}

impl Problem {
    /// Any status.
    pub fn new(status: StatusCode, code: &'static str, detail: impl Into<String>) -> Problem {
        Problem { status, code, detail: detail.into(), diagnostics: Vec::new(), figures: BTreeMap::new() }
    }
    /// 404: there is no such model, source, session or route.
    pub fn unknown(what: &str, name: &str) -> Problem {
        let shown: String = name.chars().take(80).collect();
        Problem::new(StatusCode::NOT_FOUND, "unknown-name", format!("there is no {what} `{shown}`"))
    }
    /// 400: wrong query or header.
    pub fn bad_request(detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::BAD_REQUEST, "bad-request", detail)
    }
    /// 405.
    pub fn wrong_method() -> Problem {
        Problem::new(StatusCode::METHOD_NOT_ALLOWED, "wrong-method", "this route does not have that method")
    }
    /// 409: in use, or not applicable in this state.
    pub fn conflict(code: &'static str, detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::CONFLICT, code, detail)
    }
    /// 412: `If-Match` names another version.
    pub fn stale(detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::PRECONDITION_FAILED, "stale", detail)
    }
    /// 413.
    pub fn too_large(limit_bytes: usize) -> Problem {
        Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "too-large", format!("the body is larger than {limit_bytes} bytes"))
    }
    /// 415.
    pub fn wrong_type(accepted: &str) -> Problem {
        Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "wrong-type", format!("the body must be {accepted}"))
    }
    /// 422: the document is wrong; the diagnostics say where.
    pub fn wrong_document(diagnostics: Diagnostics) -> Problem {
        let first = diagnostics.first();
        let detail = match (first, diagnostics.len()) {
            (None, _) => "the document is wrong".to_string(),
            (Some(one), 1) => one.message.clone(),
            (Some(one), n) => format!("{} (and {} more)", one.message, n - 1),
        };
        let status = StatusCode::UNPROCESSABLE_ENTITY;
        Problem { diagnostics, ..Problem::new(status, "wrong-document", detail) }
    }
    /// 409: a pushed frame that will not be fitted any more.
    pub fn session_ended() -> Problem {
        Problem::conflict("not-applicable", "the session ended before the frame was fitted")
    }
    /// 422 with one diagnostic at `key`, whose position `documents` fills in from the text.
    pub fn wrong_key(code: &str, key: &str, message: impl Into<String>) -> Problem {
        let mut diagnostic = Diagnostic::error("", code, key, isophote_symbolic::Span::default(), message);
        diagnostic.key = key.to_string();
        Problem::wrong_document(vec![diagnostic])
    }
    /// 429: over a limit.
    pub fn over_limit(what: &str, limit: usize) -> Problem {
        Problem::new(StatusCode::TOO_MANY_REQUESTS, "over-limit", format!("there can be no more than {limit} {what}"))
    }
    /// 503: the service is about to stop.
    pub fn stopping() -> Problem {
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "stopping", "the service is stopping")
    }
    /// 503: a timeout.
    pub fn late(detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "late", detail)
    }
    /// 503: temporarily unavailable, and why.
    pub fn not_ready(detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "not-ready", detail)
    }
    /// 503: the system cannot start a thread.
    pub fn no_thread(what: &str, error: &std::io::Error) -> Problem {
        Problem::not_ready(format!("the machine has no thread {what}, what runs goes on: {error}"))
    }
    /// 503: the system gives no memory for machine code; what runs goes on.
    pub fn no_code_memory(why: &str) -> Problem {
        let detail =
            format!("the machine has no memory for the model's code, what runs goes on with what it has: {why}");
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "no-code-memory", detail)
    }
    /// 500: a bug of the service.
    pub fn bug(detail: impl Into<String>) -> Problem {
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "bug", detail)
    }

    /// Adds a measured figure; its unit is part of the name.
    pub fn with_figure(mut self, name: &str, figure: f64) -> Problem {
        self.figures.insert(name.to_string(), figure);
        self
    }

    /// The JSON form.
    pub fn document(&self) -> ProblemDocument {
        ProblemDocument {
            kind: format!("/docs/errors#{}", self.code),
            code: self.code.to_string(),
            title: self.status.canonical_reason().unwrap_or("Error").to_string(),
            status: self.status.as_u16(),
            detail: self.detail.clone(),
            diagnostics: self.diagnostics.clone(),
            figures: self.figures.clone(),
        }
    }
}

/// 422 for a fault of the model; else as of [`ExplainError`].
impl From<CompileFailure> for Problem {
    fn from(failure: CompileFailure) -> Problem {
        match failure {
            CompileFailure::Model(diagnostics) => Problem::wrong_document(diagnostics),
            CompileFailure::Kernel(error) => ExplainError::from(CompileError::clone(&error)).into(),
        }
    }
}

impl From<ExplainError> for Problem {
    fn from(error: ExplainError) -> Problem {
        match error {
            ExplainError::Question(_) => Problem::bad_request(error.to_string()),
            ExplainError::Model(diagnostics) => Problem::wrong_document(diagnostics),
            ExplainError::Kernel(CompileError::NoCodeMemory(why)) => Problem::no_code_memory(&why),
            ExplainError::Kernel(_) => Problem::bug(error.to_string()),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let body = serde_json::to_vec(&self.document()).unwrap_or_default();
        let mut response = (self.status, body).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if self.status == StatusCode::TOO_MANY_REQUESTS || ["full", "no-code-memory"].contains(&self.code) {
            // Thirty a minute: the next one is free after two seconds.
            let after_s = if self.code == "too-often" { "2" } else { "1" };
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static(after_s));
        }
        response
    }
}
