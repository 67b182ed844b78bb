//! The tables of docs/pose-accuracy.md.

use super::cell::{Found, METHODS};

/// Errors by method and cell.
pub fn errors(all: &[Found]) -> String {
    let mut text = format!(
        "| xy mm / z mm / rotation ° | {} |\n|---|",
        all.iter().map(|f| f.cell.name).collect::<Vec<_>>().join(" | ")
    );
    text += &"---|".repeat(all.len());
    let mut row = |name: &str, cell: &dyn Fn(&Found) -> String| {
        text += &format!("\n| {name} | {} |", all.iter().map(cell).collect::<Vec<_>>().join(" | "));
    };
    let bound = |f: &Found, k: usize| format!("{:.3} / {:.3} / {:.3}", f.bounds[k][0], f.bounds[k][1], f.bounds[k][2]);
    row("**bound (CRLB)**, flat", &|f| bound(f, 0));
    row("**bound (CRLB)**, raised by 40 mm", &|f| bound(f, 1));
    for (method, name) in METHODS.iter().enumerate() {
        row(name, &|f| f.methods[method].text());
    }
    text
}

/// Consistency of the covariance, and times.
pub fn consistency(all: &[Found]) -> String {
    let mut text = String::from(
        "| cell | frames | joint: NEES, inside 95 % | direct: NEES, inside 95 % | raised: NEES, inside 95 % | next frame, three spots | next frame, one spot |\n|---|---|---|---|---|---|---|",
    );
    for found in all {
        let shown = |method: usize| {
            found.methods[method]
                .consistency()
                .map_or("–".into(), |(nees, inside)| format!("{nees:.2}, {inside:.1} %"))
        };
        let time = |method: usize| {
            let mut times = found.methods[method].times_us.clone();
            times.sort_by(f64::total_cmp);
            times.get(times.len() / 2).map_or("–".into(), |us| format!("{:.2} ms", us / 1000.0))
        };
        text += &format!(
            "\n| {} | {} | {} | {} | {} | {} | {} |",
            found.cell.name,
            found.frames,
            shown(4),
            shown(5),
            shown(6),
            time(5),
            time(7)
        );
    }
    text
}

/// Wrong branches over all cells: three spots, a raised one, a single spot.
pub fn branches(all: &[Found]) -> String {
    let sum = |method: usize| {
        let wrong: usize = all.iter().map(|f| f.methods[method].wrong).sum();
        let frames: usize = all.iter().map(|f| f.methods[method].frames).sum();
        let lost: usize = all.iter().map(|f| f.methods[method].frames - f.methods[method].answers).sum();
        format!("{wrong} wrong and {lost} lost of {frames}")
    };
    format!("Branches, all cells, cold starts: three spots {}; raised {}; one spot {}.", sum(5), sum(6), sum(7))
}
