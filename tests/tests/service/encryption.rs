//! Off loopback: refusals at start-up, TLS, and commands that send their token.

use std::io::Read;
use std::net::{IpAddr, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use isophote_server::{AccessOptions, Options, Role, Server, TlsFiles, TokenFile};
use isophote_tests::{Finished, Service, finish, program, repository};

use crate::client::{DEADLINE, Folder, Running};
use crate::logs::{end, start_with};

const LIMIT: Duration = Duration::from_secs(60);

/// A self-signed certificate for this machine, and its key.
fn certificate(folder: &Path, name: &str) -> TlsFiles {
    let own = rcgen::generate_simple_self_signed(["localhost".to_string(), "127.0.0.1".to_string()]).unwrap();
    let at = |extension: &str| folder.join(format!("{name}.{extension}"));
    let files = TlsFiles { certificate: at("crt"), key: at("key") };
    std::fs::write(&files.certificate, own.cert.pem()).unwrap();
    std::fs::write(&files.key, own.signing_key.serialize_pem()).unwrap();
    files
}

fn options(listen: &str, access: AccessOptions) -> Options {
    Options { access, listen: listen.parse().unwrap(), ..Running::options() }
}

fn refused(listen: &str, access: AccessOptions) -> String {
    Server::start(&options(listen, access)).err().expect("it started").to_string()
}

/// An address by which other machines would reach this one.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?; // nothing is sent
    Some(socket.local_addr().ok()?.ip()).filter(|address| !address.is_loopback() && !address.is_unspecified())
}

#[test]
fn off_loopback_requires_tls_and_tokens() {
    let folder = Folder::new("off-loopback");
    let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
    let tokens = Some(file.path().to_path_buf());
    let with = |tls: Option<TlsFiles>, insecure| AccessOptions {
        tokens: tokens.clone(),
        tls,
        insecure,
        ..AccessOptions::default()
    };
    let says =
        |text: String, parts: &[&str]| parts.iter().for_each(|part| assert!(text.contains(part), "{part}: {text}"));
    let shown = file.path().to_str().unwrap();
    says(refused("0.0.0.0:0", with(None, false)), &["0.0.0.0:0", "loopback", "--tls-cert", "--insecure"]);
    says(refused("[::]:0", with(None, false)), &["loopback", "--tls-cert"]);
    says(refused("0.0.0.0:0", with(None, true)), &["isophote token new", shown]);
    let pair = certificate(&folder.0, "one");
    says(refused("0.0.0.0:0", with(Some(pair.clone()), false)), &["isophote token new", shown]);
    says(refused("127.0.0.1:0", with(None, false)), &["isophote token new", shown]);
    let token = file.add(Role::View, None).unwrap().1.text();
    let other = certificate(&folder.0, "other");
    let mixed = TlsFiles { key: other.key.clone(), ..pair.clone() };
    says(refused("127.0.0.1:0", with(Some(mixed), false)), &["one.crt", "other.key"]);
    let swapped = TlsFiles { certificate: pair.key.clone(), key: pair.certificate.clone() };
    says(refused("127.0.0.1:0", with(Some(swapped), false)), &["one.key", "CERTIFICATE"]);
    let absent = TlsFiles { key: folder.0.join("absent"), ..pair.clone() };
    says(refused("127.0.0.1:0", with(Some(absent), false)), &["absent", "cannot be read"]);

    let server = Server::start(&options("0.0.0.0:0", with(None, true))).unwrap();
    let port = server.address().port();
    let local = Running::at(&format!("127.0.0.1:{port}"));
    local.get("/livez").expect(200);
    local.get("/v1/sessions").expect(401);
    let Some(address) = own_address() else {
        eprintln!("skipped: this machine has no address but loopback");
        return server.stop();
    };
    let remote = Running::at(&format!("{address}:{port}"));
    remote.get("/livez").expect(200);
    remote.get("/v1/sessions").expect(401);
    let bearer = format!("Bearer {token}");
    let list = |service: &Running| service.request("GET", "/v1/sessions", &[("authorization", &bearer)], b"").status;
    assert_eq!(list(&remote), 200);
    let host = |host: &str| remote.request("GET", "/livez", &[("host", host)], b"").status;
    assert_eq!((host("localhost"), host("evil.example"), host(&address.to_string())), (421, 421, 200));
    // One address may hold 64 connections; the next is refused with 503, and other addresses are served.
    let crowd: Vec<TcpStream> = (0..64).map(|_| TcpStream::connect((address, port)).unwrap()).collect();
    let begin = Instant::now();
    while list(&Running::at(&format!("{address}:{port}"))) != 503 {
        assert!(begin.elapsed() < DEADLINE, "nobody was refused");
    }
    assert_eq!(list(&local), 200);
    drop(crowd);
    server.stop();
}

/// A TLS service, and commands that may have a token of it.
struct Encrypted {
    program: PathBuf,
    service: Service,
    files: TlsFiles,
    folder: Folder,
}

impl Encrypted {
    fn start(name: &str) -> Encrypted {
        let folder = Folder::new(name);
        let (files, program) = (certificate(&folder.0, "one"), program().unwrap());
        for (role, file) in [("view", "view"), ("admin", "admin")] {
            let token = command(&program, &["token", "new", "--role", role, "--data", "."], &folder.0);
            assert_eq!((token.status, token.stdout.lines().count()), (Some(0), 1), "{}", token.stderr);
            std::fs::write(folder.0.join(file), token.stdout).unwrap();
        }
        let tls = ["--tls-cert", "one.crt", "--tls-key", "one.key"];
        let arguments = [["--demo", "--require-token", "--data", "."].as_slice(), &tls].concat();
        let service = Service::start(&program, &arguments, &folder.0).unwrap();
        Encrypted { program, service, files, folder }
    }
    fn url(&self) -> String {
        format!("https://{}", self.service.address())
    }
    /// Runs a command that trusts the service and reads the token of a file.
    fn run(&self, arguments: &[&str], token: &str) -> Finished {
        let (url, ca) = (self.url(), self.files.certificate.to_str().unwrap());
        let service = ["--server", &url, "--ca", ca, "--token-file", token];
        command(&self.program, &[arguments, &service].concat(), &self.folder.0)
    }
}

fn command(program: &Path, arguments: &[&str], folder: &Path) -> Finished {
    let mut command = Command::new(program);
    finish(command.args(arguments).env_remove("ISOPHOTE_TOKEN").current_dir(folder), LIMIT).unwrap()
}

#[test]
fn commands_use_tls_and_tokens() {
    let encrypted = Encrypted::start("tls-commands");
    let ok = |arguments: &[&str], token: &str| {
        let finished = encrypted.run(arguments, token);
        assert_eq!(finished.status, Some(0), "{arguments:?}: {}", finished.stderr);
        finished.stdout
    };
    assert!(ok(&["session", "list"], "view").contains("demo"));
    assert_eq!(ok(&["watch", "demo", "--count", "3"], "view").lines().count(), 3);
    let gaussian = repository().join("models/gaussian.toml");
    let push = ["model", "push", gaussian.to_str().unwrap(), "--name", "mine"];
    assert!(ok(&push, "admin").contains("mine version 1"));
    let fails = |finished: Finished, status: i32, says: &str| {
        assert_eq!((finished.status, finished.stdout.as_str()), (Some(status), ""), "{}", finished.stderr);
        assert!(finished.stderr.contains(says), "{says}: {}", finished.stderr);
    };
    fails(encrypted.run(&push, "view"), 1, "needs the role admin");
    let bare = |arguments: &[&str]| command(&encrypted.program, arguments, &encrypted.folder.0);
    let (url, ca) = (encrypted.url(), encrypted.files.certificate.to_str().unwrap());
    fails(bare(&["session", "list", "--server", &url, "--ca", ca]), 1, "token");
    fails(bare(&["session", "list", "--server", &url, "--token-file", "view"]), 4, "--ca FILE");
    fails(bare(&["watch", "demo", "--server", &url, "--token-file", "view"]), 4, "no answer");
    let plain = url.replace("https", "http");
    fails(bare(&["session", "list", "--server", &plain]), 4, "no answer");
    // The certificate does not cover that name.
    let renamed = url.replace("127.0.0.1", "127.0.0.2");
    fails(bare(&["session", "list", "--server", &renamed, "--ca", ca, "--token-file", "view"]), 4, "no answer");
    // To another machine a token is sent encrypted, or not at all.
    for command in [["session", "list"], ["watch", "demo"]] {
        let other = ["--server", "http://192.0.2.1:1", "--token-file", "view"];
        fails(bare(&[command.as_slice(), &other].concat()), 2, "clear text");
    }
    fails(encrypted.run(&["session", "list"], "absent"), 2, "absent");
    fails(encrypted.run(&["session", "list"], "/dev/null"), 2, "no token");
    let mut by_environment = Command::new(&encrypted.program);
    let token = std::fs::read_to_string(encrypted.folder.0.join("view")).unwrap();
    by_environment.args(["session", "list"]).env("ISOPHOTE_TOKEN", token.trim());
    by_environment.env("ISOPHOTE_SERVER", &url).env("ISOPHOTE_CA", ca);
    let finished = finish(&mut by_environment, LIMIT).unwrap();
    assert_eq!(finished.status, Some(0), "{}", finished.stderr);
    // Revoked while it watches.
    let revoke = || assert_eq!(bare(&["token", "revoke", "view-1", "--data", "."]).status, Some(0));
    std::thread::scope(|scope| {
        let watching = scope.spawn(|| encrypted.run(&["watch", "demo", "--count", "1000000"], "view"));
        assert_eq!(encrypted.run(&["watch", "demo", "--count", "1"], "view").status, Some(0));
        revoke();
        let watched = watching.join().unwrap();
        assert_eq!(watched.status, Some(1), "{}", watched.stderr);
        assert!(watched.stderr.contains("revoked") || watched.stderr.contains("401"), "{}", watched.stderr);
    });
    fails(encrypted.run(&["session", "list"], "view"), 1, "revoked");
}

#[test]
fn changed_certificates_are_reloaded_unless_invalid() {
    let folder = Folder::new("renewed");
    let one = certificate(&folder.0, "one");
    let of = |name: &str| certificate(&folder.0, name);
    let (first, second, third) = (of("first"), of("second"), of("third"));
    let copy = |from: &Path, to: &Path| {
        // Replace atomically, as renewal tools do.
        std::fs::copy(from, folder.0.join("new")).unwrap();
        std::fs::rename(folder.0.join("new"), to).unwrap();
    };
    let renew = |pair: &TlsFiles| {
        copy(&pair.certificate, &one.certificate);
        copy(&pair.key, &one.key);
    };
    renew(&first);
    let [certificate, key] = [&one.certificate, &one.key].map(|path| path.to_str().unwrap());
    let (service, child, mut lines) = start_with(&["--tls-cert", certificate, "--tls-key", key]);
    let program = program().unwrap();
    let is_served = |pair: &TlsFiles| {
        let url = format!("https://{}", service.address);
        let arguments = ["session", "list", "--server", &url, "--ca", pair.certificate.to_str().unwrap()];
        command(&program, &arguments, &folder.0).status == Some(0)
    };
    assert!(is_served(&first) && !is_served(&second));
    renew(&second);
    lines.find(|line| line["message"] == "the certificate was read again").unwrap();
    assert!(is_served(&second) && !is_served(&first));
    // A mismatched pair, and an invalid key.
    copy(&third.key, &one.key);
    let stays = |line: &serde_json::Value| line["message"] == "the certificate that was read before stays in use";
    let line = lines.find(stays).unwrap();
    assert!(line["level"] == "ERROR" && line["error"].as_str().unwrap().contains("one.key"), "{line}");
    assert!(is_served(&second));
    std::fs::write(&one.key, "no key").unwrap();
    assert!(lines.find(stays).unwrap()["error"].as_str().unwrap().contains("one.key"));
    assert!(is_served(&second));
    renew(&third);
    lines.find(|line| line["message"] == "the certificate was read again").unwrap();
    assert!(is_served(&third) && !is_served(&second));
    end(child, lines);
}

#[test]
fn unfinished_handshakes_time_out() {
    let folder = Folder::new("slow-handshakes");
    let tls = Some(certificate(&folder.0, "one"));
    let service = Running::start_with_access(AccessOptions { tls, ..AccessOptions::default() });
    let begin = Instant::now();
    let slow: Vec<TcpStream> = (0..100)
        .map(|number| {
            let mut stream = TcpStream::connect(&service.address).unwrap();
            stream.set_read_timeout(Some(DEADLINE)).unwrap();
            // Send nothing, or the beginning of a ClientHello.
            if number % 2 == 0 {
                std::io::Write::write_all(&mut stream, &[22, 3, 1, 2, 0, 1]).unwrap();
            }
            stream
        })
        .collect();
    for mut stream in slow {
        // Closed or reset, not timed out.
        let ended = stream.read_to_end(&mut Vec::new()).map_err(|error| error.kind());
        assert!(!matches!(ended, Err(std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut)), "{ended:?}");
    }
    eprintln!("100 unfinished handshakes gone after {:?}", begin.elapsed());
    // Plain HTTP gets no HTTP answer.
    let mut plain = TcpStream::connect(&service.address).unwrap();
    plain.set_read_timeout(Some(DEADLINE)).unwrap();
    std::io::Write::write_all(&mut plain, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    plain.read_to_end(&mut answer).ok();
    assert!(!answer.starts_with(b"HTTP"), "{}", String::from_utf8_lossy(&answer));
    service.stop();
}

#[test]
fn tokens_on_the_command_line() {
    let (folder, program) = (Folder::new("token-commands"), program().unwrap());
    let run = |arguments: &[&str]| command(&program, arguments, &folder.0);
    let json = |arguments: &[&str]| {
        let finished = run(arguments);
        assert_eq!(finished.status, Some(0), "{}", finished.stderr);
        serde_json::from_str::<serde_json::Value>(&finished.stdout).unwrap()
    };
    let made = json(&["token", "new", "--json", "--tokens", "t.json"]);
    assert_eq!((made["name"].as_str(), made["role"].as_str()), (Some("admin-1"), Some("admin")));
    let token = made["token"].as_str().unwrap();
    assert!(token.starts_with("isophote_") && token.len() == 73, "{token}");
    let second = run(&["token", "new", "--role", "view", "--name", "lamp", "--tokens", "t.json"]);
    assert!(second.stderr.contains("lamp") && !second.stderr.contains("isophote_"), "{}", second.stderr);
    let listed = json(&["token", "list", "--json", "--tokens", "t.json"]);
    assert_eq!(listed["items"].as_array().unwrap().len(), 2);
    assert_eq!(listed["items"][1]["role"], "view");
    let table = run(&["token", "list", "--tokens", "t.json"]).stdout;
    assert!(table.contains("lamp") && !table.contains("isophote_"), "{table}");
    let kept = std::fs::read_to_string(folder.0.join("t.json")).unwrap();
    assert!(!kept.contains(&token[9..]), "{kept}");
    assert_eq!(json(&["token", "revoke", "lamp", "--json", "--tokens", "t.json"])["revoked"], "lamp");
    assert_eq!(run(&["token", "revoke", "lamp", "--tokens", "t.json"]).status, Some(5));
    assert_eq!(run(&["token", "new", "--name", "No", "--tokens", "t.json"]).status, Some(2));
    assert_eq!(run(&["token", "new", "--role", "king", "--tokens", "t.json"]).status, Some(2));
    // By default the file is in the user's configuration folder.
    let mut at_home = Command::new(&program);
    at_home.args(["token", "new"]).env("XDG_CONFIG_HOME", folder.0.join("config")).current_dir(&folder.0);
    assert_eq!(finish(&mut at_home, LIMIT).unwrap().status, Some(0));
    assert!(folder.0.join("config/isophote/tokens.json").is_file());
}
