//! Schedules to try: the document's own, joint ones by each method, and staged ones over subsets of the parameters.

use isophote_symbolic::{Method, Model, ParameterId, Stage};

/// Parameters that are fitted together.
#[derive(Clone, Debug, PartialEq)]
pub struct Subset {
    /// `centre`, `shape`, `illumination`, unions such as `centre+shape`, or `all`.
    pub name: String,
    /// In document order.
    pub parameters: Vec<ParameterId>,
}

/// A named list of stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// `document`, or its stages in words.
    pub name: String,
    /// The stages, in order.
    pub stages: Vec<Stage>,
}

/// Parts of the parameters by role; subsets are unions, as bits.
const PARTS: [&str; 3] = ["centre", "shape", "illumination"];
const CENTRE: u8 = 1;
const SHAPE: u8 = 2;
const LIGHT: u8 = 4;
/// Stages before the joint one: every union of the parts alone, and sequences of them.
const BEFORE: [&[u8]; 14] = [
    &[CENTRE],
    &[SHAPE],
    &[LIGHT],
    &[CENTRE | SHAPE],
    &[CENTRE | LIGHT],
    &[SHAPE | LIGHT],
    &[CENTRE | SHAPE | LIGHT],
    &[CENTRE, SHAPE],
    &[LIGHT, CENTRE],
    &[CENTRE, SHAPE | LIGHT],
    &[CENTRE | LIGHT, SHAPE],
    &[LIGHT, CENTRE | SHAPE],
    &[CENTRE, SHAPE, LIGHT],
    &[LIGHT, CENTRE, SHAPE],
];
/// Entries of [`BEFORE`] that are tried by Newton's method as well: the thesis' (section 4.2.5), and its prefixes.
const BY_NEWTON: [&[u8]; 3] = [&[CENTRE], &[CENTRE, SHAPE], &[CENTRE, SHAPE, LIGHT]];
/// Iterations and tolerance of all but the last stage: they need not reach the minimum.
const EARLY: (u32, f64) = (20, 0.1);
/// Iterations of the last stage.
const LAST_ITERATIONS: u32 = 50;

/// Subsets of the parameters that the document's stages free, by role; empty ones are left out, `all` comes last.
pub fn subsets(model: &Model) -> Vec<Subset> {
    let all = free(model);
    let mut subsets: Vec<Subset> = (0..PARTS.len()).map(|part| union(model, &all, 1 << part)).collect();
    subsets.retain(|subset| !subset.parameters.is_empty() && subset.parameters != all);
    subsets.push(Subset { name: "all".into(), parameters: all });
    subsets
}

/// Every schedule to try, the document's own first; no two have the same stages.
pub fn schedules(model: &Model) -> Vec<Schedule> {
    let all = free(model);
    let tolerance = model.stages().last().map_or(1e-3, |stage| stage.tolerance);
    let joint = |method| Stage { parameters: all.clone(), method, iterations: LAST_ITERATIONS, tolerance };
    let mut found = vec![Schedule { name: "document".into(), stages: model.stages().to_vec() }];
    let mut add = |name: String, stages: Vec<Stage>| {
        if found.iter().all(|schedule: &Schedule| schedule.stages != stages) {
            found.push(Schedule { name, stages });
        }
    };
    for method in [Method::LevenbergMarquardt, Method::GaussNewton, Method::Newton] {
        add(format!("all by {}", method.name()), vec![joint(method)]);
    }
    let staged = |before: &[u8], early: Method, last: Method| {
        let parts: Vec<Subset> = before.iter().map(|bits| union(model, &all, *bits)).collect();
        if parts.iter().any(|part| part.parameters.is_empty() || part.parameters == all) {
            return None;
        }
        let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
        let ways = if early == last { early.name().into() } else { format!("{}, {}", early.name(), last.name()) };
        let name = format!("{}, all by {ways}", names.join(", "));
        let (iterations, tolerance) = EARLY;
        let early = |part: Subset| Stage { parameters: part.parameters, method: early, iterations, tolerance };
        Some((name, parts.into_iter().map(early).chain([joint(last)]).collect()))
    };
    let damped = Method::LevenbergMarquardt;
    let plain = BEFORE.iter().map(|before| (*before, damped, damped));
    let newton = BY_NEWTON
        .iter()
        .flat_map(|before| [(*before, Method::Newton, damped), (*before, Method::Newton, Method::Newton)]);
    for (before, early, last) in plain.chain(newton) {
        if let Some((name, stages)) = staged(before, early, last) {
            add(name, stages);
        }
    }
    found
}

/// A Newton stage for each of [`subsets`], for [`super::Bench::convexity`].
pub fn newton_of_each(model: &Model) -> Vec<Stage> {
    let stage = |subset: Subset| Stage {
        parameters: subset.parameters,
        method: Method::Newton,
        iterations: LAST_ITERATIONS,
        tolerance: 1e-3,
    };
    subsets(model).into_iter().map(stage).collect()
}

/// Parameters that any stage of the document frees, in document order.
fn free(model: &Model) -> Vec<ParameterId> {
    let mut all: Vec<ParameterId> = model.stages().iter().flat_map(|stage| stage.parameters.iter().copied()).collect();
    all.sort_by_key(|parameter| parameter.index());
    all.dedup();
    all
}

fn union(model: &Model, all: &[ParameterId], bits: u8) -> Subset {
    let (mut names, mut wanted) = (Vec::new(), Vec::new());
    for (part, name) in PARTS.iter().enumerate().filter(|(part, _)| bits & 1 << part != 0) {
        let parameters = model.roles().iter().flat_map(|roles| match 1 << part {
            CENTRE => roles.centre.clone(),
            SHAPE => roles.shape.clone(),
            _ => roles.background.into_iter().chain(roles.brightness).collect(),
        });
        let free: Vec<ParameterId> = parameters.filter(|parameter| all.contains(parameter)).collect();
        if !free.is_empty() {
            names.push(*name);
            wanted.extend(free);
        }
    }
    let parameters = all.iter().copied().filter(|parameter| wanted.contains(parameter)).collect();
    Subset { name: names.join("+"), parameters }
}
