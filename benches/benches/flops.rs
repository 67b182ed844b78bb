//! What the loops cost, and how long it takes to find them: the tables and the figure of docs/flops.md.
//!
//! `cargo bench -p isophote-benches --bench flops` prints them, and says whether the page's counts are the same; with
//! `UPDATE_EXPECT=1` it writes page and figure. Times are wall times of one thread.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint::black_box;
use std::process::{Command, ExitCode};

use isophote_benches::{counts, page, shipped, text, time};
use isophote_symbolic::{Lowering, Method, Model, Objective, ParameterId};

const RUNS: usize = 200;
const LOWERING: Lowering = Lowering { fma: true, drop_saturated: true };

fn stages(model: &Model) -> Vec<Objective> {
    model.stages().iter().map(|stage| model.objective(&stage.parameters, stage.method).unwrap()).collect()
}

fn milliseconds(f: impl FnMut()) -> String {
    let [median, min, max] = time(RUNS, f).map(|us| us / 1e3);
    format!("{median:.2} ({min:.2} – {max:.2})")
}

fn times() -> String {
    let mut table =
        format!("{}\n\n| from | to | ms: median (min – max) of {RUNS} runs |\n|---|---|---|\n", provenance());
    let thesis = text("thesis-spot");
    let all = |text: &str| {
        let model = Model::from_toml(text).unwrap();
        for objective in stages(&model) {
            black_box(objective.program(LOWERING).unwrap());
        }
    };
    let mut row = |from: &str, to: &str, took: String| table += &format!("| {from} | {to} | {took} |\n");
    row("thesis-spot, text", "**checked programs of its three stages** (goal: 5)", milliseconds(|| all(&thesis)));
    let model = Model::from_toml(&thesis).unwrap();
    row("of which reading", "a model", milliseconds(|| drop(black_box(Model::from_toml(&thesis).unwrap()))));
    row("of which deriving and checking", "objectives", milliseconds(|| drop(black_box(stages(&model)))));
    let objectives = stages(&model);
    let lower = || objectives.iter().for_each(|objective| drop(black_box(objective.program(LOWERING).unwrap())));
    row("of which lowering", "programs", milliseconds(lower));
    let nine: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    let one = || drop(black_box(model.objective(&nine, Method::Newton).unwrap().program(LOWERING).unwrap()));
    row("thesis-spot, model", "checked program of all nine parameters, Newton", milliseconds(one));
    for name in shipped().iter().filter(|name| *name != "thesis-spot") {
        let text = text(name);
        let count = Model::from_toml(&text).unwrap().stages().len();
        let to = if count == 1 { "program of its stage".into() } else { format!("programs of its {count} stages") };
        row(&format!("{name}, text"), &to, milliseconds(|| all(&text)));
    }
    table
}

/// On which machine, by which command, at which commit.
fn provenance() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let commit = git(&["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "unknown".into());
    let changed =
        git(&["status", "--porcelain", "--", "../symbolic", "../models"]).is_none_or(|files| !files.is_empty());
    format!(
        "{}, {cores} cores, one thread; `cargo bench -p isophote-benches --bench flops`; commit {commit}{}.",
        model.unwrap_or("an unnamed processor"),
        if changed { " with changes" } else { "" }
    )
}

fn main() -> ExitCode {
    let rows = counts::rows();
    let (tables, svg) = (counts::tables(&rows), page::figure(&rows));
    println!("{tables}");
    let times = times();
    println!("## Time\n\n{times}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write(page::COUNTS, &tables);
        page::write(page::TIMES, &times);
        page::write_figure(&svg);
    }
    if page::agrees(&tables, &svg) {
        println!("the counts of docs/flops.md are these");
        return ExitCode::SUCCESS;
    }
    println!("docs/flops.md has other counts; UPDATE_EXPECT=1 writes these");
    ExitCode::FAILURE
}
