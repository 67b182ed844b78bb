//! `cargo bench -p isophote-benches --bench tracked [-- DOCUMENT… --frames N]`: the cost of a tracked frame of shipped
//! documents, relative to one pass of the {a, b, v} kernel of `thesis-spot` over as many pixels at the same width.
//! Predictions are off by 0.1 px and 1 px: the target jumps about a steady course. Frames and passes alternate;
//! medians and 99th percentiles. With all documents, `UPDATE_EXPECT=1` writes its part of docs/speed.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::page;
use isophote_benches::tracked::line::{HEAD, Task, line};
use isophote_benches::tracked::subject::{Plate, Small, Spot, Subject};
use isophote_benches::tracked::widths;

/// Number of frames, including warm-up.
const FRAMES: usize = 600;
/// Document, semi-axes of a spot target, px, and goals of frame/pass for 0.1 px and 1 px.
const TASKS: [(&str, [f64; 2], [f64; 2]); 7] = [
    ("spot", [60.0, 42.0], [6.0, 10.0]),
    ("spot", [18.0, 14.0], [10.0, 14.0]),
    ("spot-plane", [60.0, 42.0], [10.0, 10.0]),
    ("spot-plane", [18.0, 14.0], [10.0, 10.0]),
    ("gaussian-pixel", [0.0; 2], [25.0, 25.0]),
    ("three-spots-pose", [0.0; 2], [40.0, 40.0]),
    ("three-spots-pose-raw", [0.0; 2], [40.0, 40.0]),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let limit = arguments.iter().position(|argument| argument == "--frames");
    let count = limit.map_or(FRAMES, |at| arguments[at + 1].parse().unwrap());
    let is_named = |document: &str| arguments.iter().any(|argument| argument == document);
    let some = TASKS.iter().any(|(document, ..)| is_named(document));
    println!("{HEAD}");
    let mut table = HEAD.to_string();
    for width in widths() {
        for (document, semi_axes_px, asked) in TASKS.into_iter().filter(|task| !some || is_named(task.0)) {
            for (jump_px, asked) in [0.1, 1.0].into_iter().zip(asked) {
                let mut subject: Box<dyn Subject> = match document {
                    "gaussian-pixel" => Box::new(Small::new()),
                    "three-spots-pose" | "three-spots-pose-raw" => Box::new(Plate::new(document)),
                    _ => Box::new(Spot::of_size(document, semi_axes_px, 0.02 * count as f64)),
                };
                let line = line(subject.as_mut(), &Task { document, jump_px, width, count, asked });
                println!("{line}");
                table += &format!("\n{line}");
            }
        }
    }
    if !some && std::env::var_os("UPDATE_EXPECT").is_some() {
        let provenance = page::provenance("tracked", &["../symbolic", "../jit", "../tracker", "../models"]);
        page::write_to("speed.md", "tracked", &format!("{provenance}\n\n{table}"));
    }
}
