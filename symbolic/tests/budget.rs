//! What a document may cost in all: its summands share one budget, and whoever asks for one objective has one of his own.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "hostile/ending.rs"]
mod ending;

use isophote_symbolic::{LIMITS, Method, Model, ParameterId, Summand};

#[test]
fn all_that_is_derived_for_one_schedule_draws_on_one_budget() {
    let model = Model::from_toml(include_str!("../../models/thesis-spot.toml")).unwrap();
    let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    let derived = |summand: &Summand| summand.objective(&all, Method::GaussNewton);
    let summand = model.summands().remove(0);
    let count = (0..1_000).take_while(|_| derived(&summand).is_ok()).count();
    assert!((8..1_000).contains(&count), "as many as a document has stages fit, not any number: {count}");
    let faults = derived(&summand).map(drop).unwrap_err();
    assert_eq!((faults.len(), faults[0].code.as_str(), faults[0].key.as_str()), (1, "limit", "model.intensity"));
    assert!(faults[0].message.contains(&LIMITS.work.to_string()), "{faults:?}");
    assert!(faults[0].help.is_some());
    // Others have not paid for that.
    assert!(model.objective(&all, Method::GaussNewton).is_ok() && derived(&model.summands()[0]).is_ok());
    assert!(model.with_background(0, 2.0).0.value_objective(isophote_symbolic::ValueKind::Entry).is_ok());
}

/// What others do at the same time is not charged to whoever does not do it.
#[test]
fn who_derives_beside_others_pays_for_himself_alone() {
    let model = Model::from_toml(include_str!("../../models/thesis-spot.toml")).unwrap();
    let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    let count = |threads: usize| -> usize {
        let summand = model.summands().remove(0);
        let derived = || (0..1_000).take_while(|_| summand.objective(&all, Method::GaussNewton).is_ok()).count();
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..threads).map(|_| scope.spawn(derived)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        })
    };
    let (alone, together) = (count(1), count(4));
    // The last one of each is cut short.
    assert!(together + 4 >= alone, "{together} fit when four threads derive them, {alone} when one does");
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
