//! docs/flops.md and docs/figure-6-1.svg: what stands between the page's markers is written by the benchmark.

use std::path::PathBuf;
use std::process::Command;

use crate::bodies::BodyFlops;
use crate::counts::{Row, in_columns};
use crate::figure;

/// The part of the page that says how many flops; the same on every machine.
pub const COUNTS: &str = "counts";
/// The part that says how long; as it was measured once.
pub const TIMES: &str = "times";

fn docs(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "docs", name].iter().collect()
}

/// The page with one marked part replaced.
fn with(page: &str, part: &str, text: &str) -> String {
    let (begin, end) = (format!("<!-- {part}: written by the benchmark -->\n"), format!("<!-- end of {part} -->"));
    let (before, rest) = page.split_once(&begin).unwrap_or_else(|| panic!("the page has no marker {begin}"));
    let (_, after) = rest.split_once(&end).unwrap_or_else(|| panic!("the page has no marker {end}"));
    format!("{before}{begin}\n{text}\n{end}{after}")
}

/// Writes a part of docs/flops.md.
pub fn write(part: &str, text: &str) {
    write_to("flops.md", part, text);
}

/// Writes a part of a page.
pub fn write_to(name: &str, part: &str, text: &str) {
    let page = std::fs::read_to_string(docs(name)).unwrap();
    std::fs::write(docs(name), with(&page, part, text)).unwrap();
}

/// Writes a figure.
pub fn write_svg(name: &str, svg: &str) {
    std::fs::write(docs(name), svg).unwrap();
}

/// On which machine, by which benchmark, at which commit; `sources` say whether there are changes since.
pub fn provenance(bench: &str, sources: &[&str]) -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR"));
        let output = command.output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let commit = git(&["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "unknown".into());
    let changed = git(&[&["status", "--porcelain", "--"], sources].concat()).is_none_or(|files| !files.is_empty());
    format!(
        "{}, {cores} cores, one thread; `cargo bench -p isophote-benches --bench {bench}`; commit {commit}{}.",
        model.unwrap_or("an unnamed processor"),
        if changed { " with changes" } else { "" }
    )
}

/// The figure of these rows.
pub fn figure(rows: &[(&Row, BodyFlops)]) -> String {
    let bars = |(row, ours): &(&Row, BodyFlops)| -> [u32; 8] {
        let ours = in_columns(ours);
        std::array::from_fn(|i| if i < 4 { row.maple[i] } else { ours[i - 4] })
    };
    let groups: Vec<(&str, [u32; 8])> = rows.iter().map(|row| (row.0.name, bars(row))).collect();
    figure::svg(&groups)
}

/// Writes the figure.
pub fn write_figure(svg: &str) {
    write_svg("figure-6-1.svg", svg);
}

/// True when page and figure say this.
pub fn agrees(counts: &str, svg: &str) -> bool {
    let page = std::fs::read_to_string(docs("flops.md")).unwrap();
    with(&page, COUNTS, counts) == page && std::fs::read_to_string(docs("figure-6-1.svg")).unwrap_or_default() == svg
}
