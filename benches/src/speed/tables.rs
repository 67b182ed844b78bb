//! docs/speed.md and its figure: what was measured, as tables, and beside what was asked for.

use std::fmt::Write;

use isophote_jit::VectorWidth;

use super::against::{self, Race, SUBSETS, title};
use super::compile_time::{PROCESSES, RUNS, Text, Took};
use super::contenders;
use super::race::{ROUNDS, Standing};
use crate::plot::Svg;

/// All that one run measures.
pub struct Measured {
    /// Against other compilers, one a subset: over each of the pictures.
    pub races: [Vec<Race>; 4],
    /// Against the thesis' code.
    pub thesis: Vec<Standing>,
    /// By window; the domain covers it.
    pub covered: Vec<(VectorWidth, Vec<Standing>)>,
    /// By window; the domain is the inscribed ellipse.
    pub ellipse: Vec<(VectorWidth, Vec<Standing>)>,
    /// f32 and u8 for each subset.
    pub formats: Vec<(&'static str, Vec<Standing>)>,
}

fn named<'a>(standings: &'a [Standing], head: &str) -> Option<&'a Standing> {
    standings.iter().find(|standing| standing.name.starts_with(head))
}

/// The fastest that does the same sums with vectors of that width, and how the kernel's time is to its.
fn best_of(race: &Race, width: VectorWidth) -> (&Standing, f64) {
    let bits = (8 * width.bytes()).to_string();
    let fits = |s: &&Standing| s.name.starts_with("same program") && s.name.contains(&bits);
    let best = race.standings.iter().filter(fits).min_by(|a, b| a.ratio.total_cmp(&b.ratio)).unwrap();
    (best, named(&race.standings, &title(width)).unwrap().ratio / best.ratio)
}

/// The fastest of those loops, of any width.
fn best_called<'a>(race: &'a Race, head: &str) -> &'a Standing {
    let all = race.standings.iter().filter(|s| s.name.starts_with(head));
    all.min_by(|a, b| a.ratio.total_cmp(&b.ratio)).unwrap()
}

/// The page's tables.
pub fn text(m: &Measured) -> String {
    [provenance("aot"), asked(m), races(m), thesis(m), windows(m)].join("\n\n")
}

fn asked(m: &Measured) -> String {
    let mut table = String::from("## Asked and reached\n\n| figure | asked | reached | |\n|---|---|---|---|\n");
    let mut row = |figure: &str, asked: String, reached: String, holds: Option<bool>| {
        let verdict = holds.map_or("reported", |holds| if holds { "reached" } else { "**missed**" });
        writeln!(table, "| {figure} | {asked} | {reached} | {verdict} |").unwrap();
    };
    for (races, over) in m.races.iter().zip(SCENES) {
        for race in races {
            for width in against::widths() {
                let (best, times) = best_of(race, width);
                let figure = format!("{{{}}}, {over}: kernel's time by that of {}", race.name, best.name);
                row(&figure, "≤ 1.05 ×".into(), format!("{times:.2} ×"), Some(times <= 1.05));
            }
        }
    }
    for (race, (.., goal)) in m.races[0].iter().zip(SUBSETS) {
        let ratio = named(&race.standings, "unfactored, C, 128").unwrap().ratio;
        let figure = format!("{{{}}}: faster than the unfactored derivative in C at 128 bits", race.name);
        row(&figure, format!("≥ {goal:.1} ×"), format!("{ratio:.2} ×"), Some(ratio >= goal));
    }
    for race in &m.races[0] {
        let (best, kernel) = (best_called(race, "unfactored"), best_called(race, "isophote"));
        let figure = format!("{{{}}}: the same at the best width of each ({}; {})", race.name, kernel.name, best.name);
        row(&figure, "–".into(), format!("{:.2} ×", best.ratio / kernel.ratio), None);
    }
    for ((races, over), goals) in m.races.iter().zip(SCENES).zip(SYMPY_GOALS) {
        for (race, goal) in races.iter().zip(goals) {
            let (best, kernel) = (best_called(race, "SymPy"), best_called(race, "isophote"));
            let times = best.ratio / kernel.ratio;
            let figure = format!("{{{}}}, {over}: {} faster than {}", race.name, kernel.name, best.name);
            row(&figure, format!("≥ {goal:.1} ×"), format!("{times:.2} ×"), Some(times >= goal));
        }
    }
    let printed = named(&m.thesis, "appendix A.1 as printed").unwrap();
    let rational = named(&m.thesis, "isophote's kernel of rational").unwrap();
    let spot = named(&m.thesis, "isophote's kernel of thesis").unwrap();
    for (name, kernel) in [("rational-spot, the model that it is written for", rational), ("thesis-spot", spot)] {
        let times = printed.ratio / kernel.ratio;
        let figure = format!("{{a}}: faster than appendix A.1, kernel of {name}");
        row(&figure, "≥ 15 ×".into(), format!("{times:.1} ×"), Some(times >= 15.0));
    }
    for (what, widths, asked) in
        [("all of it", &m.covered, [2.0, 1.6, 2.0]), ("its ellipse", &m.ellipse, [2.0, 2.0, 2.6])]
    {
        for (width, standings) in widths {
            let (ratio, asked) = (named(standings, "24 x 24").unwrap().ratio, asked[*width as usize]);
            let bits = 8 * width.bytes();
            let figure = format!("a pixel of a 24 × 24 window by one of 640-px rows, {what}, {bits} bits");
            row(&figure, format!("≤ {asked:.1} ×"), format!("{ratio:.2} ×"), Some(ratio <= asked));
        }
    }
    table
}

fn standings(table: &mut String, list: &[Standing]) {
    for s in list {
        let bytes = s.code_bytes.map_or("–".into(), |bytes| bytes.to_string());
        let [min, max] = s.range_ns;
        writeln!(table, "| {} | {:.2} ({min:.2} – {max:.2}) | {:.2} | {bytes} |", s.name, s.median_ns, s.ratio)
            .unwrap();
    }
}

/// What is raced over.
const SCENES: [&str; 4] = ["640 × 480 px", "96 × 96 px", "24 × 24 px", "ellipse in 24 × 24 px"];
/// How many times faster than SymPy's loops kernels are asked to be, over each of them but the last.
const SYMPY_GOALS: [[f64; 4]; 3] = [[1.6, 1.5, 3.0, 2.8], [1.5, 1.4, 2.7, 2.5], [1.2; 4]];

const HEAD: &str = "| | ns a pixel: median (min – max) | times the first | bytes of code |\n|---|---|---|---|\n";

fn races(m: &Measured) -> String {
    let mut text = format!("## Against compilers ahead of time\n\n{ROUNDS} rounds.\n");
    if !contenders::has_widest() {
        text += "\nLeft out, for this machine has no AVX-512: all that have vectors of 512 bits.\n";
    }
    for (races, over) in m.races.iter().zip(SCENES) {
        for race in races {
            write!(text, "\n### {{{}}}, {over}\n\n{HEAD}", race.name).unwrap();
            standings(&mut text, &race.standings);
        }
    }
    text
}

fn thesis(m: &Measured) -> String {
    let mut text = format!("## Against the thesis' code\n\n{{a}}, saturated pixels left out by all.\n\n{HEAD}");
    standings(&mut text, &m.thesis);
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

/// How long compiling takes.
pub fn compile(texts: &[Text], warm: &[(&str, Took)], cold: Took) -> String {
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

/// Bars: ns a pixel of every contender, a group a subset. Colours can be read on white and on black.
pub fn svg(m: &Measured) -> String {
    const COLOURS: [(&str, &[&str]); 4] = [
        ("isophote", &["#2f68b0", "#4f8fd6", "#86b8ee"]),
        ("same", &["#a85a1c", "#cf7a2f", "#e39b55", "#edbd86", "#c9a06b", "#d9c39a", "#b98a4e"]),
        ("unfactored", &["#5f8f4e", "#7fb069", "#a3cf8f"]),
        ("SymPy", &["#8a5fc0", "#a985d8", "#c9b0ea"]),
    ];
    let races = &m.races[0];
    let contenders = &races[0].standings;
    let top = races.iter().flat_map(|race| &race.standings).map(|s| s.median_ns).fold(0.0, f64::max);
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
        for (i, s) in race.standings.iter().enumerate() {
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
