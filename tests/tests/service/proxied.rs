//! Behind nginx with the book's example configuration, estimates arrive one by one. Skipped without nginx.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use isophote_server::{AccessOptions, Options};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;

use crate::client::{DEADLINE, Folder, Running, picture};

/// The host name of the example.
const NAME: &str = "fits.example";

/// The example configuration, adapted to a service at that address, with a socket in the folder and without TLS.
fn configuration(folder: &Path, address: &str) -> String {
    let page = std::fs::read_to_string(isophote_tests::repository().join("docs/service.md")).unwrap();
    let example = page.split("```nginx\n").nth(1).unwrap().split("```").next().unwrap();
    let socket = format!("listen unix:{};", folder.join("socket").display());
    let changed = example.replace("listen 443 ssl;", &socket).replace("127.0.0.1:7240", address);
    assert!(changed.contains(&socket) && changed.contains(&format!("http://{address}")), "{changed}");
    let lines: Vec<&str> = changed.lines().filter(|line| !line.trim_start().starts_with("ssl_")).collect();
    let paths = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let paths: String = paths.iter().map(|name| format!("{name}_temp_path {}/{name};\n", folder.display())).collect();
    format!(
        "daemon off;\nmaster_process off;\npid {0}/pid;\nerror_log {0}/errors;\nevents {{}}\nhttp {{\naccess_log off;\n{paths}{1}\n}}\n",
        folder.display(),
        lines.join("\n")
    )
}

struct Proxy {
    child: Child,
    socket: PathBuf,
    folder: Folder,
}

impl Proxy {
    /// `None`, with a message, without nginx.
    fn start(address: &str) -> Option<Proxy> {
        if !Command::new("nginx").arg("-v").stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
            eprintln!("skipped: nginx is not installed");
            return None;
        }
        let folder = Folder::new("nginx");
        let file = folder.0.join("nginx.conf");
        std::fs::write(&file, configuration(&folder.0, address)).unwrap();
        let mut command = Command::new("nginx");
        command.arg("-e").arg(folder.0.join("errors")).arg("-c").arg(file).stderr(Stdio::null());
        let child = command.spawn().unwrap();
        let socket = folder.0.join("socket");
        Some(Proxy { child, socket, folder })
    }

    fn connect(&mut self) -> UnixStream {
        let begin = Instant::now();
        loop {
            if let Ok(stream) = UnixStream::connect(&self.socket) {
                stream.set_read_timeout(Some(DEADLINE)).unwrap();
                return stream;
            }
            let ended = self.child.try_wait().unwrap();
            let errors = || std::fs::read_to_string(self.folder.0.join("errors")).unwrap_or_default();
            assert!(ended.is_none() && begin.elapsed() < DEADLINE, "{ended:?}: {}", errors());
            std::thread::yield_now();
        }
    }

    /// The head of an endless answer, and its lines.
    fn lines(&mut self, accept: &str) -> (String, impl Iterator<Item = String> + use<>) {
        let mut stream = self.connect();
        let path = "/v1/sessions/one/estimates?mode=all";
        let request = format!("GET {path} HTTP/1.1\r\nHost: {NAME}\r\nAccept: {accept}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut lines = BufReader::new(stream).lines().map(Result::unwrap);
        let head: Vec<String> = lines.by_ref().take_while(|line| !line.is_empty()).collect();
        (head.join("\n").to_lowercase(), lines)
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.child.kill().ok(); // it may have exited
        self.child.wait().ok();
    }
}

fn estimate(lines: &mut impl Iterator<Item = String>) -> Value {
    let json = lines.map(|line| line.trim_start_matches("data: ").to_string()).find(|line| line.starts_with('{'));
    serde_json::from_str(&json.unwrap()).unwrap()
}

/// Each estimate arrives before the next frame is pushed.
#[test]
fn estimates_come_through_nginx_one_by_one() {
    let access = AccessOptions { hosts: vec![NAME.parse().unwrap()], ..AccessOptions::default() };
    let service = Running::with(&Options { access, ..Running::options() });
    let source = json!({"kind": "pushed", "width": 64, "height": 48});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let Some(mut proxy) = Proxy::start(&service.address) else { return };
    let mut push = {
        let mut frame = 0;
        let service = &service;
        move || {
            let media = [("content-type", "application/octet-stream")];
            service.request("POST", "/v1/sessions/one/frames", &media, &picture(64, 48, (30.0, 20.0))).expect(200);
            frame += 1;
            frame - 1
        }
    };
    for accept in ["text/event-stream", "application/x-ndjson"] {
        let (head, mut lines) = proxy.lines(accept);
        assert!(head.starts_with("http/1.1 200") && head.contains("cache-control: no-store, no-transform"), "{head}");
        for _ in 0..3 {
            let frame = push();
            assert_eq!(estimate(&mut lines)["frame"], frame, "{accept}");
        }
    }
    let mut request = format!("ws://{NAME}/v1/sessions/one/estimates?mode=all").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", "isophote.v1".parse().unwrap());
    let (mut socket, _) = tungstenite::client(request, proxy.connect()).unwrap();
    let frame = push();
    let message = socket.read().unwrap().into_text().unwrap();
    assert_eq!(serde_json::from_str::<Value>(&message).unwrap()["frame"], frame);
}
