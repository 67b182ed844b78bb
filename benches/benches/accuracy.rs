//! `cargo bench -p isophote-benches --bench accuracy [-- CONDITION… --frames N]`: how right estimates are, over the
//! Cramér–Rao bound, on rendered frames with known truth. Named conditions are measured alone; without any, the curves, the
//! basin and the covariance as well, and with `UPDATE_EXPECT=1` docs/accuracy.md and its figures are written. The same
//! frames come in every run, whatever the processors.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::condition::{ROWS, Row};
use isophote_benches::accuracy::report::Report;
use isophote_benches::accuracy::run::{Documents, Measured, measure};
use isophote_benches::accuracy::{basin, curves, sampling, table};
use isophote_benches::page;

/// Frames of a row.
const FRAMES: usize = 3000;
/// Frames of a row whose covariance is judged.
const FRAMES_LONG: usize = 10_000;
/// Frames of a point of a curve and of a cell of the basin.
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
    let some = ROWS.iter().any(|row| named(&row));
    let mut documents = Documents::default();
    println!("{}", table::HEAD);
    let mut rows: Vec<(Row, Measured)> = Vec::new();
    for row in ROWS.iter().filter(|row| !some || named(row)) {
        let measured = measure(&row.task(), documents.get(row.document), frames(FRAMES));
        println!("{}", table::centre_line(row, &measured));
        rows.push((*row, measured));
    }
    println!("\n{}", table::worth(&rows.iter().map(|(_, measured)| measured).collect::<Vec<_>>()));
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
