//! The cost of the loops and the time to derive them: the tables and the figure of docs/flops.md.
//!
//! `cargo bench -p isophote-benches --bench flops` prints them, and whether the page's counts agree; `UPDATE_EXPECT=1`
//! writes page and figure. Wall times of one thread.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint::black_box;
use std::process::ExitCode;

use isophote_benches::flops::{counts, page};
use isophote_benches::page::provenance;
use isophote_benches::{shipped, text, time};
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
    let mut table = format!(
        "{}\n\n| from | to | ms: median (min – max) of {RUNS} runs |\n|---|---|---|\n",
        provenance("flops", &["../symbolic", "../models"])
    );
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
