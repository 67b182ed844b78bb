//! What a user is shown of documents with many faults: each document of tests/diagnostics/ and beside it, as text, all that
//! is told of it. `UPDATE_EXPECT=1 cargo test -p isophote-symbolic --test diagnostics` writes the texts anew.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeSet;
use std::path::Path;

use isophote_symbolic::{Diagnostics, Model};

fn shown(faults: &Diagnostics, name: &str) -> String {
    faults.iter().map(|d| d.render(name) + "\n").collect()
}

#[test]
fn documents_with_many_faults() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/diagnostics");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "toml"));
    paths.sort();
    assert!(paths.len() >= 3, "{paths:?}");
    for path in paths {
        let faults = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap_err();
        let text = shown(&faults, &path.file_name().unwrap().to_string_lossy());
        let expected = path.with_extension("txt");
        if std::env::var_os("UPDATE_EXPECT").is_some() {
            std::fs::write(&expected, &text).unwrap();
        }
        let old = std::fs::read_to_string(&expected).unwrap_or_default();
        assert!(old == text, "{} differs; UPDATE_EXPECT=1 writes it anew\n{text}", expected.display());
    }
}

/// At least a dozen kinds of faults in one go, in the order of the document, none twice.
#[test]
fn all_kinds_in_one_go() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/diagnostics/many-faults.toml");
    let faults = Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap_err();
    let codes: BTreeSet<&str> = faults.iter().map(|d| d.code.as_str()).collect();
    assert!(codes.len() >= 12, "{codes:?}");
    assert!(faults.windows(2).all(|pair| pair[0].span <= pair[1].span));
    let distinct: BTreeSet<_> = faults.iter().map(|d| (d.span, &d.code, &d.message)).collect();
    assert_eq!(distinct.len(), faults.len());
}
