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
        ("bx,by", 28, 5, 78),
        ("a1,a2,a3", 34, 8, 88),
        ("bx,by,a1,a2,a3", 34, 8, 205),
        ("bx,by,a1,a2,a3,v0,v1", 52, 18, 230),
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

/// The thesis' spot in other words: definitions, intensity.
const SPELLINGS: [(&str, &str); 7] = [
    ("s = \"a1*(x-bx)^2 + 2*a2*(x-bx)*(y-by) + a3*(y-by)^2\"", "v0 + v1*(1 + s*(k1 + s*(k2 - s*(1 + k1 + k2))))"),
    (
        "dx = \"x - bx\"\ndy = \"y - by\"\ns = \"dx*(a1*dx + a2*dy) + dy*(a2*dx + a3*dy)\"\nq = \"s*s\"\nk3 = \"-1 - k1 - k2\"",
        "v0 + v1 + v1*k1*s + v1*k2*q + v1*k3*q*s",
    ),
    ("s = \"a1*(bx-x)^2 + 2*a2*(bx-x)*(by-y) + a3*(by-y)^2\"", "(v0 + v1) - v1*(s^3 - k1*(s - s^3) - k2*(s^2 - s^3))"),
    ("s = \"a1*(x-bx)^2 + 2*a2*(x-bx)*(y-by) + a3*(y-by)^2\"", "v0 + v1*(1 - s)*(1 + (1 + k1)*s + (1 + k1 + k2)*s^2)"),
    (
        "X = \"[x - bx, y - by]\"\ns = \"X' * [[a1, a2], [a2, a3]] * X\"\nk = \"[1, k1, k2, -(1 + k1 + k2)]\"",
        "v0 + sum(v1*k[i]*s^i, i, 0, 3)",
    ),
    (
        "\"p(t)\" = \"1 + k1*t + k2*t^2 - (1 + k1 + k2)*t^3\"\n\"d(u, v)\" = \"a1*u^2 + 2*a2*u*v + a3*v^2\"\ns = \"d(x - bx, y - by)\"",
        "v0 + v1*p(s)",
    ),
    ("s = \"a1*(x-bx)^2 + 2*a2*(x-bx)*(y-by) + a3*(y-by)^2\"", "v0 - v1*(-1 - k1*s - k2*s^2 + (1 + k1 + k2)*s^3)"),
];

#[test]
fn how_a_model_is_spelled_does_not_matter() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/thesis-spot.toml")).unwrap();
    let (head, rest) = text.split_once("[definitions]").unwrap();
    let (_, stages) = rest.split_once("[[stages]]").unwrap();
    let subsets = ["bx,by", "a1,a2,a3", "bx,by,a1,a2,a3", "bx,by,a1,a2,a3,v0,v1", "bx,by,a1,a2,a3,k1,k2,v0,v1"];
    let thesis = Model::from_toml(&text).unwrap();
    for (definitions, intensity) in SPELLINGS {
        let text = format!(
            "{head}[definitions]\n{definitions}\n[model]\nintensity = \"{intensity}\"\ndomain = \"s <= 1\"\n[[stages]]{stages}"
        );
        let model = Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}", faults[0].render("spelling")));
        for subset in subsets {
            assert_eq!(cost(&model, subset, true), cost(&thesis, subset, true), "{intensity}: {subset}");
        }
    }
}
