//! docs/flops.md and docs/figure-6-1.svg: what stands between the page's markers is written by the benchmark.

use std::path::PathBuf;

use isophote_symbolic::BodyFlops;

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
    let (before, rest) = page.split_once(&begin).unwrap_or_else(|| panic!("docs/flops.md has no marker {begin}"));
    let (_, after) = rest.split_once(&end).unwrap_or_else(|| panic!("docs/flops.md has no marker {end}"));
    format!("{before}{begin}\n{text}\n{end}{after}")
}

/// Writes a part of the page.
pub fn write(part: &str, text: &str) {
    let page = std::fs::read_to_string(docs("flops.md")).unwrap();
    std::fs::write(docs("flops.md"), with(&page, part, text)).unwrap();
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
    std::fs::write(docs("figure-6-1.svg"), svg).unwrap();
}

/// True when page and figure say this.
pub fn agrees(counts: &str, svg: &str) -> bool {
    let page = std::fs::read_to_string(docs("flops.md")).unwrap();
    with(&page, COUNTS, counts) == page && std::fs::read_to_string(docs("figure-6-1.svg")).unwrap_or_default() == svg
}
