//! A service of the test's own, and a client that checks nothing.

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

/// Nothing here takes this long.
pub const DEADLINE: Duration = Duration::from_secs(60);

/// A service on a port of its own, in this process.
pub struct Running {
    server: Option<Server>,
    agent: ureq::Agent,
    pub url: String,
    pub address: String,
}

/// What was answered.
pub struct Answer {
    pub status: u16,
    pub media: String,
    pub etag: String,
    /// `Cache-Control`.
    pub cache: String,
    /// How to say who asks.
    pub authenticate: String,
    /// Methods that are allowed, where another was asked for.
    pub allow: String,
    pub text: String,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {}", self.text))
    }
    /// The status, and for a problem that it is one.
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
    /// A service that is not for everybody.
    pub fn start_with_access(access: AccessOptions) -> Running {
        Running::with(&Options { access, ..Running::options() })
    }
    /// On a free port of loopback, for everybody.
    pub fn options() -> Options {
        let (listen, access) = ("127.0.0.1:0".parse().unwrap(), AccessOptions::default());
        Options { listen, data: None, models: None, demo: false, width: VectorWidth::default(), access }
    }
    pub fn with(options: &Options) -> Running {
        let server = Server::start(options).unwrap();
        let address = server.address().to_string();
        Running { server: Some(server), ..Running::at(&address) }
    }
    /// A service of another process.
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
    /// Fails when the service goes before it has answered.
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

    /// Asks again until the session's document is as wanted.
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

/// The system does not begin a read with a time limit again after a signal, such as that of a child's end.
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
    /// The next message, whatever it is.
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
    /// Bytes that need not be a message.
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

/// One of 1280 × 960, with a spot that takes its time.
pub fn large(pace: &str, rate_hz: f64) -> Value {
    let mut source = synthetic(pace, rate_hz);
    (source["width"], source["height"]) = (json!(1280), json!(960));
    source["set"] = json!({"bx": 640, "by": 480, "a1": 1e-5, "a2": 0.0, "a3": 1e-5, "v0": 20, "v1": 150});
    source["motion"] = json!({"bx": "640 + 30*sin(2*pi*0.5*t)"});
    source
}

/// A session over the small one.
pub fn session(pace: &str, rate_hz: f64) -> Value {
    json!({"source": synthetic(pace, rate_hz), "model": "spot"})
}

/// A spot of the kind that `spot` fits, 8 bit.
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

/// Names of an object, in order.
pub fn names(object: &Value) -> Vec<String> {
    object.as_object().unwrap().keys().cloned().collect()
}

/// A folder of the test's own, removed when dropped.
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
