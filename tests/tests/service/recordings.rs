//! Recordings readable by a service with access control: only those below one folder, whatever paths and links say.

use std::os::unix::fs::symlink;
use std::path::Path;

use isophote_server::{AccessOptions, Role, TokenFile};
use serde_json::{Value, json};

use crate::client::{Folder, Running};
use crate::paths::png;

/// Recordings, files outside of their folder, and links to them.
fn folders(name: &str) -> Folder {
    let folder = Folder::new(name);
    let at = |name: &str| folder.0.join(name);
    for name in ["root/flat", "root/mixed", "root/truth", "root-beside", "outside"] {
        std::fs::create_dir_all(at(name)).unwrap();
        png(&at(name).join("0.png"), 30.0);
    }
    png(&at("root/flat/1.png"), 31.0);
    std::fs::write(at("root/t.csv"), "x,y\n1,2\n3,4\n").unwrap();
    std::fs::write(at("outside/truth.jsonl"), "{\"file\": \"0.png\", \"parameters\": {\"bx\": 1}}\n").unwrap();
    for (target, link) in [
        ("flat", "root/in"),
        ("../outside", "root/out"),
        ("../outside/0.png", "root/out.png"),
        ("../../outside/0.png", "root/mixed/1.png"),
        ("../../outside/truth.jsonl", "root/truth/truth.jsonl"),
    ] {
        symlink(target, at(link)).unwrap();
    }
    folder
}

fn session(path: &str) -> Value {
    json!({"source": {"kind": "recording", "path": path, "rate_hz": 100}, "model": "spot"})
}

#[test]
fn recordings_are_read_below_their_folder_only() {
    let folder = folders("recordings-root");
    let root = folder.0.join("root");
    let access = AccessOptions { recordings: Some(root.clone()), ..AccessOptions::default() };
    let service = Running::start_with_access(access);
    let absolute = |name: &str| folder.0.join(name).to_str().unwrap().to_string();
    let read = [
        ("flat", "flat"),
        ("flat/0.png", "flat/0.png"),
        ("./flat/../flat/", "flat"),
        ("in", "flat"),
        ("in/1.png", "flat/1.png"),
        (&absolute("root/flat"), "flat"),
        (&absolute("root/../root/in"), "flat"),
    ];
    for (sent, kept) in read {
        service.put("/v1/sessions/one", &session(sent));
        let view = service.get("/v1/sessions/one").expect(200);
        assert_eq!(view["source"]["path"], kept, "{sent}: {view}");
        service.put("/v1/sources/one", &session(sent)["source"]);
        assert_eq!(service.get("/v1/sources/one").expect(200)["path"], kept, "{sent}");
        service.delete("/v1/sessions/one");
    }
    let refused = [
        "..",
        "../outside",
        "../outside/0.png",
        "../root-beside",
        "flat/../../outside/0.png",
        "/etc/passwd.png",
        "/",
        "out",
        "out/0.png",
        "out.png",
        "truth",
        &absolute("outside"),
        &absolute("root-beside/0.png"),
        &absolute("root/../outside"),
    ];
    for sent in refused {
        let answer = service.put("/v1/sessions/one", &session(sent)).expect(422);
        assert_eq!(answer["diagnostics"][0]["key"], "source.path", "{sent}: {answer}");
        assert!(answer["detail"].as_str().unwrap().contains("outside of the folder"), "{sent}: {answer}");
        service.put("/v1/sources/two", &session(sent)["source"]).expect(422);
    }
    // Clients cannot tell whether a file outside exists.
    let detail = |sent: &str| service.put("/v1/sessions/one", &session(sent)).expect(422)["detail"].to_string();
    assert_eq!(detail("../outside/0.png"), detail("../outside/9.png").replace("9.png", "0.png"));
    assert!(detail("flat/9.png").contains("9.png") && !detail("flat/9.png").contains("outside"));
    // Nor where the folder is.
    std::fs::write(root.join("flat/torn.csv"), "x,y\n1\n").unwrap();
    std::fs::create_dir_all(root.join("nothing")).unwrap();
    for sent in ["flat/9.png", "flat/torn.csv", "nothing", "../outside", "absent.tiff"] {
        let detail = detail(sent);
        assert!(!detail.contains(folder.0.to_str().unwrap()), "{sent}: {detail}");
    }
    service.stop();
}

#[test]
fn files_replaced_by_links_are_not_read() {
    let folder = folders("recordings-race");
    let access = AccessOptions { recordings: Some(folder.0.join("root")), ..AccessOptions::default() };
    let service = Running::start_with_access(access);
    let mut document = session("mixed");
    document["source"]["loop"] = json!(true);
    service.put("/v1/sessions/mixed", &document).expect(201);
    let skips = |view: &Value| view["frames"].as_u64() > Some(3) && view["dropped"].as_u64() > Some(2);
    assert_eq!(service.wait_for("mixed", skips)["last"]["file"], "0.png");
    document["source"]["path"] = json!("flat");
    service.put("/v1/sources/flat", &document["source"]).expect(201);
    service.put("/v1/sessions/flat", &json!({"source": "flat", "model": "spot"})).expect(201);
    service.wait_for("flat", |view| view["last"]["file"] == "1.png");
    let path = folder.0.join("root/flat/1.png");
    std::fs::remove_file(&path).unwrap();
    symlink("../../outside/0.png", &path).unwrap();
    let reason = |view: &Value| view["reason"].as_str().unwrap_or_default().contains("outside of the folder");
    let begin = std::time::Instant::now();
    let error_text = loop {
        let view = service.get("/v1/sources/flat").expect(200);
        if reason(&view) {
            break view["reason"].as_str().unwrap().to_string();
        }
        assert!(begin.elapsed() < crate::client::DEADLINE, "the link was followed");
        std::thread::yield_now();
    };
    assert!(error_text.contains("flat/1.png") && !error_text.contains(folder.0.to_str().unwrap()), "{error_text}");
    service.stop();
}

#[test]
fn with_tokens_and_no_folder_no_recording_is_read() {
    let folder = folders("recordings-none");
    let file = TokenFile::of(Some(&folder.0.join("tokens.json")), None).unwrap();
    let token = format!("Bearer {}", file.add(Role::Operate, None).unwrap().1.text());
    let tokens = Some(file.path().to_path_buf());
    let put = |service: &Running, path: &Path| {
        let headers = [("content-type", "application/json"), ("authorization", token.as_str())];
        let document = session(path.to_str().unwrap()).to_string();
        service.request("PUT", "/v1/sessions/one", &headers, document.as_bytes())
    };
    let service = Running::start_with_access(AccessOptions { tokens: tokens.clone(), ..AccessOptions::default() });
    for path in [folder.0.join("root/flat"), "flat".into(), "/absent".into()] {
        let answer = put(&service, &path).expect(422);
        assert_eq!(answer["diagnostics"][0]["key"], "source.path", "{answer}");
        assert!(answer["detail"].as_str().unwrap().contains("--recordings"), "{answer}");
    }
    service.stop();
    let recordings = Some(folder.0.join("root"));
    let service = Running::start_with_access(AccessOptions { tokens, recordings, ..AccessOptions::default() });
    put(&service, Path::new("flat")).expect(201);
    service.stop();
    // Without access control there is no restriction.
    let service = Running::start();
    service.put("/v1/sessions/one", &session(folder.0.join("outside").to_str().unwrap())).expect(201);
    let absent = AccessOptions { recordings: Some(folder.0.join("absent")), ..AccessOptions::default() };
    let options = isophote_server::Options { access: absent, ..Running::options() };
    let error = isophote_server::Server::start(&options).err().unwrap().to_string();
    assert!(error.contains("--recordings") && error.contains("absent"), "{error}");
}
