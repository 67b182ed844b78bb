//! Runs Autobahn's WebSocket test suite, if installed, against an echo server behind the service's connections. The suite needs
//! Python 2.7 (`pip install autobahntestsuite`); `ISOPHOTE_AUTOBAHN` is the path of its `wstest`.

#![allow(clippy::unwrap_used)]

use std::process::Command;

use axum::extract::WebSocketUpgrade;
use axum::extract::ws::Message;
use axum::routing::get;
use serde_json::{Value, json};

use super::*;
use crate::http::streams::websocket::LifeSigns;

/// The longest messages of the suite.
const MESSAGE_BYTES: usize = 16 << 20;
/// Cases of the suite without those on compression, which is not offered.
const CASES: usize = 301;

/// Echoes messages with the code of the service's own sockets.
async fn echo(upgrade: WebSocketUpgrade) -> axum::response::Response {
    let upgrade = upgrade.max_message_size(MESSAGE_BYTES).max_frame_size(MESSAGE_BYTES);
    upgrade.on_upgrade(async |mut socket| {
        let mut signs = LifeSigns::begin();
        loop {
            let received = socket.recv().await;
            let Some(message) = signs.heard(&mut socket, received).await else { return };
            if matches!(message, Message::Text(_) | Message::Binary(_)) && socket.send(message).await.is_err() {
                return;
            }
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_suite_finds_no_fault() {
    let Some(program) = std::env::var_os("ISOPHOTE_AUTOBAHN") else {
        eprintln!("skipped: Autobahn's test suite is not installed, or ISOPHOTE_AUTOBAHN does not say where");
        return;
    };
    let listener = bound("127.0.0.1:0".parse().unwrap()).unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    let (_stop, stopped) = watch::channel(false);
    tokio::spawn(async move {
        let (router, limits) = (Router::new().route("/", get(echo)), ConnectionLimits::default());
        loop {
            let (socket, peer) = listener.accept().await.unwrap();
            let Admission::Granted(permit) = limits.take(peer.ip()) else { panic!("no permit") };
            tokio::spawn(serve_client(ClientSocket::new(socket, permit), None, router.clone(), stopped.clone()));
        }
    });
    let folder = std::env::temp_dir().join(format!("isophote-autobahn-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let servers = json!([{"agent": "isophote", "url": url}]);
    let (cases, excluded) = (["*"], ["12.*", "13.*"]);
    let asked = json!({"outdir": folder, "servers": servers, "cases": cases, "exclude-cases": excluded,
                       "exclude-agent-cases": {}});
    std::fs::write(folder.join("asked.json"), asked.to_string()).unwrap();
    let mut suite = Command::new(program);
    suite.args(["--mode", "fuzzingclient", "--spec"]).arg(folder.join("asked.json")).current_dir(&folder);
    let said = tokio::task::spawn_blocking(move || suite.output()).await.unwrap().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let found: Value = serde_json::from_slice(&std::fs::read(folder.join("index.json")).unwrap()).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let found = found["isophote"].as_object().unwrap();
    let is_fault = |how: &Value| matches!(how.as_str(), Some("FAILED" | "WRONG CODE" | "UNCLEAN"));
    let faults = found.iter().filter(|(_, case)| is_fault(&case["behavior"]) || is_fault(&case["behaviorClose"]));
    let faults: Vec<_> = faults.map(|(name, case)| format!("{name}: {case}")).collect();
    assert!(faults.is_empty(), "{faults:#?}");
    assert_eq!(found.len(), CASES);
    let mut kinds = std::collections::BTreeMap::<&str, usize>::new();
    found.values().for_each(|case| *kinds.entry(case["behavior"].as_str().unwrap()).or_default() += 1);
    eprintln!("{kinds:?}");
}
