//! Writes docs/flops.md and docs/figure-6-1.svg, and checks them.

use super::counts::{Row, in_columns};
use super::figure;
use crate::bodies::BodyFlops;
use crate::page::{docs, with, write_svg, write_to};

/// The part with the flops; the same on every machine.
pub const COUNTS: &str = "counts";
/// The part with the times, as measured once.
pub const TIMES: &str = "times";

/// Writes a part of docs/flops.md.
pub fn write(part: &str, text: &str) {
    write_to("flops.md", part, text);
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

/// Whether page and figure are up to date.
pub fn agrees(counts: &str, svg: &str) -> bool {
    let page = std::fs::read_to_string(docs("flops.md")).unwrap();
    with(&page, COUNTS, counts) == page && std::fs::read_to_string(docs("figure-6-1.svg")).unwrap_or_default() == svg
}
