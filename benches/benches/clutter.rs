//! `cargo bench -p isophote-benches --bench clutter [-- FRAMES [FIRST]]`: what is taken for a target in frames full of squares, bars,
//! rings, triangles, texture and 1/f noise, sharp and blurred, and how many targets among them are found, with the shipped
//! documents and default options. FIRST is the first seed. With `UPDATE_EXPECT=1` it writes its part of docs/confidence.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::clutter;
use isophote_benches::page;

fn main() {
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let (frames, first) = (numbers.next().unwrap_or(1000), numbers.next().unwrap_or(0));
    let mut text = clutter::HEAD.to_string();
    print!("{text}");
    for document in clutter::DOCUMENTS {
        for line in clutter::lines(document, frames, first as u64) {
            print!("{line}");
            text += &line;
        }
    }
    let command = if first == 0 { format!("clutter -- {frames}") } else { format!("clutter -- {frames} {first}") };
    text += &format!("\n{}", page::provenance(&command, &["tracker", "symbolic", "jit", "models", "benches"]));
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("confidence.md", "clutter", &text);
    }
}
