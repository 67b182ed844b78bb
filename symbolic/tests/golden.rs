//! The programs of the shipped models, kept as text: a change of the optimiser shows as a change of these files.
//! `UPDATE_EXPECT=1 cargo test -p isophote-symbolic --test golden` writes them anew.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;

use common::expect;
use isophote_symbolic::{Lowering, Model};

#[test]
fn programs_of_the_shipped_models() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths: Vec<_> = std::fs::read_dir(root.join("../models")).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 6, "{paths:?}");
    for path in paths {
        let model = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let mut text = String::new();
        for stage in model.stages() {
            let objective = model.objective(&stage.parameters, stage.method).unwrap();
            let names: Vec<_> = stage.parameters.iter().map(|p| model.parameters()[p.index()].name.as_str()).collect();
            let lowering = Lowering { fma: true, drop_saturated: true };
            let cost = objective.cost(lowering).unwrap();
            text += &format!("# {} {}\n# {cost:?}\n", stage.method.name(), names.join(","));
            text += &objective.program(lowering).unwrap().to_string();
        }
        let expected = root.join("tests/golden").join(path.file_stem().unwrap()).with_extension("txt");
        expect(&expected, &text);
    }
}
