//! Programs kept as text: a change of the optimiser shows as a change of these files. Those of the shipped models are
//! in `golden/`; in `lowered/` each program stands beside a document that shows one rewrite of docs/derivation.md.
//! `UPDATE_EXPECT=1 cargo test -p isophote-symbolic --test golden` writes them anew.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::expect;
use isophote_symbolic::{Lowering, Model};

/// The documents of a folder, in name order.
fn documents(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    paths
}

/// The programs of a document's stages.
fn programs(document: &Path, lowering: Lowering) -> String {
    let text = std::fs::read_to_string(document).unwrap();
    let model = Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}", faults[0].render("document")));
    let mut text = String::new();
    for stage in model.stages() {
        let objective = model.objective(&stage.parameters, stage.method).unwrap();
        let names: Vec<_> = stage.parameters.iter().map(|p| model.parameters()[p.index()].name.as_str()).collect();
        let cost = objective.cost(lowering).unwrap();
        text += &format!("# {} {}\n# {cost:?}\n", stage.method.name(), names.join(","));
        text += &objective.program(lowering).unwrap().to_string();
    }
    text
}

#[test]
fn programs_of_the_shipped_models() {
    let documents = documents("../models");
    assert!(documents.len() >= 6, "{documents:?}");
    for path in documents {
        let expected = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(path.file_stem().unwrap());
        expect(&expected.with_extension("txt"), &programs(&path, Lowering { fma: true, drop_saturated: true }));
    }
}

#[test]
fn programs_beside_their_documents() {
    let documents = documents("tests/lowered");
    assert_eq!(documents.len(), 18, "{documents:?}");
    for path in documents {
        expect(&path.with_extension("txt"), &programs(&path, Lowering { fma: true, drop_saturated: false }));
    }
}
