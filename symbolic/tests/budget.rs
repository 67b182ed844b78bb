//! What a document may cost in all: its summands share one budget, and whoever asks for one objective has one of his own.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "hostile/ending.rs"]
mod ending;

use isophote_symbolic::{LIMITS, Method, Model, ParameterId};

#[test]
fn all_that_is_derived_for_one_schedule_draws_on_one_budget() {
    let model = Model::from_toml(include_str!("../../models/thesis-spot.toml")).unwrap();
    let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    let derived = |model: &Model| model.objective(&all, Method::GaussNewton);
    let summand = model.summands().remove(0).model;
    let count = (0..1_000).take_while(|_| derived(&summand).is_ok()).count();
    assert!((8..1_000).contains(&count), "as many as a document has stages fit, not any number: {count}");
    let faults = derived(&summand).map(drop).unwrap_err();
    assert_eq!((faults.len(), faults[0].code.as_str(), faults[0].key.as_str()), (1, "limit", "model.intensity"));
    assert!(faults[0].message.contains(&LIMITS.work.to_string()), "{faults:?}");
    assert!(faults[0].help.is_some());
    // Others have not paid for that.
    assert!(derived(&model).is_ok() && derived(&model.summands()[0].model).is_ok());
    assert!(
        model
            .variant(isophote_symbolic::Variant {
                degree: 0,
                loss: model.loss(),
                saturated: model.saturated(),
                reach: 2.0
            })
            .value_objective(isophote_symbolic::ValueKind::Entry)
            .is_ok()
    );
}

#[test]
fn stages_alike_are_known_as_such() {
    let stage = |names: &str, method: &str| format!("[[stages]]\nparameters = [{names}]\nmethod = \"{method}\"\n");
    let stages = [
        stage("\"a\", \"b\"", "newton"),
        stage("\"b\", \"a\"", "newton"),
        stage("\"a\", \"b\"", "gauss-newton"),
        stage("\"a\", \"b\"", "newton"),
    ];
    let text = format!(
        "name = \"line\"\ncoordinates = [\"x\"]\nchannels = [\"y\"]\n[parameters]\na = {{ start = 1.0 }}\nb = {{ start = 1.0 }}\n\
         [model]\nintensity = \"a*x + b\"\n{}",
        stages.concat()
    );
    let model = Model::from_toml(&text).unwrap();
    assert_eq!((0..4).map(|stage| model.first_alike(stage)).collect::<Vec<_>>(), [0, 1, 2, 0]);
}

/// Every shipped model fits its budget, with all that a fit asks for.
#[test]
fn shipped_models_are_within_their_budget() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let model = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let derived = ending::derive(&model);
        assert!(derived.is_ok(), "{}: {derived:?}", path.display());
    }
}
