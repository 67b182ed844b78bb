//! Flops per pixel as Markdown tables: the thesis' Table 6.1, this project's goals, and all shipped models.
//!
//! Operations are counted in the programs, not measured, so the tables are the same on every machine.

use isophote_symbolic::{Form, Lowering, Method, Model, ParameterId};

use crate::bodies::{BodyFlops, body_flops};
use crate::{shipped, text};

/// One row of the thesis' Table 6.1.
pub struct Row {
    /// The thesis' name of the subset.
    pub name: &'static str,
    /// Isophote's names of its parameters.
    subset: &'static str,
    /// Maple 9: separate, separate with tryhard, joint, joint with tryhard.
    pub maple: [u32; 4],
}

/// Thesis, Table 6.1.
pub const TABLE_6_1: [Row; 4] = [
    Row { name: "b", subset: "bx,by", maple: [152, 97, 112, 78] },
    Row { name: "a", subset: "a1,a2,a3", maple: [176, 117, 135, 88] },
    Row { name: "a, b", subset: "bx,by,a1,a2,a3", maple: [396, 220, 325, 205] },
    Row { name: "a, b, v", subset: "bx,by,a1,a2,a3,v0,v1", maple: [461, 284, 394, 230] },
];

/// For each row of Table 6.1 and all nine parameters: goal of flops, stretch goal, maximum of accumulators.
const GOALS: [(u32, Option<u32>, u32); 5] =
    [(31, Some(27), 5), (39, Some(33), 8), (39, Some(33), 8), (56, Some(50), 18), (100, None, 33)];

/// Flops per pixel of the code printed in the thesis for the rational spot's a1, a2, a3 (appendix A.1), accumulation
/// included.
const APPENDIX_A1: u32 = 134;

const LOWERING: Lowering = Lowering { fma: true, drop_saturated: false };

fn model(name: &str) -> Model {
    Model::from_toml(&text(name)).unwrap()
}

fn subset(model: &Model, names: &str) -> Vec<ParameterId> {
    names.split(',').map(|name| model.parameter(name).unwrap()).collect()
}

impl Row {
    /// Isophote's counts, in five forms.
    pub fn ours(&self, thesis_spot: &Model) -> BodyFlops {
        body_flops(thesis_spot, &subset(thesis_spot, self.subset), Method::Newton).unwrap()
    }
}

/// Isophote's counts in the order of [`Row::maple`].
pub fn in_columns(ours: &BodyFlops) -> [u32; 4] {
    [ours.separate_plain, ours.separate_optimised, ours.joint_plain, ours.joint_optimised]
}

/// The rows of Table 6.1 with Isophote's counts.
pub fn rows() -> Vec<(&'static Row, BodyFlops)> {
    let thesis_spot = model("thesis-spot");
    TABLE_6_1.iter().map(|row| (row, row.ours(&thesis_spot))).collect()
}

/// All tables of docs/flops.md.
pub fn tables(rows: &[(&Row, BodyFlops)]) -> String {
    [table_6_1(rows), goals(), appendix(), models()].join("\n")
}

fn table_6_1(rows: &[(&Row, BodyFlops)]) -> String {
    let mut table = String::from(
        "## Table 6.1\n\nEach cell: Maple 9 / isophote.\n\n\
         | subset | separate | separate, optimised | joint | joint, optimised | joint, plain, what can leave the loop moved out |\n\
         |---|---|---|---|---|---|\n",
    );
    for (row, ours) in rows {
        let cells: Vec<String> =
            row.maple.iter().zip(in_columns(ours)).map(|(maple, ours)| format!("{maple} / **{ours}**")).collect();
        table += &format!("| {} | {} | – / {} |\n", row.name, cells.join(" | "), ours.joint_plain_hoisted);
    }
    table
}

fn goals() -> String {
    let thesis_spot = model("thesis-spot");
    let mut table = String::from(
        "## Against the goals\n\n`thesis-spot`, Newton, joint and optimised: what is compiled.\n\n\
         | subset | Maple, joint, tryhard | to reach | hoped for | isophote | accumulators | at most |\n\
         |---|---|---|---|---|---|---|\n",
    );
    let all = Row { name: "a, b, v, k", subset: "bx,by,a1,a2,a3,k1,k2,v0,v1", maple: [0; 4] };
    for (row, (reach, hope, most)) in TABLE_6_1.iter().chain([&all]).zip(GOALS) {
        let ids = subset(&thesis_spot, row.subset);
        let cost = thesis_spot.objective(&ids, Method::Newton).unwrap().cost(LOWERING).unwrap();
        let maple = if row.maple[3] == 0 { "–".into() } else { row.maple[3].to_string() };
        let hope = hope.map_or("–".into(), |hope| hope.to_string());
        table += &format!(
            "| {} | {maple} | {reach} | {hope} | **{}** | {} | {most} |\n",
            row.name, cost.flops_per_pixel, cost.accumulators
        );
    }
    table
}

fn appendix() -> String {
    let rational = cell(&model("rational-spot"), "a1,a2,a3");
    let gaussian = cell(&model("gaussian"), "bx,by,a1,a2,a3,v0,v1");
    format!(
        "## Other profiles\n\n\
         | model | subset | the thesis' code | isophote: flops, accumulators, calls |\n|---|---|---|---|\n\
         | rational-spot (appendix A.1) | a | {APPENDIX_A1} | {rational} |\n\
         | gaussian | a, b, v | – | {gaussian} |\n"
    )
}

fn cell(model: &Model, names: &str) -> String {
    counts(model, &subset(model, names), Method::Newton)
}

/// `36, 8, 1 exp`, with the form named unless it is the shortest one.
fn counts(model: &Model, subset: &[ParameterId], method: Method) -> String {
    let Ok(objective) = model.objective(subset, method) else { return "past a limit".into() };
    let Ok(cost) = objective.cost(LOWERING) else { return "past a limit".into() };
    let calls: Vec<String> = cost.calls.iter().map(|(name, count)| format!("{count} {name}")).collect();
    let calls = if calls.is_empty() { "–".into() } else { calls.join(" ") };
    let form = match objective.proof().map(|proof| proof.form) {
        None | Some(Form::Factored) => String::new(),
        Some(form) => format!(" ({form:?})").to_lowercase(),
    };
    format!("{}, {}, {calls}{form}", cost.flops_per_pixel, cost.accumulators)
}

fn models() -> String {
    let mut table = String::from(
        "## All shipped models\n\n\
         Flops, accumulators, calls of elementary functions, per pixel. *plain* and *unfactored*: a longer form is compiled, \
         because the shortest one rounds worse in f32 than is allowed.\n\n\
         | model | parameters | Newton | Gauss–Newton |\n|---|---|---|---|\n",
    );
    for name in shipped() {
        let model = model(&name);
        let of = |pick: fn(&isophote_symbolic::Roles) -> &Vec<ParameterId>| -> Vec<ParameterId> {
            model.roles().iter().flat_map(|roles| pick(roles).iter().copied()).collect()
        };
        let all = (0..model.parameters().len() as u32).map(ParameterId).collect();
        for (what, ids) in [("centre", of(|r| &r.centre)), ("shape", of(|r| &r.shape)), ("all", all)] {
            if !ids.is_empty() {
                let [newton, gauss] = [Method::Newton, Method::GaussNewton].map(|method| counts(&model, &ids, method));
                table += &format!("| {name} | {what}, {} | {newton} | {gauss} |\n", ids.len());
            }
        }
    }
    table
}
