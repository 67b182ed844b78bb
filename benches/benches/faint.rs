//! `cargo bench -p isophote-benches --bench faint [-- FRAMES]`: stars of signal-to-noise ratio 8 in frames of 1024 × 1024 px,
//! frames without any, and what a search costs: in those, in frames with ten other things, and in the dark.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::search::faint;

fn main() {
    let frames = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(100);
    println!("| document | frame | frames | found | something else | ms |\n|---|---|---|---|---|---|");
    for name in ["gaussian", "moffat"] {
        let compiled = faint::compiled(name);
        for (sigma, ratio) in [(1.1, 8.0), (2.5, 8.0), (1.1, 0.0)] {
            let row = faint::measure(&compiled, &format!("{name} {sigma}"), frames, sigma, ratio);
            let frame = if ratio > 0.0 { format!("σ {sigma} px, SNR {ratio}") } else { "no star".into() };
            let [right, wrong] = [row.right, row.wrong].map(|count| 100.0 * count as f64 / row.frames as f64);
            println!("| `{name}` | {frame} | {frames} | {right:.1} % | {wrong:.1} % | {:.1} |", row.median_ms);
        }
    }
    println!(
        "\n| document | 640 × 480 px, alone | ten others | ten others, no target | after it went dark |\n|---|---|---|---|---|"
    );
    for name in ["spot", "gaussian", "ring", "laser-beam", "moffat", "bright-disc"] {
        let compiled = faint::compiled(name);
        let times =
            faint::times_ms(&compiled, (frames / 10).max(3)).map(|[median, most]| format!("{median:.1} ({most:.0})"));
        let [dark, most] = faint::blackout_ms(&compiled, frames);
        println!("| `{name}` | {} | {dark:.1} ({most:.0}) |", times.join(" | "));
    }
}
