//! `cargo bench -p isophote-benches --bench clutter [-- FRAMES]`: what is taken for a target in frames full of squares, bars,
//! rings, triangles, texture and 1/f noise, sharp and blurred, and how many targets among them are found, with the shipped
//! documents and default options. With `UPDATE_EXPECT=1` it writes its part of docs/confidence.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::clutter;
use isophote_benches::page;

fn main() {
    let frames = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(1000);
    let mut text = clutter::HEAD.to_string();
    print!("{text}");
    for document in clutter::DOCUMENTS {
        for line in clutter::lines(document, frames) {
            print!("{line}");
            text += &line;
        }
    }
    text += &format!(
        "\n{}",
        page::provenance(&format!("clutter -- {frames}"), &["tracker", "symbolic", "jit", "models", "benches"])
    );
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "clutter", &text);
    }
}
