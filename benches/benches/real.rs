//! `cargo bench -p isophote-benches --bench real`: photographs, beside the repository or in ISOPHOTE_REAL; a missing
//! set is skipped with a message. With all present, `UPDATE_EXPECT=1` writes docs/real.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use isophote_benches::accuracy::real::{beam, board, frames};
use isophote_benches::page;

/// Measures one set of photographs.
type Table = fn() -> String;

fn main() {
    let sets: [(&str, &str, Table); 3] = [
        ("visp-mire2", "## A moving box", board::table),
        ("laser", "## Laser beams, clipped", beam::clipped),
        ("laser", "## Laser beams along their way", beam::caustic),
    ];
    let mut parts = vec![page::provenance("real", &["tracker", "jit", "symbolic", "benches/src", "models"])];
    for (folder, title, table) in sets {
        if frames::folder(folder).is_none() {
            println!("{title}: no photographs in {folder}, skipped");
            continue;
        }
        parts.push(format!("{title}\n\n{}", table()));
    }
    println!("{}", parts.join("\n\n"));
    if std::env::var_os("UPDATE_EXPECT").is_some() && parts.len() > sets.len() {
        page::write_to("real.md", "real", &parts.join("\n\n"));
    }
}
