//! HTTP client of the service, and WebSockets for estimates.

use std::io::{Read, Write};
use std::path::PathBuf;
use std::time::Duration;

use isophote_wire::ProblemDocument;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tungstenite::client::IntoClientRequest;
use tungstenite::handshake::HandshakeError;
use tungstenite::http::{HeaderValue, header};
use tungstenite::{Error, Message, WebSocket};

use crate::connection::{ByteStream, Connection};
use crate::failure::Failure;
use crate::output;

/// Address and credentials of the service, and output format
#[derive(Clone, Debug, clap::Args)]
pub struct ServiceArgs {
    /// URL of the service
    #[arg(long, value_name = "URL", env = "ISOPHOTE_SERVER", default_value = DEFAULT)]
    pub server: String,
    /// File whose first line is a token of the service [default: the token in the environment variable ISOPHOTE_TOKEN]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Certificate authorities (PEM) to trust instead of those of this machine
    #[arg(long, value_name = "FILE", env = "ISOPHOTE_CA")]
    pub ca: Option<PathBuf>,
    /// Allow sending the token to another machine without encryption
    #[arg(long)]
    pub insecure: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Default of `--server`.
const DEFAULT: &str = "http://127.0.0.1:7240";

impl ServiceArgs {
    /// Whether `--server` is the default.
    pub fn is_default(&self) -> bool {
        self.server == DEFAULT
    }
}

/// Timeout of an answer; a model compiles in milliseconds, but may queue behind others.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout of a download.
const DOWNLOAD_TIMEOUT: Duration = Duration::from_secs(24 * 3600);
/// Maximum size of an answer.
const ANSWER_BYTES_MAX: u64 = 64 * 1024 * 1024;
/// Chunk size of a download.
const PIECE_BYTES: usize = 64 * 1024;

/// Client of a service.
pub struct RemoteService {
    agent: ureq::Agent,
    connection: Connection,
    /// For an answer, and for the WebSocket handshake.
    timeout: Duration,
}

impl RemoteService {
    /// Connects lazily: sends nothing yet.
    pub fn new(args: &ServiceArgs) -> Result<RemoteService, Failure> {
        Ok(RemoteService::with_timeout(Connection::new(args)?, TIMEOUT))
    }

    fn with_timeout(connection: Connection, timeout: Duration) -> RemoteService {
        RemoteService { agent: connection.agent(timeout), connection, timeout }
    }

    /// `GET`
    pub fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        read(&self.get_text(path, "application/json")?)
    }

    /// `GET`, as text of a media type.
    pub fn get_text(&self, path: &str, accept: &str) -> Result<String, Failure> {
        Ok(self.text(self.prepared(self.agent.get(self.address(path))).header("accept", accept).call())?)
    }

    /// `GET`, with the service's refusal unconverted.
    pub fn try_get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Refusal> {
        let request = self.prepared(self.agent.get(self.address(path))).header("accept", "application/json");
        read(&self.text(request.call())?).map_err(Refusal::Failed)
    }

    /// `PUT` of a JSON document.
    pub fn put<T: DeserializeOwned>(&self, path: &str, document: &impl Serialize) -> Result<T, Failure> {
        Ok(self.try_put(path, document)?)
    }

    /// `PUT` of a JSON document, with the service's refusal unconverted.
    pub fn try_put<T: DeserializeOwned>(&self, path: &str, document: &impl Serialize) -> Result<T, Refusal> {
        let wrong = |error: serde_json::Error| Refusal::Failed(Failure::Other(error.to_string()));
        let body = serde_json::to_string_pretty(document).map_err(wrong)?;
        read(&self.put_text(path, "application/json", &body, None)?).map_err(Refusal::Failed)
    }

    /// `POST` without a body.
    pub fn post_empty<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        read(&self.text(self.prepared(self.agent.post(self.address(path))).send_empty())?)
    }

    /// `POST` of a JSON document.
    pub fn post<T: DeserializeOwned>(&self, path: &str, document: &impl Serialize) -> Result<T, Failure> {
        let body = serde_json::to_string(document).map_err(Failure::other)?;
        let request = self.prepared(self.agent.post(self.address(path))).header("content-type", "application/json");
        read(&self.text(request.send(body))?)
    }

    /// `PUT` of a text, with the service's refusal unconverted.
    pub fn put_text(&self, path: &str, media: &str, body: &str, if_match: Option<&str>) -> Result<String, Refusal> {
        let mut request = self.prepared(self.agent.put(self.address(path))).header("content-type", media);
        if let Some(tag) = if_match {
            request = request.header("if-match", tag);
        }
        self.text(request.send(body))
    }

    /// `DELETE`
    pub fn delete(&self, path: &str) -> Result<(), Failure> {
        self.text(self.prepared(self.agent.delete(self.address(path))).call())?;
        Ok(())
    }

    /// `GET` of a file of any size; returns the number of bytes.
    pub fn download(&self, path: &str, file: &mut impl Write) -> Result<u64, Failure> {
        let request = self.connection.agent(DOWNLOAD_TIMEOUT).get(self.address(path));
        let answer = self.prepared(request).call();
        let mut answer = answer.map_err(|error| self.unreachable(&error))?;
        let status = answer.status().as_u16();
        if !(200..300).contains(&status) {
            return Err(self.text(Ok(answer)).err().map_or_else(|| Failure::Other(status.to_string()), Failure::from));
        }
        let expected = answer.body().content_length();
        let mut body = answer.body_mut().as_reader();
        let (mut piece, mut bytes) = (vec![0; PIECE_BYTES], 0);
        let broken = |reason: &dyn std::fmt::Display, bytes: u64| {
            Failure::Unreachable(format!("the connection broke off after {bytes} bytes: {reason}; try again"))
        };
        loop {
            let count = body.read(&mut piece).map_err(|error| broken(&error, bytes))?;
            if count == 0 {
                break;
            }
            file.write_all(&piece[..count])
                .map_err(|error| Failure::Other(format!("the file cannot be written: {error}")))?;
            bytes += count as u64;
        }
        match expected.is_none_or(|expected| expected == bytes) {
            true => Ok(bytes),
            false => Err(broken(&"the file has more", bytes)),
        }
    }

    fn address(&self, path: &str) -> String {
        format!("{}{path}", self.connection.url)
    }

    fn prepared<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        match self.connection.authorization() {
            Some(value) => request.header(header::AUTHORIZATION, value),
            None => request,
        }
    }

    fn text(&self, answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Result<String, Refusal> {
        let unreachable = |error: ureq::Error| match error {
            ureq::Error::BodyExceedsLimit(bytes) => {
                Refusal::Failed(Failure::Other(format!("the answer has more than {bytes} bytes")))
            }
            error => Refusal::Failed(self.unreachable(&error)),
        };
        let mut answer = answer.map_err(unreachable)?;
        let status = answer.status().as_u16();
        let body = answer.body_mut().with_config().limit(ANSWER_BYTES_MAX).read_to_string().map_err(unreachable)?;
        if (200..300).contains(&status) { Ok(body) } else { Err(Refusal::of(status, &body, &self.connection.url)) }
    }

    fn unreachable(&self, error: &dyn std::fmt::Display) -> Failure {
        let trust = if self.connection.is_encrypted() { ", and its certificate trusted (--ca FILE)" } else { "" };
        let url = &self.connection.url;
        Failure::Unreachable(format!("no answer from {url}: {error}; is `isophote serve` running there{trust}?"))
    }

    /// Opens a WebSocket with the subprotocol `isophote.v1`.
    pub fn websocket(&self, path: &str) -> Result<Estimates, Failure> {
        let (stream, socket) = self.connection.open(self.timeout).map_err(|error| self.unreachable(&error))?;
        let url = format!("ws{}", self.address(path).trim_start_matches("http"));
        let wrong = |error: &dyn std::fmt::Display| Failure::Usage(format!("`{url}` is no address: {error}"));
        let mut request = url.as_str().into_client_request().map_err(|error| wrong(&error))?;
        request.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static("isophote.v1"));
        if let Some(value) = self.connection.authorization() {
            request.headers_mut().insert(header::AUTHORIZATION, value.clone());
        }
        match tungstenite::client(request, stream) {
            Ok((estimates, _)) => {
                // The next estimate may take arbitrarily long.
                socket.set_read_timeout(None).map_err(|error| self.unreachable(&error))?;
                Ok(Estimates(estimates))
            }
            Err(HandshakeError::Interrupted(_)) => Err(self.unreachable(&"it accepts connections and says nothing")),
            Err(HandshakeError::Failure(Error::Http(answer))) => {
                let body = answer.body().as_ref().map(|body| String::from_utf8_lossy(body).into_owned());
                Err(Refusal::of(answer.status().as_u16(), &body.unwrap_or_default(), &self.connection.url).into())
            }
            Err(error) => Err(self.unreachable(&error)),
        }
    }
}

/// A stream of estimates.
pub struct Estimates(WebSocket<Box<dyn ByteStream>>);

impl Estimates {
    /// The next one as JSON text; `None` at the end of the stream.
    pub fn next(&mut self) -> Result<Option<String>, Failure> {
        loop {
            match self.0.read() {
                Ok(Message::Text(text)) => return Ok(Some(text.to_string())),
                Ok(Message::Close(Some(frame))) if u16::from(frame.code) != 1000 => {
                    return Err(Failure::Other(format!("the service ended the stream: {}", frame.reason)));
                }
                Ok(Message::Close(Some(frame))) => {
                    eprintln!("{}", frame.reason);
                    return Ok(None);
                }
                Ok(_) => {}
                Err(Error::ConnectionClosed) => return Ok(None),
                Err(error) => return Err(broken_off(&error)),
            }
        }
    }

    /// Adds credit: asks for that many more estimates.
    pub fn renew(&mut self, credit: u32) -> Result<(), Failure> {
        let message = Message::text(format!("{{\"credit\":{credit}}}"));
        match self.0.send(message) {
            Ok(()) | Err(Error::ConnectionClosed | Error::Protocol(_)) => Ok(()), // `next` reports why it ended
            Err(error) => Err(broken_off(&error)),
        }
    }
}

fn broken_off(error: &Error) -> Failure {
    Failure::Unreachable(format!("the stream broke off: {error}; does the service still run?"))
}

/// Why a request failed.
pub enum Refusal {
    /// The service's problem document, with the absolute URL of its explanation.
    Problem(Box<ProblemDocument>),
    /// No answer, or one that cannot be parsed.
    Failed(Failure),
}

impl Refusal {
    fn of(status: u16, body: &str, service: &str) -> Refusal {
        match serde_json::from_str::<ProblemDocument>(body) {
            Ok(problem) => {
                let kind = format!("{service}{}", problem.kind);
                Refusal::Problem(Box::new(ProblemDocument { kind, ..problem }))
            }
            Err(_) => {
                let message =
                    format!("{service} answered {status} without a reason; is it the address of the service?");
                Refusal::Failed(Failure::answered(status, message))
            }
        }
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Failure {
        match refusal {
            Refusal::Failed(failure) => failure,
            Refusal::Problem(problem) if problem.diagnostics.is_empty() => {
                let message = format!("{} ({})\nsee {}", problem.detail, problem.status, problem.kind);
                Failure::answered(problem.status, message)
            }
            Refusal::Problem(problem) => {
                let shown: Vec<String> = problem.diagnostics.iter().map(|d| d.render("(as sent)")).collect();
                let message = format!("the service refused the document\n{}", shown.join("\n").trim_end());
                Failure::answered(problem.status, message)
            }
        }
    }
}

/// Prints a resource as JSON: the service's answer verbatim with `--json`, else indented.
pub fn show<T: DeserializeOwned + Serialize>(
    args: &ServiceArgs,
    path: &str,
    out: &mut dyn Write,
) -> Result<(), Failure> {
    let text = RemoteService::new(args)?.get_text(path, "application/json")?;
    if args.json {
        return writeln!(out, "{text}").map_err(Failure::output);
    }
    let view: T = read(&text)?;
    writeln!(out, "{}", serde_json::to_string_pretty(&view).map_err(Failure::other)?).map_err(Failure::output)
}

/// Deletes a resource.
pub fn remove(args: &ServiceArgs, path: &str, name: &str, out: &mut dyn Write) -> Result<(), Failure> {
    RemoteService::new(args)?.delete(path)?;
    if args.json { output::json(out, &serde_json::json!({"removed": name})) } else { Ok(()) }
}

/// Parses an answer.
pub fn read<T: DeserializeOwned>(text: &str) -> Result<T, Failure> {
    serde_json::from_str(text).map_err(|error| {
        Failure::Other(format!("the answer is not understood; is the service of another version? {error}"))
    })
}

/// Percent-encodes a name as one path segment; the service rejects invalid names.
pub fn segment(name: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    let encoded =
        name.bytes().map(|byte| if is_plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") });
    encoded.collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn silent_services_are_unreachable() {
        let silent = TcpListener::bind("127.0.0.1:0").unwrap();
        let server = format!("http://{}", silent.local_addr().unwrap());
        let args = ServiceArgs { server, token_file: None, ca: None, insecure: false, json: false };
        let service = RemoteService::with_timeout(Connection::new(&args).unwrap(), Duration::from_millis(50));
        let failures =
            [service.get::<serde_json::Value>("/v1/models").unwrap_err(), service.websocket("/v1").err().unwrap()];
        for failure in failures {
            assert_eq!(failure.status(), 4, "{failure}");
            assert!(failure.to_string().contains("is `isophote serve` running there?"), "{failure}");
        }
    }

    #[test]
    fn names_are_encoded_as_one_segment() {
        assert_eq!(segment("spot-2"), "spot-2");
        assert_eq!(segment("a/b?c ä"), "a%2Fb%3Fc%20%C3%A4");
    }
}
