//! `cargo bench -p isophote-benches --bench faint [-- FRAMES] [stars] [megapixel] [frames] [DOCUMENT …]`: detection of
//! stars of signal-to-noise ratio 8 in frames of 1024 × 1024 px, and false detections without stars (`stars`); and the
//! cost of a search: in such frames, empty or with a disc (`megapixel`); in smaller ones with other objects, and in
//! the dark (`frames`).
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::search::faint;

/// Documents that search for the stars.
const STARS: [&str; 3] = ["gaussian", "gaussian-pixel", "moffat"];
/// Documents of a target with a centre in one plane.
const CENTRED: [&str; 15] = [
    "spot",
    "spot-plane",
    "spot-lobe",
    "spot-motion",
    "spot-psf",
    "spot-quadratic",
    "rational-spot",
    "thesis-spot",
    "gaussian",
    "gaussian-pixel",
    "moffat",
    "ring",
    "laser-beam",
    "bright-disc",
    "dark-disc",
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let frames = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(100);
    let has = |word: &str| arguments.iter().any(|argument| argument == word);
    let parts = ["stars", "megapixel", "frames"].map(has);
    let [stars, megapixel, times] = if parts.contains(&true) { parts } else { [true; 3] };
    let some = CENTRED.into_iter().any(has);
    let wanted = |name: &&str| has(name) || !some;
    if stars {
        println!("| document | frame | frames | found | something else | ms |\n|---|---|---|---|---|---|");
        for name in STARS.into_iter().filter(wanted) {
            let compiled = faint::compiled(name);
            for (sigma, ratio) in [(1.1, 8.0), (2.5, 8.0), (1.1, 0.0)] {
                let row = faint::measure(&compiled, &format!("{name} {sigma}"), frames, sigma, ratio);
                let frame = if ratio > 0.0 { format!("σ {sigma} px, SNR {ratio}") } else { "no star".into() };
                let [right, wrong] = [row.right, row.wrong].map(|count| 100.0 * count as f64 / row.frames as f64);
                println!("| `{name}` | {frame} | {frames} | {right:.1} % | {wrong:.1} % | {:.1} |", row.median_ms);
            }
        }
    }
    let format_times = |[median, most]: [f64; 2]| format!("{median:.0} ({most:.0})");
    if megapixel {
        println!("\n| document | 1024 × 1024 px, nothing | a disc of 24 × 16 px |\n|---|---|---|");
        for name in CENTRED.into_iter().filter(wanted) {
            let height = if name == "dark-disc" { -80.0 } else { 80.0 };
            let times = faint::megapixel_ms(&faint::compiled(name), (frames / 10).max(3), height).map(format_times);
            println!("| `{name}` | {} |", times.join(" | "));
        }
    }
    if times {
        println!("\n| document | 640 × 480 px, alone | ten others | ten others, no target | after it went dark |");
        println!("|---|---|---|---|---|");
        for name in ["spot", "gaussian", "ring", "laser-beam", "moffat", "bright-disc"].into_iter().filter(wanted) {
            let compiled = faint::compiled(name);
            let times = faint::times_ms(&compiled, (frames / 10).max(3)).map(format_times);
            println!("| `{name}` | {} | {} |", times.join(" | "), format_times(faint::blackout_ms(&compiled, frames)));
        }
    }
}
