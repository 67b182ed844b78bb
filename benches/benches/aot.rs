//! `cargo bench -p isophote-benches --bench aot`: the compiler in the process against compilers ahead of time, on the same
//! frames in one run; what a pixel costs by window and format; and how long it takes to compile. With `UPDATE_EXPECT=1` it
//! writes docs/speed.md and its figure. It needs `cc` and `rustc`.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::page;
use isophote_benches::speed::{
    against, compile_time, tables,
    windows::{self, Domain},
};

fn main() {
    if std::env::args().any(|argument| argument == compile_time::COLD) {
        println!("{}", compile_time::cold_here());
        return;
    }
    let measured = tables::Measured {
        races: against::races(),
        thesis: against::thesis(),
        covered: windows::widths(Domain::Covering),
        ellipse: windows::widths(Domain::Inscribed),
        formats: windows::formats(),
        warm: compile_time::warm(),
        cold: compile_time::cold(),
    };
    let (text, svg) = (tables::text(&measured), tables::svg(&measured));
    println!("{text}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write_to("speed.md", "speed", &text);
        page::write_svg("speed.svg", &svg);
    }
}
