//! `cargo bench -p isophote-benches --bench colour`: the brightness of a red spot under saturation, unmixed channels
//! against raw ones. Frames are the same in every run; `UPDATE_EXPECT=1` writes the table of docs/colour.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::colour;
use isophote_benches::page;

/// Frames of a row.
const FRAMES: usize = 1000;

fn main() {
    let text = colour::table(&colour::measure(FRAMES), FRAMES);
    println!("{text}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("colour.md", "colour", &text);
    }
}
