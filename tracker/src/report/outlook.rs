//! The expected quality of a model before any frame: whether its parameters can be told apart, their deviations, and
//! the best exposure.
//!
//! All of it is computed at synthetic points (see [`super::points`]), so a refusal needs several of them to agree:
//! refusing a good document is worse than accepting one that turns out to be degenerate later.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_symbolic::{Diagnostics, Model, ParameterId, Precision, Severity, Start};

use super::Bound;
use super::information::{Condition, Information};
use super::points::{ModelPoint, Numbers, sizes};
use crate::exposure::{ExposureAdvice, ExposureGoal, Kernels, outlook};
use crate::options::TrackerOptions;
use crate::solve::compiled::Compiled;
use crate::track::solver::Solver;
use crate::track::window::Reach;

/// Reciprocal condition below which a matrix is singular to working precision.
pub(super) const SINGULAR: f64 = 1e-13;
/// Reciprocal condition below which it is nearly singular: deviations are 10⁴ times those with all other parameters known.
pub(super) const NEARLY: f64 = 1e-8;
/// Perturbations of parameters that start at numbers.
const SHAKEN: [f64; 2] = [0.05, 0.4];
/// Least number of points that must agree.
const POINTS_MIN: usize = 2;
/// Largest value of an 8-bit camera.
const LIMIT: f64 = 255.0;

/// Expected quality of a model at a synthetic point.
#[derive(Clone, Debug, Default)]
pub(super) struct Outlook {
    /// For each stage, the reciprocal condition without saturation, and with 30 % of the target saturated.
    pub conditions: Vec<[Option<f64>; 2]>,
    pub bound: Option<Bound>,
    pub exposure: Vec<ExposureAdvice>,
    pub warnings: Diagnostics,
}

/// A model with its kernels and reach.
struct Survey {
    solver: Solver,
    kernels: Kernels,
    reach: Reach,
}

impl Outlook {
    /// Evaluates a model at as many synthetic points as needed.
    ///
    /// # Errors
    /// When parameters of the last stage are degenerate at all of them.
    pub fn of(compiled: &Compiled) -> Result<Outlook, Diagnostics> {
        let model = compiled.model();
        let mut found = Outlook { warnings: model.unused(), ..Outlook::default() };
        found.conditions = vec![[None; 2]; model.stages().len()];
        let solver = Solver::new(Arc::new(compiled.share()), TrackerOptions::default());
        let Some(kernels) = Kernels::compile(&solver, Precision::F64) else { return Ok(found) };
        let reach = Reach::of(model, &solver.constants);
        let survey = Survey { solver, kernels, reach };
        let started = |size: &f64| survey.at(*size, Numbers::AsStarted);
        let Some((point, clear)) = sizes(model).iter().find_map(started) else { return Ok(found) };
        let saturated = Information::saturated(&survey.solver, &survey.kernels, &point);
        for (stage, conditions) in model.stages().iter().zip(&mut found.conditions) {
            let of = |information: &Information| information.condition(&stage.parameters, SINGULAR);
            *conditions = [Some(&clear), saturated.as_ref()].map(|known| Some(of(known?)?.reciprocal));
        }
        if let Some(condition) = clear.condition(compiled.last_parameters(), SINGULAR) {
            survey.silent(&condition, &mut found.warnings);
            survey.alike(condition, &mut found.warnings)?;
        }
        found.bound = clear.deviations().map(|deviations| bound(compiled, &point.parameters, deviations));
        let goals = [ExposureGoal::Centre, ExposureGoal::Brightness];
        let advice = |goal| outlook(&survey.solver, &survey.kernels, goal, (&point.parameters, point.window), LIMIT);
        found.exposure = goals.into_iter().filter_map(advice).collect();
        Ok(found)
    }
}

fn bound(compiled: &Compiled, parameters: &[f64], deviations: Vec<f64>) -> Bound {
    let model = compiled.model();
    let name = |id: ParameterId| model.parameters()[id.index()].name.clone();
    let names = model.parameters().iter().map(|parameter| parameter.name.clone());
    let free = compiled.last_parameters().iter().map(|id| name(*id));
    Bound {
        parameters: names.zip(parameters.iter().copied()).collect::<BTreeMap<_, _>>(),
        deviation: free.zip(deviations).collect::<BTreeMap<_, _>>(),
        saturated: 0.0,
        noise: (!model.has_noise()).then_some(1.0),
    }
}

impl Survey {
    fn model(&self) -> &Model {
        self.solver.model()
    }

    fn last(&self) -> &[ParameterId] {
        self.solver.compiled.last_parameters()
    }

    fn at(&self, size: f64, numbers: Numbers) -> Option<(ModelPoint, Information)> {
        let point = ModelPoint::made_up(self.model(), &self.solver.constants, &self.reach, size, numbers)?;
        let known = Information::of(&self.solver, &self.kernels, &point)?;
        Some((point, known))
    }

    /// The condition of the last stage without saturation.
    fn condition(&self, size: f64, numbers: Numbers) -> Option<Condition> {
        let (_, clear) = self.at(size, numbers)?;
        clear.condition(self.last(), SINGULAR)
    }

    fn all(&self, numbers: Numbers) -> impl Iterator<Item = Condition> {
        sizes(self.model()).into_iter().filter_map(move |size| self.condition(size, numbers))
    }

    /// Parameters without effect give a warning, not an error: the synthetic points may be untypical.
    fn silent(&self, condition: &Condition, warnings: &mut Diagnostics) {
        if condition.silent.is_empty() {
            return;
        }
        let shaken: Vec<Condition> = SHAKEN.into_iter().flat_map(|by| self.all(Numbers::Shaken(by))).collect();
        for id in condition.silent.iter().filter(|id| self.model().reads(**id)) {
            let name = &self.model().parameters()[id.index()].name;
            let is_always = shaken.iter().all(|other| other.silent.contains(id));
            let (message, help) = match is_always {
                true => (format!("`{name}` changes no pixel of a made-up picture"), "take it out of the stage"),
                false => (format!("`{name}` changes no pixel where it starts"), "start it at another number"),
            };
            let stage = self.model().stages().len() - 1;
            warnings.push(self.model().remark(Severity::Warning, "no-effect", (Some(stage), *id), message).help(help));
        }
    }

    /// Reports degenerate parameters.
    fn alike(&self, first: Condition, warnings: &mut Diagnostics) -> Result<(), Diagnostics> {
        if first.others >= NEARLY {
            return Ok(());
        }
        let started: Vec<Condition> = self.all(Numbers::AsStarted).collect();
        let Some(best) = started.iter().max_by(|a, b| a.others.total_cmp(&b.others)) else { return Ok(()) };
        if best.others >= NEARLY {
            return Ok(());
        }
        if best.others >= SINGULAR {
            warnings.push(self.remark(Severity::Warning, &self.nearly(), "can hardly be told apart"));
            return Ok(());
        }
        let shaken: Vec<Condition> = SHAKEN.into_iter().flat_map(|by| self.all(Numbers::Shaken(by))).collect();
        let is_everywhere = shaken.len() >= POINTS_MIN && shaken.iter().all(|other| other.others < SINGULAR);
        let (points, words) = match is_everywhere {
            true => (&shaken, "cannot be told apart"),
            false => (&started, "cannot be told apart where they start"),
        };
        let is_involved = |id: &&ParameterId| points.iter().any(|point| point.alike.contains(id));
        let alike: Vec<ParameterId> = self.last().iter().filter(is_involved).copied().collect();
        let is_sure = alike.len() >= 2 && (is_everywhere || self.is_sure(&started));
        let severity = if is_sure { Severity::Error } else { Severity::Warning };
        let remark = self.remark(severity, &alike, words);
        if is_sure {
            return Err(vec![remark]);
        }
        warnings.push(remark);
        Ok(())
    }

    /// A stage that is degenerate only at its start values is refused when this is no accident: when it is a single
    /// combination, the same for targets of all sizes, and includes an estimated parameter. Components that start alike
    /// are several combinations, and separate at the first step.
    fn is_sure(&self, started: &[Condition]) -> bool {
        let is_common = |id: &&ParameterId| started.iter().all(|point| point.alike.contains(id));
        let common: Vec<&ParameterId> = self.last().iter().filter(is_common).collect();
        let is_found = |id: &&ParameterId| number(self.model().parameters()[id.index()].start).is_none();
        let agree =
            started.len() >= POINTS_MIN && started.iter().all(|point| point.nullity == 1 && point.silent.is_empty());
        agree && common.len() >= 2 && common.iter().copied().any(|id| is_found(&id))
    }

    /// The parameters involved in a nearly singular matrix.
    fn nearly(&self) -> Vec<ParameterId> {
        let known = sizes(self.model()).into_iter().find_map(|size| self.at(size, Numbers::AsStarted));
        let condition = known.and_then(|(_, clear)| clear.condition(self.last(), NEARLY));
        condition.map_or_else(|| self.last().to_vec(), |condition| condition.alike)
    }

    fn remark(&self, severity: Severity, alike: &[ParameterId], words: &str) -> isophote_symbolic::Diagnostic {
        let model = self.model();
        let name = |index: usize| model.parameters()[index].name.as_str();
        let is_free = |id: &&ParameterId| number(model.parameters()[id.index()].start).is_some();
        // Parameters that start at a number can be held.
        let held = alike.iter().rev().find(is_free).or(alike.last()).copied().unwrap_or(ParameterId(0));
        let moved = |index: &usize| {
            let is_number = number(model.parameters()[*index].start).is_some();
            let regular = |size| self.condition(size, Numbers::Moved(*index)).is_some_and(|c| c.others >= SINGULAR);
            words.ends_with("start") && is_number && sizes(model).into_iter().any(regular)
        };
        let elsewhere: Vec<&str> = (0..model.parameters().len()).filter(moved).map(name).collect();
        let names: Vec<&str> = alike.iter().map(|id| name(id.index())).collect();
        let message = format!("{} {words}: together they change the pixels as one of them would", list(&names, "and"));
        let mut help = format!("hold one of them: take it out of the stage, e.g. `{}`", name(held.index()));
        if !elsewhere.is_empty() {
            help += &format!("; or start {} at another number", list(&elsewhere, "or"));
        }
        let code = if words.contains("hardly") { "nearly-degenerate" } else { "degenerate" };
        model.remark(severity, code, (Some(model.stages().len() - 1), held), message).help(help)
    }
}

fn number(start: Start) -> Option<f64> {
    match start {
        Start::Number(number) => Some(number),
        Start::Estimator(_) => None,
    }
}

/// `a, b and c`.
fn list(names: &[&str], last: &str) -> String {
    match names {
        [] => String::new(),
        [one] => format!("`{one}`"),
        [most @ .., one] => {
            let most: Vec<String> = most.iter().map(|name| format!("`{name}`")).collect();
            format!("{} {last} `{one}`", most.join(", "))
        }
    }
}
