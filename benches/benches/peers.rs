//! `cargo bench -p isophote-benches --bench peers [-- --frames N]`: the tracker with shipped documents against Ceres,
//! NumPy, SciPy and OpenCV on the same frames: microseconds per frame and RMSE/CRLB of the centre. Programs not
//! installed are listed as skipped. Methods alternate by round, so that disturbances of the machine affect all.
//! `UPDATE_EXPECT=1` writes its part of docs/speed.md and docs/peers.svg.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::peers::Answers;
use isophote_benches::peers::ours::{self, DOCUMENTS};
use isophote_benches::peers::sequence::{CASES, FrameSequence};
use isophote_benches::peers::tables::{Outcome, figure};
use isophote_benches::peers::theirs::{Programs, folder};
use isophote_benches::{page, tracked};

/// Frames of a case, and rounds of all methods.
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
        let sequence = FrameSequence::new(case, count);
        let path = folder().join(format!("course-{number}"));
        sequence.write(&path).unwrap();
        let round = |_| -> Answers {
            let ours = DOCUMENTS.map(|name| (format!("isophote, {name}"), ours::answers(name, width, &sequence)));
            ours.into_iter().chain(programs.answers(&path)).collect()
        };
        let rounds: Vec<Answers> = (0..ROUNDS).map(round).collect();
        std::fs::remove_file(&path).unwrap();
        outcomes.push(Outcome::new(case, &sequence, &rounds));
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
