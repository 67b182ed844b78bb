//! A service under test, and a client that validates nothing.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use isophote_jit::VectorWidth;
use isophote_server::{AccessOptions, Options, Server};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// Upper bound on the time of any request.
pub const DEADLINE: Duration = Duration::from_secs(60);

/// A service on its own port, in this process.
pub struct Running {
    server: Option<Server>,
    agent: ureq::Agent,
    pub url: String,
    pub address: String,
}

/// A response.
pub struct Answer {
    pub status: u16,
    pub media: String,
    pub etag: String,
    /// `Cache-Control`.
    pub cache: String,
    /// `WWW-Authenticate`.
    pub authenticate: String,
    /// `Allow`.
    pub allow: String,
    pub text: String,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {}", self.text))
    }
    /// Checks the status, and that an error is a problem document.
    pub fn expect(self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", self.text);
        if status >= 400 {
            assert_eq!(self.media, "application/problem+json");
            let problem = self.json();
            assert_eq!(problem["status"], status);
            assert!(problem["detail"].as_str().unwrap().len() > 5, "{problem}");
            assert_eq!(problem["type"], format!("/docs/errors#{}", problem["code"].as_str().unwrap()), "{problem}");
            assert_eq!(problem["diagnostics"].is_array(), status == 422, "{problem}");
        }
        if self.text.is_empty() { Value::Null } else { self.json() }
    }
}

impl Running {
    pub fn start() -> Running {
        Running::start_with(None, false)
    }
    pub fn start_with(data: Option<&Path>, demo: bool) -> Running {
        Running::start_of_width(data, demo, VectorWidth::default())
    }
    pub fn start_of_width(data: Option<&Path>, demo: bool, width: VectorWidth) -> Running {
        let data = data.map(Path::to_path_buf);
        Running::with(&Options { data, demo, width, ..Running::options() })
    }
    /// A service with access control.
    pub fn start_with_access(access: AccessOptions) -> Running {
        Running::with(&Options { access, ..Running::options() })
    }
    /// On a free loopback port, without access control.
    pub fn options() -> Options {
        let (listen, access) = ("127.0.0.1:0".parse().unwrap(), AccessOptions::default());
        Options { listen, data: None, models: None, demo: false, width: VectorWidth::default(), access }
    }
    pub fn with(options: &Options) -> Running {
        let server = Server::start(options).unwrap();
        let address = server.address().to_string();
        Running { server: Some(server), ..Running::at(&address) }
    }
    /// A client of a service in another process.
    pub fn at(address: &str) -> Running {
        let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(DEADLINE));
        let agent = config.allow_non_standard_methods(true).build().into();
        Running { server: None, agent, url: format!("http://{address}"), address: address.to_string() }
    }
    pub fn stop(mut self) {
        self.server.take().unwrap().stop();
    }

    pub fn request(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        self.try_request(method, path, headers, body).unwrap()
    }
    /// Fails if the service goes away before it has answered.
    pub fn try_request(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> Result<Answer, ureq::Error> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut answer = self.agent.run(request.body(body.to_vec()).unwrap())?;
        let header = |name: &str| answer.headers().get(name).map_or("", |value| value.to_str().unwrap()).to_string();
        let (media, etag, authenticate) = (header("content-type"), header("etag"), header("www-authenticate"));
        Ok(Answer {
            status: answer.status().as_u16(),
            media,
            etag,
            cache: header("cache-control"),
            authenticate,
            allow: header("allow"),
            text: String::from_utf8_lossy(&answer.body_mut().read_to_vec()?).into_owned(),
        })
    }
    pub fn get(&self, path: &str) -> Answer {
        self.request("GET", path, &[], b"")
    }
    pub fn delete(&self, path: &str) -> Answer {
        self.request("DELETE", path, &[], b"")
    }
    pub fn put(&self, path: &str, document: &Value) -> Answer {
        self.put_text(path, "application/json", &document.to_string())
    }
    pub fn put_text(&self, path: &str, media: &str, text: &str) -> Answer {
        self.request("PUT", path, &[("content-type", media)], text.as_bytes())
    }

    /// Polls until the session's document is as wanted.
    pub fn wait_for(&self, session: &str, is_there: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let view = self.get(&format!("/v1/sessions/{session}")).expect(200);
            if is_there(&view) {
                return view;
            }
            assert!(start.elapsed() < DEADLINE, "{view}");
            std::thread::yield_now();
        }
    }

    pub fn socket(&self, session: &str, query: &str) -> Socket {
        self.try_socket(session, query, "isophote.v1").unwrap()
    }
    pub fn try_socket(&self, session: &str, query: &str, protocol: &str) -> Result<Socket, u16> {
        self.open(&format!("/v1/sessions/{session}/estimates?{query}"), protocol)
    }
    /// A socket for frames.
    pub fn frames_socket(&self, session: &str) -> Result<Socket, u16> {
        self.open(&format!("/v1/sessions/{session}/frames"), "isophote.v1")
    }
    pub fn open(&self, path: &str, protocol: &str) -> Result<Socket, u16> {
        let url = format!("ws://{}{path}", self.address);
        let mut request = url.into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_str(protocol).unwrap());
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        match tungstenite::client(request, Uninterrupted(stream)) {
            Ok((socket, answer)) => {
                let chosen = answer.headers().get("sec-websocket-protocol");
                let chosen = chosen.map_or("", |name| name.to_str().unwrap()).to_string();
                Ok(Socket(socket, chosen))
            }
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// A WebSocket of the service, which sends JSON.
pub struct Socket(WebSocket<Uninterrupted>, String);

/// Retries reads after signals (such as SIGCHLD): the system does not restart reads that have a timeout.
struct Uninterrupted(TcpStream);

impl Read for Uninterrupted {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.0.read(bytes) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }
}

impl Write for Uninterrupted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Socket {
    /// The subprotocol that the service chose.
    pub fn protocol(&self) -> &str {
        &self.1
    }
    /// The next message of any kind.
    pub fn read(&mut self) -> Message {
        self.0.read().unwrap()
    }
    /// The next message, or the code with which the service closed.
    pub fn next(&mut self) -> Result<Value, u16> {
        loop {
            match self.0.read() {
                Ok(Message::Text(text)) => return Ok(serde_json::from_str(&text).unwrap()),
                Ok(Message::Close(frame)) => return Err(frame.map_or(0, |frame| frame.code.into())),
                Ok(_) => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
    pub fn send(&mut self, text: &str) {
        self.0.send(Message::text(text)).unwrap();
    }
    /// Sends bytes that need not be a message.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        self.0.send(Message::binary(bytes.to_vec())).unwrap();
    }
}

/// A small synthetic source that is cheap to render and to fit.
pub fn synthetic(pace: &str, rate_hz: f64) -> Value {
    json!({"kind": "synthetic", "model": "spot", "width": 64, "height": 48, "samples": 1, "rate_hz": rate_hz, "pace": pace,
           "set": {"a1": 0.01, "a2": 0.0, "a3": 0.015625, "v0": 20, "v1": 150},
           "motion": {"bx": "32 + 3*sin(2*pi*0.5*t)", "by": "24 + 2*cos(2*pi*0.5*t)"}})
}

/// A source of 1280 × 960 px, with a spot that is slow to fit.
pub fn large(pace: &str, rate_hz: f64) -> Value {
    let mut source = synthetic(pace, rate_hz);
    (source["width"], source["height"]) = (json!(1280), json!(960));
    source["set"] = json!({"bx": 640, "by": 480, "a1": 1e-5, "a2": 0.0, "a3": 1e-5, "v0": 20, "v1": 150});
    source["motion"] = json!({"bx": "640 + 30*sin(2*pi*0.5*t)"});
    source
}

/// A session on the small source.
pub fn session(pace: &str, rate_hz: f64) -> Value {
    json!({"source": synthetic(pace, rate_hz), "model": "spot"})
}

/// An 8-bit picture of a spot that `spot` fits.
pub fn picture(width: usize, height: usize, centre: (f64, f64)) -> Vec<u8> {
    let mut bytes = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let (dx, dy) = (x as f64 - centre.0, y as f64 - centre.1);
            let s = dx * dx * 0.01 + dy * dy * 0.015625;
            let f = if s <= 1.0 { 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s } else { 0.0 };
            bytes.push((20.0 + 150.0 * f).round() as u8);
        }
    }
    bytes
}

/// The names of an object, in order.
pub fn names(object: &Value) -> Vec<String> {
    object.as_object().unwrap().keys().cloned().collect()
}

/// A temporary folder of the test, removed on drop.
pub struct Folder(pub std::path::PathBuf);

impl Folder {
    pub fn new(name: &str) -> Folder {
        let folder = std::env::temp_dir().join(format!("isophote-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Folder(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}
