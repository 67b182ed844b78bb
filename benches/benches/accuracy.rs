//! `cargo bench -p isophote-benches --bench accuracy [-- CONDITION… --frames N]`: errors of estimates over the
//! Cramér–Rao bound, on rendered frames with known truth. Named conditions are measured alone; without any, the
//! curves, the basin and the covariance as well, and `UPDATE_EXPECT=1` writes docs/accuracy.md and its figures.
//! `held-out [--seed N] [--row WORD]`: conditions that nothing was tuned to. Frames are the same in every run,
//! whatever the processors.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::condition::{ROWS, Row};
use isophote_benches::accuracy::report::Report;
use isophote_benches::accuracy::run::{Documents, Measured, measure};
use isophote_benches::accuracy::{basin, curves, held_out, sampling, table};
use isophote_benches::page;

/// Frames of a row.
const FRAMES: usize = 3000;
/// Frames of a row whose covariance is tested.
const FRAMES_LONG: usize = 10_000;
/// Frames of a point of a curve, and of a cell of the basin.
const FRAMES_POINT: usize = 500;
const FRAMES_CELL: usize = 200;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let limit =
        arguments.iter().position(|argument| argument == "--frames").map(|at| arguments[at + 1].parse().unwrap());
    let frames = |count: usize| limit.map_or(count, |limit: usize| limit.min(count));
    let named = |row: &&Row| arguments.iter().any(|argument| argument == row.condition);
    if arguments.iter().any(|argument| argument == "sampling") {
        let table = sampling::table(frames(40));
        println!("{table}");
        if std::env::var_os("UPDATE_EXPECT").is_some() {
            page::write_to("accuracy.md", "sampling", &table);
        }
        return;
    }
    if arguments.iter().any(|argument| argument == "held-out") {
        let after = |name: &str| arguments.iter().position(|argument| argument == name).map(|at| &arguments[at + 1]);
        let seed = after("--seed").map_or(0, |seed| seed.parse().unwrap());
        let sources = ["tracker", "jit", "symbolic", "models", "benches"];
        let command = format!("accuracy -- held-out --frames {} --seed {seed}", frames(1000));
        let mut table = format!("{}\n\n{}\n", page::provenance(&command, &sources), held_out::HEAD);
        println!("{}", held_out::HEAD);
        let mut documents = Documents::default();
        for row in held_out::rows() {
            if after("--row").is_some_and(|wanted| !row.condition.name.contains(wanted.as_str())) {
                continue;
            }
            let line = held_out::line(&row, &mut documents, frames(1000), seed);
            println!("{line}");
            table = table + &line + "\n";
        }
        if std::env::var_os("UPDATE_EXPECT").is_some() && after("--row").is_none() {
            page::write_to("accuracy.md", "held-out", &table);
        }
        return;
    }
    let some = ROWS.iter().any(|row| named(&row));
    let mut documents = Documents::default();
    println!("{}", table::HEAD);
    let mut rows: Vec<(Row, Measured)> = Vec::new();
    for row in ROWS.iter().filter(|row| !some || named(row)) {
        let measured = measure(&row.task(), documents.get(row.document), frames(FRAMES));
        println!("{}", table::centre_line(row, &measured));
        rows.push((*row, measured));
    }
    println!("\n{}", table::frame_worth(&rows.iter().map(|(_, measured)| measured).collect::<Vec<_>>()));
    if some {
        return;
    }
    let long = ROWS.iter().filter(|row| ["S0", "S30", "S60"].contains(&row.condition));
    let report = Report {
        rows,
        long: long.map(|row| measure(&row.task(), documents.get(row.document), frames(FRAMES_LONG))).collect(),
        basins: basin::measure(documents.get("spot-plane"), frames(FRAMES_CELL)),
        saturation: curves::saturation(&mut documents, frames(FRAMES_POINT)),
        glare: curves::glare(&mut documents, frames(FRAMES_POINT)),
        occlusion: curves::occlusion(&mut documents, frames(FRAMES_POINT)),
    };
    println!("{}", report.text());
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        report.write();
    }
}
