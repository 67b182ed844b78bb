//! Reads request bodies into typed documents, or problems whose diagnostics name key, line and column.

use axum::body::Body;
use axum::http::{HeaderMap, header};
use futures_util::StreamExt;
use isophote_symbolic::{Diagnostic, Span};
use jsonc_parser::ast::{ObjectPropName, Value};
use jsonc_parser::common::Ranged;
use jsonc_parser::{CollectOptions, ParseOptions, parse_to_ast};
use serde::de::DeserializeOwned;
use tokio::sync::Semaphore;
use utoipa::ToSchema;

use crate::http::objects::list_for_object;
use crate::limits::LIMITS;
use crate::problem::Problem;

/// The media type of the body, without its parameters, in lower case.
pub fn media_type(headers: &HeaderMap) -> String {
    let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Reads a body of at most `limit` bytes. Of a longer one some more is read and discarded, so that a client that sends before
/// it listens gets the answer.
pub async fn read_body(body: Body, limit: usize) -> Result<Vec<u8>, Problem> {
    let read = async {
        let mut stream = body.into_data_stream();
        let mut bytes = Vec::new();
        let mut total = 0;
        while let Some(chunk) = stream.next().await {
            let chunk = chunk.map_err(|error| Problem::bad_request(format!("the body broke off: {error}")))?;
            total += chunk.len();
            if total <= limit {
                bytes.extend_from_slice(&chunk);
            } else if total > limit + LIMITS.drain_bytes {
                break;
            }
        }
        if total > limit { Err(Problem::too_large(limit)) } else { Ok(bytes) }
    };
    let late = |_| Problem::bad_request(format!("the body took more than {} s", LIMITS.body_time.as_secs()));
    tokio::time::timeout(LIMITS.body_time, read).await.map_err(late)?
}

/// A body as text.
pub fn text(bytes: Vec<u8>) -> Result<String, Problem> {
    String::from_utf8(bytes).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let bytes = error.into_bytes();
        let head = String::from_utf8_lossy(&bytes[..valid]).into_owned();
        let span = Span { start: valid as u32, end: valid as u32 + 1 };
        let diagnostic = Diagnostic::error(&head, "not-utf-8", "", span, "the document is not UTF-8 text");
        Problem::wrong_document(vec![diagnostic.help("save it as UTF-8")])
    })
}

/// Limits the documents of all clients parsed at a time; further ones wait.
static PARSERS: Semaphore = Semaphore::const_new(LIMITS.parsers);

/// Works on a document's text on a blocking thread: megabytes of text would block the runtime.
async fn beside<T: Send + 'static>(work: impl FnOnce() -> Result<T, Problem> + Send + 'static) -> Result<T, Problem> {
    let turn = PARSERS.acquire().await.map_err(|_| Problem::stopping())?;
    let work = move || {
        let _turn = turn; // held even if the request is cancelled
        work()
    };
    tokio::task::spawn_blocking(work).await.map_err(|_| Problem::bug("parsing the document panicked"))?
}

/// Reads a JSON body: 415, 413, or 422 with the wrong key and its position.
pub async fn read_json<T: DeserializeOwned + ToSchema + Send + 'static>(
    headers: &HeaderMap,
    body: Body,
) -> Result<(T, String), Problem> {
    if media_type(headers) != "application/json" {
        return Err(Problem::wrong_type("application/json"));
    }
    let bytes = read_body(body, LIMITS.document_bytes).await?;
    let work = move || {
        let text = text(bytes)?;
        Ok((parse(&text)?, text))
    };
    beside(work).await
}

/// Parses a short JSON document: a message, or a part of a query.
pub fn parse<T: DeserializeOwned + ToSchema>(text: &str) -> Result<T, Problem> {
    if let Some(fault) = list_for_object::<T>(text) {
        return Err(Problem::wrong_document(vec![fault]));
    }
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let parsed = serde_path_to_error::deserialize(&mut deserializer);
    let value = parsed.map_err(|error| {
        let path = error.path().to_string();
        wrong(text, if path == "." { "" } else { &path }, error.inner())
    })?;
    deserializer.end().map_err(|error| wrong(text, "", &error))?;
    Ok(value)
}

fn wrong(text: &str, path: &str, error: &serde_json::Error) -> Problem {
    let message = error.to_string();
    let message = message.split(" at line ").next().unwrap_or_default().to_string();
    let at = offset(text, error.line(), error.column());
    if error.is_syntax() || error.is_eof() {
        let span = Span { start: at, end: at };
        return Problem::wrong_document(vec![Diagnostic::error(text, "syntax", path, span, message)]);
    }
    // A source document is an enum tagged by kind, which hides the path inside it: the message names the key then.
    let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    let (code, key) = match unknown {
        Some(name) if path == name || path.ends_with(&format!(".{name}")) => ("unknown-key", path.to_string()),
        Some(name) if path.is_empty() => ("unknown-key", name.to_string()),
        Some(name) => ("unknown-key", format!("{path}.{name}")),
        None if message.starts_with("missing field") => ("missing-key", path.to_string()),
        None => ("wrong-value", path.to_string()),
    };
    Problem::wrong_document(vec![placed(text, code, &key, message)])
}

/// A diagnostic at the value of `key` (a path with dots), or at its nearest parent in the text.
pub fn placed(text: &str, code: &str, key: &str, message: impl Into<String>) -> Diagnostic {
    Diagnostic::error(text, code, key, span_of(text, key), message)
}

/// Fills in the positions of diagnostics that have only a key, from the `text` that was sent.
pub async fn place<T: Send + 'static>(result: Result<T, Problem>, text: &str) -> Result<T, Problem> {
    let lacks_place = |diagnostic: &Diagnostic| diagnostic.span == Span::default() && !diagnostic.key.is_empty();
    let mut problem = match result {
        Err(problem) if problem.diagnostics.iter().any(lacks_place) => problem,
        placed => return placed,
    };
    let text = text.to_string();
    let work = move || {
        let parsed = parse_to_ast(&text, &CollectOptions::default(), &ParseOptions::default()).ok();
        let value = parsed.as_ref().and_then(|parsed| parsed.value.as_ref());
        for diagnostic in problem.diagnostics.iter_mut().filter(|diagnostic| lacks_place(diagnostic)) {
            let (span, help) =
                (value.map_or(Span::default(), |value| span_in(value, &diagnostic.key)), diagnostic.help.take());
            *diagnostic = Diagnostic::error(&text, &diagnostic.code, &diagnostic.key, span, diagnostic.message.clone());
            diagnostic.help = help;
        }
        Err(problem)
    };
    beside(work).await
}

fn span_of(text: &str, key: &str) -> Span {
    let parsed = parse_to_ast(text, &CollectOptions::default(), &ParseOptions::default()).ok();
    parsed.and_then(|parsed| Some(span_in(parsed.value.as_ref()?, key))).unwrap_or_default()
}

fn span_in(mut value: &Value<'_>, key: &str) -> Span {
    let mut range = value.range();
    for part in key.split('.').filter(|part| !part.is_empty()) {
        let Value::Object(object) = value else { break };
        let Some(property) = object.properties.iter().find(|p| property_name(&p.name) == part) else { break };
        range = property.range();
        value = &property.value;
    }
    Span { start: range.start as u32, end: range.end as u32 }
}

/// The key's text.
pub fn property_name<'a>(name: &'a ObjectPropName) -> &'a str {
    match name {
        ObjectPropName::String(text) => &text.value,
        ObjectPropName::Word(word) => word.value,
    }
}

/// Byte offset of a line and column (in bytes) from 1.
fn offset(text: &str, line: usize, column: usize) -> u32 {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    (start + column.saturating_sub(1)).min(text.len()) as u32
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use isophote_wire::SessionDocument;

    /// Records the thread that parsed it.
    #[derive(ToSchema)]
    struct Parsed {
        #[schema(value_type = Vec<f64>)]
        on: std::thread::ThreadId,
    }

    impl<'de> serde::Deserialize<'de> for Parsed {
        fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Parsed, D::Error> {
            serde::de::IgnoredAny::deserialize(deserializer)?;
            Ok(Parsed { on: std::thread::current().id() })
        }
    }

    /// A runtime of one thread stays free while documents are parsed.
    #[tokio::test]
    async fn a_few_documents_at_a_time_are_parsed_off_the_runtime() {
        let text = format!("{{\"spots\": [{}{{}}]}}", "{}, ".repeat(500_000));
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, "application/json".parse().unwrap());
        let one = || (headers.clone(), Body::from(text.clone()));
        let tasks: Vec<_> = std::iter::repeat_with(one)
            .take(LIMITS.parsers + 2)
            .map(|(headers, body)| tokio::spawn(async move { read_json::<Parsed>(&headers, body).await }))
            .collect();
        tokio::task::yield_now().await;
        assert!(tasks[LIMITS.parsers..].iter().all(|task| !task.is_finished()), "they wait for those before them");
        for task in tasks {
            let (parsed, _) = task.await.unwrap().unwrap();
            assert_ne!(parsed.on, std::thread::current().id());
        }
        let wrong = Body::from("{\"source\": \"s\",\n \"model\": [0]}");
        let problem = read_json::<SessionDocument>(&headers, wrong).await.unwrap_err();
        assert_eq!((problem.diagnostics[0].line, problem.diagnostics[0].key.as_str()), (2, "model"));
        let keyed = Problem::wrong_key("wrong-value", "b.c", "no");
        let placed = place::<()>(Err(keyed), "{\"a\": 1,\n \"b\": {\"c\": 2}}").await.unwrap_err();
        assert_eq!((placed.diagnostics[0].line, placed.diagnostics[0].column), (2, 8));
    }

    fn fault(text: &str) -> Diagnostic {
        parse::<SessionDocument>(text).unwrap_err().diagnostics.remove(0)
    }

    #[test]
    fn faults_name_key_line_and_column() {
        let cases = [
            ("{\n \"source\": \"s\",\n \"model\": 3}", "model", 3, 2),
            ("{\"source\": \"s\", \"model\": \"m\",\n  \"windw\": 1}", "windw", 2, 3),
            (
                "{\"source\": \"s\", \"model\": \"m\", \"options\": {\"exposure\":\n {\"gaol\": 1}}}",
                "options.exposure.gaol",
                2,
                3,
            ),
            (
                "{\"source\": {\"kind\": \"pushed\",\n \"width\": 1, \"height\": 1, \"depth\": 1}, \"model\": \"m\"}",
                "source.depth",
                2,
                27,
            ),
            ("{\"source\": \"s\"}", "", 1, 1),
            ("{\"source\": \"s\",\n \"model\" \"m\"}", "", 2, 10),
            ("\n [\"s\", \"m\"]", "", 2, 2),
            ("{\"source\": \"s\", \"model\": \"m\",\n \"window\": [1, 2, 3, 4]}", "window", 2, 12),
        ];
        for (text, key, line, column) in cases {
            let fault = fault(text);
            assert_eq!((fault.key.as_str(), fault.line, fault.column), (key, line, column), "{text}\n{fault:?}");
        }
        assert!(fault("{\"source\": \"s\"}").message.contains("model"));
    }
}
