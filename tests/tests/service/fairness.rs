//! Documents that are slow to compile delay no other session, and changes keep their order.

use std::fmt::Write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use serde_json::json;

use crate::client::{Running, session};

/// A model of several stages, each slow to derive and to compile.
fn bomb(number: usize) -> String {
    let mut text =
        format!("name = \"bomb{number}\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n");
    let (mut intensity, mut all) = (format!("{number} / 1000"), Vec::new());
    for bump in 0..6 {
        for name in ["x", "y", "w", "v"] {
            writeln!(text, "{name}{bump} = {{ start = {} }}", 10 + bump).unwrap();
            all.push(format!("\"{name}{bump}\""));
        }
        write!(intensity, " + v{bump} * exp(-((x - x{bump})^2 + (y - y{bump})^2) / (w{bump}^2 + {bump}.5))").unwrap();
    }
    writeln!(text, "[model]\nintensity = \"{intensity}\"").unwrap();
    for stage in 0..2 {
        writeln!(text, "[[stages]]\nparameters = [{}]\nmethod = \"newton\"", all[stage..].join(", ")).unwrap();
    }
    text
}

#[test]
fn slow_uploads_do_not_delay_swaps() {
    const CLIENTS: usize = 4;
    let service = Running::start();
    service.put("/v1/sessions/one", &session("fit", 500.0)).expect(201);
    for model in ["gaussian", "spot"] {
        service.put("/v1/sessions/one/model", &json!({"model": model})).expect(200);
    }
    let (sent, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
    std::thread::scope(|scope| {
        for client in 0..CLIENTS {
            let (service, sent, is_over) = (&service, &sent, &is_over);
            scope.spawn(move || {
                let bombs = (0..).map(|number| bomb(CLIENTS * number + client));
                for text in bombs.take_while(|_| !is_over.load(Ordering::SeqCst)) {
                    let path = format!("/v1/models/bomb{client}");
                    let answer = service.put_text(&path, "application/toml", &text);
                    assert!(matches!(answer.status, 200 | 201), "{}", answer.text);
                    sent.fetch_add(1, Ordering::SeqCst);
                }
            });
        }
        let (mut swaps, mut slowest_ms) = (0, 0);
        while sent.load(Ordering::SeqCst) < CLIENTS {
            let begin = Instant::now();
            let model = ["gaussian", "spot"][swaps % 2];
            service.put("/v1/sessions/one/model", &json!({"model": model})).expect(200);
            slowest_ms = slowest_ms.max(begin.elapsed().as_millis());
            swaps += 1;
        }
        is_over.store(true, Ordering::SeqCst);
        eprintln!("{swaps} swaps beside the first {CLIENTS} uploads, the slowest of {slowest_ms} ms");
        // In a single queue each swap would have waited for all earlier uploads.
        assert!(swaps >= 2 * CLIENTS, "{swaps}");
    });
    service.stop();
}

/// Concurrent documents of one name: each gets its own version, and the last one answered is active.
#[test]
fn changes_of_one_model_keep_their_order() {
    let service = Running::start();
    let text = |number: usize| format!("# {number}\n{}", bomb(0).replace("0 / 1000", &format!("{number} / 1000")));
    let mut versions: Vec<(u64, String)> = std::thread::scope(|scope| {
        let put = |number: usize| {
            let (service, text) = (&service, text(number));
            scope.spawn(move || {
                let answer = service.put_text("/v1/models/one", "application/toml", &text);
                assert!(matches!(answer.status, 200 | 201), "{}", answer.text);
                let answer = answer.json();
                (answer["version"].as_u64().unwrap(), answer["digest"].as_str().unwrap().to_string())
            })
        };
        let threads: Vec<_> = (0..4).map(put).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    versions.sort();
    assert_eq!(versions.iter().map(|(version, _)| *version).collect::<Vec<_>>(), [1, 2, 3, 4]);
    let kept = service.get("/v1/models/one").expect(200);
    assert_eq!((&kept["version"], kept["digest"].as_str()), (&json!(4), Some(versions[3].1.as_str())));
    service.stop();
}
