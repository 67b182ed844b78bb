//! The tables and figure of docs/speed.md.

use std::fmt::Write;

use isophote_jit::VectorWidth;

use super::against::Race;
use super::compile_time::{CompileTime, PROCESSES, RUNS, Text};
use super::contenders;
use super::race::{ContenderTime, ROUNDS};
use crate::plot::Svg;

/// All measurements of one run.
pub struct Measured {
    /// Against other compilers, one race per subset, for each picture.
    pub races: [Vec<Race>; 4],
    /// Against the thesis' code.
    pub thesis: Vec<ContenderTime>,
    /// By window, covered by the domain.
    pub covered: Vec<(VectorWidth, Vec<ContenderTime>)>,
    /// By window, with the inscribed ellipse as the domain.
    pub ellipse: Vec<(VectorWidth, Vec<ContenderTime>)>,
    /// f32 and u8 for each subset.
    pub formats: Vec<(&'static str, Vec<ContenderTime>)>,
}

/// The page's tables.
pub fn text(m: &Measured) -> String {
    [provenance("aot"), races(m), thesis(m), windows(m)].join("\n\n")
}

fn times(table: &mut String, list: &[ContenderTime]) {
    for s in list {
        let bytes = s.code_bytes.map_or("–".into(), |bytes| bytes.to_string());
        let [min, max] = s.range_ns;
        writeln!(table, "| {} | {:.2} ({min:.2} – {max:.2}) | {:.2} | {bytes} |", s.name, s.median_ns, s.ratio)
            .unwrap();
    }
}

/// Pictures of the races.
const SCENES: [&str; 4] = ["640 × 480 px", "96 × 96 px", "24 × 24 px", "ellipse in 24 × 24 px"];
const HEAD: &str = "| | ns a pixel: median (min – max) | times the first | bytes of code |\n|---|---|---|---|\n";

fn races(m: &Measured) -> String {
    let mut text = format!("## Against compilers ahead of time\n\nMedians of {ROUNDS} rounds.\n");
    if !contenders::has_widest() {
        text += "\nLeft out, for this machine has no AVX-512: all that have vectors of 512 bits.\n";
    }
    for (races, over) in m.races.iter().zip(SCENES) {
        let names: String = races.iter().map(|race| format!(" {{{}}} |", race.name)).collect();
        write!(text, "\n### {over}\n\n| ns a pixel |{names}\n|---|{}\n", "---|".repeat(races.len())).unwrap();
        for (row, contender) in races[0].times.iter().enumerate() {
            let times: String = races.iter().map(|race| format!(" {:.2} |", race.times[row].median_ns)).collect();
            writeln!(text, "| {} |{times}", contender.name).unwrap();
        }
    }
    text
}

fn thesis(m: &Measured) -> String {
    let mut text = format!("## Against the thesis' code\n\n{{a}}, saturated pixels left out by all.\n\n{HEAD}");
    times(&mut text, &m.thesis);
    text
}

fn windows(m: &Measured) -> String {
    let mut text = String::from(
        "## By window and pixel format\n\nKernel of {b}, f32 pixels, ns a pixel of the domain; times the first row.\n",
    );
    for ((width, covered), (_, ellipse)) in m.covered.iter().zip(&m.ellipse) {
        writeln!(text, "\n| window, {} bits | domain covers it | × | inscribed ellipse | × |", 8 * width.bytes())
            .unwrap();
        text += "|---|---|---|---|---|\n";
        for (a, b) in covered.iter().zip(ellipse) {
            writeln!(
                text,
                "| {} | {:.2} | {:.2} | {:.2} | {:.2} |",
                a.name, a.median_ns, a.ratio, b.median_ns, b.ratio
            )
            .unwrap();
        }
    }
    text += "\n128 bits:\n\n| subset | f32 pixels, ns | u8 pixels, ns | × |\n|---|---|---|---|\n";
    for (name, list) in &m.formats {
        let [f32, u8] = [&list[0], &list[1]];
        writeln!(text, "| {{{name}}} | {:.2} | {:.2} | {:.2} |", f32.median_ns, u8.median_ns, u8.ratio).unwrap();
    }
    text
}

/// The table of compile times.
pub fn compile(texts: &[Text], warm: &[(&str, CompileTime)], cold: CompileTime) -> String {
    let mut text = provenance("aot -- compile").replace(", one thread", "");
    text += "\n\n| document | bits | two threads: median, ms | p99 | asked | | one thread: median, ms |\n|---|---|---|---|---|---|---|\n";
    for Text { document, width, two, one, asked_ms } in texts {
        let verdict = if two.median_ms <= *asked_ms { "reached" } else { "**missed**" };
        writeln!(
            text,
            "| `{document}` | {} | {:.1} | {:.1} | ≤ {asked_ms:.0} | {verdict} | {:.1} |",
            8 * width.bytes(),
            two.median_ms,
            two.p99_ms,
            one.median_ms
        )
        .unwrap();
    }
    write!(
        text,
        "\n`thesis-spot` at 128 bits more closely; warm: {RUNS} runs; first call: {PROCESSES} fresh processes.\n"
    )
    .unwrap();
    text += "\n| | median, ms | p99, ms |\n|---|---|---|\n";
    for (name, took) in warm.iter().chain(&[("model text to all kernels, first call of a process", cold)]) {
        writeln!(text, "| {name} | {:.2} | {:.2} |", took.median_ms, took.p99_ms).unwrap();
    }
    text
}

/// Machine, command, commit.
fn provenance(bench: &str) -> String {
    crate::page::provenance(bench, &["../symbolic", "../jit", "../tracker", "../models"])
}

/// Bar chart: ns per pixel of every contender, grouped by subset. Colours are legible on white and on black.
pub fn svg(m: &Measured) -> String {
    const COLOURS: [(&str, &[&str]); 4] = [
        ("isophote", &["#2f68b0", "#4f8fd6", "#86b8ee"]),
        ("same", &["#a85a1c", "#cf7a2f", "#e39b55", "#edbd86", "#c9a06b", "#d9c39a", "#b98a4e"]),
        ("unfactored", &["#5f8f4e", "#7fb069", "#a3cf8f"]),
        ("SymPy", &["#8a5fc0", "#a985d8", "#c9b0ea"]),
    ];
    let races = &m.races[0];
    let contenders = &races[0].times;
    let top = races.iter().flat_map(|race| &race.times).map(|s| s.median_ns).fold(0.0, f64::max);
    let colour = |i: usize| {
        let (head, shades) =
            COLOURS.into_iter().find(|(head, _)| contenders[i].name.starts_with(head)).unwrap_or(COLOURS[0]);
        let place = contenders[..i].iter().filter(|s| s.name.starts_with(head)).count();
        shades[place % shades.len()]
    };
    let (bar, gap, left, base, height) = (18, 24, 44, 320, 270.0);
    let group = contenders.len() * bar + gap;
    let (width, tall) = (left + races.len() * group, base + 40 + contenders.len().div_ceil(3) * 16);
    let mut svg = Svg::new("Nanoseconds a pixel: isophote's kernels and other compilers' loops", width, tall);
    svg.text([&left, &16], "font-size=\"13\"", "ns a pixel, thesis-spot, Newton, f32 pixels");
    for tick in 0..=top as usize {
        svg.tick(base as f64 - tick as f64 / top * height, [left as f64, width as f64], "0.3", tick);
    }
    for (g, race) in races.iter().enumerate() {
        for (i, s) in race.times.iter().enumerate() {
            let (x, tall) = (left + 8 + g * group + i * bar, s.median_ns / top * height);
            let (y, colour) = (base as f64 - tall, colour(i));
            let title = format!("<title>{}: {:.2} ns</title>", s.name, s.median_ns);
            svg.rect([&x, &format_args!("{y:.1}")], [&(bar - 2), &format_args!("{tall:.1}")], colour, &title);
        }
        let x = left + 8 + g * group;
        svg.text([&x, &(base + 16)], "font-size=\"12\"", format_args!("{{{}}}", race.name));
    }
    for (i, s) in contenders.iter().enumerate() {
        let (x, y) = (left + (i % 3) * 230, base + 36 + (i / 3) * 16);
        svg.rect([&x, &(y - 9)], [&10, &10], colour(i), "");
        svg.text([&(x + 15), &y], "", &s.name);
    }
    svg.finish()
}
