//! The loop bodies of the flops table compute the compiled derivatives: plain or optimised, separate or joint.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeSet;

use isophote_benches::bodies::body_flops;
use isophote_symbolic::interpreter::{Pixels, Slices, Window, run};
use isophote_symbolic::{Bindings, Lanes, Lowering, Method, Model, ParameterId, Part, Precision, Program, Sink, Value};
use isophote_tracker::{over_pixels_of, plain_program};

struct Picture;

impl Pixels for Picture {
    fn at(&self, _: usize, x: usize, y: usize) -> f64 {
        ((x * 7919 + y * 104_729) % 251) as f64
    }
}

fn model(name: &str) -> Model {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The outputs over 12 × 8 pixels, all of them in the domain.
fn outputs(model: &Model, program: &Program) -> Vec<f64> {
    let value = |name: &str| match name {
        "bx" => 5.3,
        "by" => 3.7,
        "a1" => 0.004,
        "a2" => 0.001,
        "a3" => 0.006,
        "v0" => 20.0,
        "v1" => 150.0,
        _ => -0.4,
    };
    let parameters: Vec<f64> = model.parameters().iter().map(|p| value(&p.name)).collect();
    let bindings = Bindings { parameters: &parameters, entry: &parameters, ..Bindings::default() };
    let window = Window { x: 0, y: 0, width: 12, height: 8, slices: Slices::ONE };
    let outcome = run(program, Precision::F64, Lanes::Two, &bindings, &Picture, window, None);
    assert_eq!(outcome.pixels, 96);
    outcome.outputs
}

fn all_agree(name: &str, subset: &str, method: Method) {
    let model = model(name);
    let subset: Vec<ParameterId> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
    let lowering = Lowering { fma: true, drop_saturated: false };
    let compiled = model.objective(&subset, method).unwrap().program(lowering).unwrap();
    let wanted = outputs(&model, &compiled).split_off(1);
    let close = |found: &[f64], part: Part| {
        let (gradient, hessian) = wanted.split_at(subset.len());
        let wanted = match part {
            Part::Gradient => gradient,
            Part::Hessian => hessian,
            Part::Both | Part::Diagonal => &wanted,
        };
        assert_eq!(found.len(), wanted.len(), "{name} {part:?}");
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * (1.0 + b.abs());
        assert!(found.iter().zip(wanted).all(near), "{name} {part:?}: {found:?} is not {wanted:?}");
    };
    for part in [Part::Gradient, Part::Hessian, Part::Both] {
        close(&outputs(&model, &plain_program(&model, &subset, method, part).unwrap()), part);
        let optimised = model.part_objective(&subset, method, part).unwrap().program(lowering).unwrap();
        close(&outputs(&model, &optimised).split_off(1), part);
    }
}

#[test]
fn every_body_sums_the_same_derivatives() {
    for subset in ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1", "bx,by,a1,a2,a3,k1,k2,v0,v1"] {
        all_agree("thesis-spot", subset, Method::Newton);
        all_agree("thesis-spot", subset, Method::GaussNewton);
    }
    all_agree("rational-spot", "bx,by,a1,a2,a3,v0,v1", Method::Newton);
    all_agree("gaussian", "bx,by,a1,a2,a3,v0,v1", Method::Newton);
}

#[test]
fn joint_and_optimised_bodies_cost_no_more() {
    let model = model("thesis-spot");
    for subset in ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1"] {
        let ids: Vec<ParameterId> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let flops = body_flops(&model, &ids, Method::Newton).unwrap();
        assert!(flops.joint_plain <= flops.separate_plain, "{subset}: {flops:?}");
        assert!(flops.joint_optimised <= flops.separate_optimised, "{subset}: {flops:?}");
        assert!(flops.separate_optimised <= flops.separate_plain, "{subset}: {flops:?}");
        assert!(flops.joint_optimised <= flops.joint_plain_hoisted, "{subset}: {flops:?}");
        assert!(flops.joint_plain_hoisted <= flops.joint_plain, "{subset}: {flops:?}");
    }
}

/// Flops of a sum and of everything it depends on.
fn alone(program: &Program, sum: Value) -> u32 {
    let (mut seen, mut stack) = (BTreeSet::new(), vec![sum]);
    while let Some(value) = stack.pop() {
        if seen.insert(value) {
            stack.extend(program.instruction(value).op.operands());
        }
    }
    1 + seen.iter().map(|value| program.instruction(*value).op.flops()).sum::<u32>()
}

/// Checks the statement of docs/flops.md about another reading of the thesis' "separate".
#[test]
fn one_loop_per_entry_exceeds_the_counts_of_the_thesis() {
    let model = model("thesis-spot");
    let each = |subset: &str| -> u32 {
        let ids: Vec<ParameterId> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let program = plain_program(&model, &ids, Method::Newton, Part::Both).unwrap();
        let Sink::Sums { accumulators, .. } = program.sink() else { panic!("sums") };
        accumulators.iter().map(|sum| alone(&program, *sum)).sum()
    };
    let subsets = ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1"];
    assert_eq!(subsets.map(each), [265, 452, 1111, 1555]);
}

#[test]
fn plain_programs_run_over_the_pixels_of_another() {
    let model = model("thesis-spot");
    let centre = [model.parameter("bx").unwrap(), model.parameter("by").unwrap()];
    let optimised = model.objective(&centre, Method::Newton).unwrap().program(Lowering::default()).unwrap();
    let plain = plain_program(&model, &centre, Method::Newton, Part::Both).unwrap();
    let over = over_pixels_of(&plain, &optimised).unwrap();
    // A small spot, so that most of the window is outside of the domain.
    let parameters = [5.3, 3.7, 0.1, 0.02, 0.15, -0.5, -0.3, 20.0, 150.0];
    let bindings = Bindings { parameters: &parameters, entry: &parameters, ..Bindings::default() };
    let window = Window { x: 0, y: 0, width: 12, height: 8, slices: Slices::ONE };
    let [all, some, ours] = [&plain, &over, &optimised]
        .map(|program| run(program, Precision::F64, Lanes::Two, &bindings, &Picture, window, None));
    assert!(all.pixels == 96 && some.pixels == ours.pixels && ours.pixels < 40, "{} {}", some.pixels, ours.pixels);
    for (a, b) in some.outputs.iter().zip(&ours.outputs[1..]) {
        assert!((a - b).abs() <= 1e-9 * a.abs(), "{a} {b}");
    }
    assert!(
        (all.outputs[0] - some.outputs[0]).abs() > 1e-3 * some.outputs[0].abs(),
        "the other pixels are not noticed"
    );
}
