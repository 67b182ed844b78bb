//! What the pixel loop of the thesis' model costs (flops by the project's convention, F excluded), against the thesis'
//! best figures (Maple, joint, tryhard) and this build's goals.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::{Lowering, Method, Model};

fn cost(model: &Model, subset: &str, fma: bool) -> (u32, u32) {
    let subset: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
    let objective = model.objective(&subset, Method::Newton).unwrap();
    let cost = objective.cost(Lowering { fma, drop_saturated: false }).unwrap();
    (cost.flops_per_pixel, cost.accumulators)
}

#[test]
fn newton_sums_of_the_thesis_spot() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/thesis-spot.toml")).unwrap();
    let model = Model::from_toml(&text).unwrap();
    // subset, flops at most, accumulators at most, Maple's flops
    let table = [
        ("bx,by", 30, 5, 78),
        ("a1,a2,a3", 36, 8, 88),
        ("bx,by,a1,a2,a3", 36, 8, 205),
        ("bx,by,a1,a2,a3,v0,v1", 54, 18, 230),
        ("bx,by,a1,a2,a3,k1,k2,v0,v1", 100, 33, u32::MAX),
    ];
    for (subset, flops, accumulators, maple) in table {
        let found = cost(&model, subset, true);
        assert!(found.0 <= flops && found.1 <= accumulators, "{subset}: {found:?}, at most ({flops}, {accumulators})");
        assert!(found.0 < maple);
        assert_eq!(found, cost(&model, subset, false), "{subset}: contraction changes instructions, not flops");
    }
}

#[test]
fn saturation_control_and_bounds_cost_no_flops_per_pixel() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/thesis-spot.toml")).unwrap();
    let model = Model::from_toml(&text).unwrap();
    let subset = [model.parameter("bx").unwrap(), model.parameter("by").unwrap()];
    let objective = model.objective(&subset, Method::Newton).unwrap();
    let at = |drop_saturated| objective.cost(Lowering { fma: true, drop_saturated }).unwrap().flops_per_pixel;
    assert_eq!(at(false), at(true));
    let program = objective.program(Lowering { fma: true, drop_saturated: true }).unwrap();
    assert!(program.pixel_set().bounds.is_some() && program.pixel_set().mask.is_none(), "{program}");
    assert!(program.pixel_set().saturated.is_some());
}
