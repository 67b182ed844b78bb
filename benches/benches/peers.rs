//! `cargo bench -p isophote-benches --bench peers [-- --frames N]`: the tracker with shipped documents beside Ceres, NumPy, SciPy and
//! OpenCV on the same frames: microseconds a frame and RMSE/CRLB of the centre. What is not installed is left out by name. Rounds
//! take turns, so that what disturbs the machine disturbs all. With `UPDATE_EXPECT=1` it writes its part of docs/speed.md and
//! docs/peers.svg.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::peers::Answers;
use isophote_benches::peers::course::{CASES, Course};
use isophote_benches::peers::ours::{self, DOCUMENTS};
use isophote_benches::peers::tables::{Outcome, figure};
use isophote_benches::peers::theirs::{Programs, folder};
use isophote_benches::{page, tracked};

/// Frames of a case, and how often all methods see them.
const FRAMES: usize = 640;
const ROUNDS: usize = 5;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let limit = arguments.iter().position(|argument| argument == "--frames");
    let count = limit.map_or(FRAMES, |at| arguments[at + 1].parse().unwrap());
    let width = *tracked::widths().last().unwrap();
    let mut programs = Programs::new();
    let mut outcomes = Vec::new();
    for (number, case) in CASES.into_iter().enumerate() {
        let course = Course::new(case, count);
        let path = folder().join(format!("course-{number}"));
        course.write(&path).unwrap();
        let round = |_| -> Answers {
            let ours = DOCUMENTS.map(|name| (format!("isophote, {name}"), ours::answers(name, width, &course)));
            ours.into_iter().chain(programs.answers(&path)).collect()
        };
        let rounds: Vec<Answers> = (0..ROUNDS).map(round).collect();
        std::fs::remove_file(&path).unwrap();
        outcomes.push(Outcome::new(case, &course, &rounds));
        println!("{}", outcomes[number].table());
    }
    let sources = ["../symbolic", "../jit", "../tracker", "../models"];
    let mut text = page::provenance("peers", &sources);
    text += &format!(
        " Vectors of {} bits; {ROUNDS} rounds of {count} frames, the first {} left out.",
        8 * width.bytes(),
        tracked::SETTLING
    );
    for skipped in &programs.skipped {
        println!("left out: {skipped}");
        text += &format!(" Left out: {skipped}.");
    }
    outcomes.iter().for_each(|outcome| text += &format!("\n\n{}", outcome.table()));
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("speed.md", "peers", text.trim_end());
        page::write_svg("peers.svg", &figure(&outcomes));
    }
}
