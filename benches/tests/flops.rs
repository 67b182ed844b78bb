//! docs/flops.md and its figure agree with counts from the programs. `UPDATE_EXPECT=1 cargo test -p isophote-benches
//! --test flops` rewrites them, `cargo bench` with the same also the times.

use isophote_benches::flops::{counts, page};

#[test]
fn page_counts_match_the_programs() {
    let rows = counts::rows();
    let (tables, svg) = (counts::tables(&rows), page::figure(&rows));
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        page::write(page::COUNTS, &tables);
        page::write_figure(&svg);
    }
    assert!(
        page::agrees(&tables, &svg),
        "docs/flops.md differs; UPDATE_EXPECT=1 cargo test -p isophote-benches --test flops writes it anew\n{tables}"
    );
    assert!(!page::agrees(&tables.replacen("**", "**1", 1), &svg), "a planted digit is not noticed");
    assert!(!page::agrees(&tables, &svg.replacen("152", "153", 1)), "a planted bar is not noticed");
}
