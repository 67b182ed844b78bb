//! `cargo bench -p isophote-benches --bench search [-- FRAMES]`: cold starts in seeded frames of 640 × 480 px, with
//! the target alone and among ten other objects: rates of correct and false detections, and times. `UPDATE_EXPECT=1`
//! writes its part of docs/confidence.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::search;
use isophote_benches::accuracy::search::scene::height;
use isophote_benches::page;

fn main() {
    let frames = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(1000);
    let compiled = search::compiled();
    let followed = [("S0", 0.0), ("S30", 0.3)].map(|(name, share)| {
        let [median, least, most] = search::tracked_us(&compiled, height(share));
        format!("{name} {median:.0} µs ({least:.0}–{most:.0})")
    });
    let rows = search::rows(&compiled, frames);
    let mut text = search::table(&rows);
    text +=
        &format!("\nA frame in which the target is followed takes, median (least–most): {}.\n\n", followed.join(", "));
    text += &page::provenance(&format!("search -- {frames}"), &["tracker", "symbolic", "jit", "models", "benches"]);
    println!("{text}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "search", &text);
    }
}
