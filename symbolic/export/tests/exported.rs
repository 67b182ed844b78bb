//! Compares the exported source of the thesis' spot with stored files.
//! `UPDATE_EXPECT=1 cargo test -p isophote-export --test exported` rewrites them.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../../tests/common/mod.rs"]
mod common;

use std::path::Path;

use common::expect;
use isophote_export::{ExportError, ExportOptions, Language, export};
use isophote_symbolic::{Lowering, Method, Model, Precision};

fn spot() -> Model {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/thesis-spot.toml");
    Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn text(model: &Model, options: &ExportOptions) -> Result<String, ExportError> {
    let centre = [model.parameter("bx").unwrap(), model.parameter("by").unwrap()];
    let program = model.objective(&centre, Method::Newton).unwrap().program(Lowering::default()).unwrap();
    export(model, &program, options)
}

#[test]
fn exported_thesis_spot_matches_stored_files() {
    let model = spot();
    for (language, name) in [(Language::C, "thesis-spot.c"), (Language::Rust, "thesis-spot.rs")] {
        let text = text(&model, &ExportOptions::new(language, 1)).unwrap();
        let expected = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/exported").join(name);
        expect(&expected, &text);
    }
}

#[test]
fn unsupported_options_are_refused() {
    let model = spot();
    let c = ExportOptions::new(Language::C, 1);
    let refused = |options: ExportOptions| text(&model, &options).unwrap_err();
    let channels = refused(ExportOptions::new(Language::C, 2));
    assert_eq!(channels, ExportError::Channels { channels: 1, given: 2 });
    assert_eq!(refused(ExportOptions { name: Some("a b".into()), ..c.clone() }), ExportError::Name("a b".into()));
    for (language, precision, lanes) in
        [(Language::C, Precision::F32, 4), (Language::Rust, Precision::F64, 4), (Language::Rust, Precision::F32, 3)]
    {
        let options = ExportOptions { language, precision, lanes, ..c.clone() };
        assert_eq!(refused(options), ExportError::Lanes { lanes, precision, language });
    }
}

#[test]
fn reserved_names_of_a_document_get_a_suffix() {
    let document = r#"
name = "words"
description = "ends */ here"
coordinates = ["i", "row"]
channels = ["double"]
[parameters]
fn = { start = 1.0 }
t1 = { start = 1.0, unit = "*/" }
sums = { start = 1.0 }
window = { start = 1.0 }
[model]
intensity = "fn + t1*i + sums*row + window*i*row"
"#;
    let model = Model::from_toml(document).unwrap();
    let all: Vec<_> = model.stages()[0].parameters.clone();
    let program = model.objective(&all, Method::Newton).unwrap().program(Lowering::default()).unwrap();
    let c = export(&model, &program, &ExportOptions::new(Language::C, 1)).unwrap();
    assert_eq!(c.matches("ends * / here").count(), 1);
    for word in ["const double fn_ =", "const double sums_ =", "const double t1_ =", "const float double_ ="] {
        assert!(c.contains(word), "{word} is not in\n{c}");
    }
}
