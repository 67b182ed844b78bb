//! `cargo bench -p isophote-benches --bench aot [-- compile]`: the JIT against ahead-of-time compilers on the same
//! frames in one run; the cost of a pixel by window and format; and compile times, or those alone. `UPDATE_EXPECT=1`
//! writes its parts of docs/speed.md and its figure. Needs `cc` and `rustc`.
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
    let is_update = std::env::var_os("UPDATE_EXPECT").is_some();
    let compiling = tables::compile(&compile_time::texts(), &compile_time::warm(), compile_time::cold());
    println!("{compiling}");
    if is_update {
        page::write_to("speed.md", "compile", &compiling);
    }
    if std::env::args().any(|argument| argument == "compile") {
        return;
    }
    let measured = tables::Measured {
        races: against::races(),
        thesis: against::thesis(),
        covered: windows::widths(Domain::Covering),
        ellipse: windows::widths(Domain::Inscribed),
        formats: windows::formats(),
    };
    let (text, svg) = (tables::text(&measured), tables::svg(&measured));
    println!("{text}");
    if is_update {
        page::write_to("speed.md", "speed", &text);
        page::write_svg("speed.svg", &svg);
    }
}
