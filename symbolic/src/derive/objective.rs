//! `Objective`: F, its gradient and its Hessian for a subset of the parameters, as sums of pixel values with coefficients
//! that leave the pixel loop.
//!
//! Per pixel F = r²/σ² (σ² = 1 without `noise`), r = observed − intensity. With forms over cuts l, m (shared nodes such as
//! s, treated as variables): F_u = Σ L_l l_u and F_uv = Σ Q_lm l_u l_v + Σ L_l l_uv. L and Q are the costly pixel values;
//! l_u and l_uv are expanded into pixel and row monomials, so that a few accumulators, each L or Q times a monomial, serve
//! every entry. Gauss–Newton keeps Σ Q_lm l_u l_v with Q from ∂²F/∂r² alone.

use crate::derive::absorb::gather;
use crate::derive::derivation::{Cuts, Derivation, Part, Target};
use crate::derive::expressions::Expressions;
use crate::derive::monomial::whole_output;
use crate::derive::schedule;
use crate::derive::search;
use crate::derive::sums::{Output, Sums};
use crate::language::budget::Budget;
use crate::language::diagnostic::{Diagnostic, Diagnostics, Span};
use crate::language::graph::{Graph, Node, NodeId};
use crate::language::limits::LIMITS;
use crate::language::model::{Lowering, Method, Model, Saturated};
use crate::program::{Comparison, Cost, Input, Level, ParameterId, Program};
use crate::proof::{Claim, Errors, Form, Proof, is_small_f32};

/// What a value objective sums.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum ValueKind {
    /// Σ r²/σ², σ² held at the entry parameters: what a pass' steps are compared by. One output, F.
    Entry,
    /// Σ r²/σ² + ln σ² at the parameters themselves, for the report. Two outputs: F, and Σ r²/σ².
    Full,
}

/// Units of work that it takes to lower an operation of a formula.
const LOWERED: usize = 8;

/// Predicted to be within so many standard deviations of the limit is near it.
const NEAR_LIMIT: f64 = 3.0;

/// What a plane of predictions holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Prediction {
    /// The intensity, as it is fitted; NaN outside of the domain.
    Intensity,
    /// The intensity everywhere.
    Unbounded,
    /// A pixel's variance.
    Variance,
}

/// What is to be summed; see the module's text.
#[derive(Clone, Debug)]
pub struct Objective {
    graph: Graph,
    sums: Sums,
    /// Outputs that are F itself: left out of the cost.
    values: usize,
    subset: Vec<ParameterId>,
    names: crate::program::Names,
    domain: Option<NodeId>,
    proof: Option<Proof>,
    /// The program that was proved: that of [`CHECKED`].
    checked: Option<Program>,
    origin: Origin,
    forms: Vec<(String, NodeId)>,
}

/// How a program is lowered for its check; others differ in contraction and in the pixels that they leave out.
const CHECKED: Lowering = Lowering { fma: true, drop_saturated: false };

impl Objective {
    /// The free parameters.
    pub fn subset(&self) -> &[ParameterId] {
        &self.subset
    }

    /// The loop nest.
    pub fn program(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        if let (CHECKED, Some(program)) = (lowering, &self.checked) {
            return Ok(program.clone());
        }
        self.lowered(lowering, Budget::default())
    }

    fn lowered(&self, lowering: Lowering, budget: Budget) -> Result<Program, Diagnostics> {
        let mut graph = self.graph.drawing_on(budget);
        let program = schedule::sums(&mut graph, &self.sums, self.domain, lowering, self.names.clone());
        self.origin.checked(&graph, program)
    }

    /// Takes what is yet to come from the document's budget: the programs that callers ask for, once for all pixels and once
    /// without saturated ones, and the memory that stays in use. After that the objective is its holder's.
    fn paid(mut self, work: usize) -> Result<Objective, Diagnostics> {
        let mut budget = self.graph.budget().clone();
        self.graph.draw_on(Budget::default());
        budget.charge(work);
        let instructions = self.checked.as_ref().map_or(0, |program| program.instructions().len());
        let is_room = budget.keep(self.graph.len() + 2 * instructions);
        if budget.is_spent() || !is_room { Err(self.origin.spent(&budget)) } else { Ok(self) }
    }

    /// The same sums without pixels that are no number (NaN) in a channel that the sums read: those that a caller takes out
    /// of a picture.
    pub fn skipping_nan(&self) -> Objective {
        let mut objective = Objective { checked: None, ..self.clone() };
        let graph = &mut objective.graph;
        let summed = objective.sums.summed(graph);
        for id in graph.reachable(&summed) {
            if let Node::Channel(_) = graph.node(id) {
                let is_number = graph.compare(Comparison::Eq, id, id);
                objective.domain = Some(match objective.domain {
                    Some(domain) => graph.and(domain, is_number),
                    None => is_number,
                });
            }
        }
        objective
    }

    /// What the loop nest costs, F itself left out (the convention of the flops table).
    pub fn cost(&self, lowering: Lowering) -> Result<Cost, Diagnostics> {
        let mut graph = self.graph.drawing_on(Budget::default());
        let mut sums = self.sums.clone();
        if sums.outputs.len() > self.values {
            sums.outputs.drain(..self.values);
        }
        let program = schedule::sums(&mut graph, &sums, self.domain, lowering, self.names.clone());
        Ok(self.origin.checked(&graph, program)?.cost())
    }

    /// What [`Self::outputs`] and [`Self::forms`] are made of.
    pub fn expressions(&self) -> Expressions<'_> {
        Expressions::of(&self.graph)
    }
    /// What is summed, by output: F, its gradient, its upper Hessian row by row.
    pub fn outputs(&self) -> &[Output] {
        &self.sums.outputs
    }
    /// The costly pixel values L and Q that a factored derivation multiplies, with their letters.
    pub fn forms(&self) -> &[(String, NodeId)] {
        &self.forms
    }
    /// What the model calls everything.
    pub fn names(&self) -> &crate::program::Names {
        &self.names
    }

    pub(crate) fn value(model: &Model, kind: ValueKind) -> Result<Objective, Diagnostics> {
        let mut graph = model.formulas.graph.drawing_on(model.budget());
        let residual = residual(&mut graph, model);
        let variance = variance(&mut graph, model, kind == ValueKind::Entry);
        let shape = model.formulas.shape();
        let chi = shape.value(&mut graph, residual, variance);
        let chi_square = whole_output(&mut graph, "chi2", chi);
        let outputs = match (kind, variance) {
            (ValueKind::Entry, _) => vec![chi_square],
            (ValueKind::Full, Some(v)) if shape.has_logarithm() => {
                let log = graph.call1(crate::program::function::Function1::Log, v);
                let total = graph.add2(chi, log);
                vec![whole_output(&mut graph, "F", total), chi_square]
            }
            (ValueKind::Full, _) => vec![Output { name: "F".into(), ..chi_square.clone() }, chi_square],
        };
        let names = model.names(outputs.iter().map(|o| o.name.clone()).collect());
        let domain = entry_domain(&mut graph, model);
        let work = LOWERED * graph.reachable(&[chi]).len();
        let sums = Sums { outputs, shift: None };
        let objective = Objective {
            graph,
            sums,
            values: 0,
            subset: Vec::new(),
            names,
            domain,
            proof: None,
            checked: None,
            origin: Origin::of(model),
            forms: Vec::new(),
        };
        objective.paid(2 * work)
    }

    pub(crate) fn derive(model: &Model, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        let setting = Setting::new(model, subset, method);
        let Setting { graph, residual, variance, domain, parameters, newton, .. } = &setting;
        let claim = Claim {
            model,
            graph,
            residual: *residual,
            variance: *variance,
            shape: model.formulas.shape(),
            domain: *domain,
            parameters,
            newton: *newton,
        };
        let (budget, mut lowering) = (graph.budget().clone(), 0);
        let mut candidate = |form: Form| -> Result<Objective, Refusal> {
            let mut objective = setting.objective(form, Part::Both).map_err(Refusal::Limit)?;
            let before = budget.work();
            let program = objective.lowered(CHECKED, budget.clone()).map_err(Refusal::Limit)?;
            lowering = budget.work() - before;
            if claim.is_too_large() {
                return Err(Refusal::Limit(Origin::of(model).growth(subset.len())));
            }
            let Some(Errors { exact, error, f32_error }) = claim.check(&program) else { return Err(Refusal::Wrong) };
            objective.proof = Some(Proof { form, exact, error, f32_error });
            objective.checked = Some(program);
            Ok(objective)
        };
        let found = safest(&mut candidate).map_err(|refusal| match refusal {
            Refusal::Limit(faults) => faults,
            Refusal::Wrong => Origin::of(model).bug(),
        });
        found.and_then(|objective| objective.paid(lowering))
    }

    /// Gradient or Hessian in a loop of its own, in the form of the joint loop.
    pub(crate) fn part(
        model: &Model,
        subset: &[ParameterId],
        method: Method,
        part: Part,
    ) -> Result<Objective, Diagnostics> {
        let joint = Objective::derive(model, subset, method)?;
        match (part, joint.proof) {
            (Part::Gradient | Part::Hessian, Some(proof)) => {
                Setting::new(model, subset, method).objective(proof.form, part)
            }
            _ => Ok(joint),
        }
    }

    /// What the check of the program found; `None` for a value objective.
    pub fn proof(&self) -> Option<&Proof> {
        self.proof.as_ref()
    }
}

/// What is derived from, the same for every form.
struct Setting<'a> {
    model: &'a Model,
    graph: Graph,
    residual: NodeId,
    variance: Option<NodeId>,
    domain: Option<NodeId>,
    subset: Vec<ParameterId>,
    parameters: Vec<NodeId>,
    newton: bool,
}

impl<'a> Setting<'a> {
    fn new(model: &'a Model, subset: &[ParameterId], method: Method) -> Setting<'a> {
        let mut graph = model.formulas.graph.drawing_on(model.budget());
        let residual = residual(&mut graph, model);
        let residual = gather(&mut graph, residual);
        graph.set_opaque(residual);
        let newton = method == Method::Newton;
        let variance = variance(&mut graph, model, !newton);
        let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let domain = entry_domain(&mut graph, model);
        Setting { model, graph, residual, variance, domain, subset: subset.to_vec(), parameters, newton }
    }

    /// The sums in one form, not yet checked.
    fn objective(&self, form: Form, part: Part) -> Result<Objective, Diagnostics> {
        let Setting { model, graph, residual, variance, domain, subset, parameters, newton } = self;
        let names: Vec<String> = subset.iter().map(|p| model.parameters[p.index()].name.clone()).collect();
        // Without noise the gradient is the same by both methods, and second derivatives are not wanted for it.
        let newton = *newton && (part.has_hessian() || variance.is_some());
        let (residual, variance) = (*residual, *variance);
        let shape = model.formulas.shape();
        let target = Target { parameters, names: &names, residual, variance, shape, newton, part };
        let derived = match form {
            Form::Unfactored => Derivation::new(graph.copied(), &target, &Cuts::default())
                .and_then(|mut derivation| derivation.unfactored().map(|sums| (derivation, sums))),
            _ => search::fewest_flops(graph, &target, form == Form::Factored),
        };
        let origin = Origin::of(model);
        let (derivation, sums) = derived.ok_or_else(|| origin.outgrown(graph, subset.len()))?;
        Ok(Objective {
            names: model.names(sums.outputs.iter().map(|o| o.name.clone()).collect()),
            sums,
            values: 1,
            subset: subset.clone(),
            domain: *domain,
            origin,
            forms: derivation.forms,
            graph: derivation.graph,
            proof: None,
            checked: None,
        })
    }
}

/// Why a form has no program.
enum Refusal {
    /// It grows past a limit.
    Limit(Diagnostics),
    /// It does not compute the derivatives.
    Wrong,
}

/// The most factored form whose error in f32 is small, or at most four times that of the unfactored form.
fn safest(candidate: &mut dyn FnMut(Form) -> Result<Objective, Refusal>) -> Result<Objective, Refusal> {
    let error = |objective: &Objective| objective.proof.and_then(|proof| proof.f32_error);
    let factored = candidate(Form::Factored);
    match &factored {
        Ok(objective) if is_small_f32(error(objective)) => return factored,
        Err(Refusal::Limit(_)) => return factored,
        _ => {}
    }
    let Ok(unfactored) = candidate(Form::Unfactored) else { return factored.or_else(|_| candidate(Form::Plain)) };
    let bound = 4.0 * error(&unfactored).unwrap_or(f64::INFINITY);
    let fits = |objective: &Objective| error(objective).is_none_or(|error| error <= bound);
    let found = factored.ok().filter(fits).or_else(|| candidate(Form::Plain).ok().filter(fits));
    Ok(found.unwrap_or(unfactored))
}

/// Where the model's intensity stands, for faults that concern the model as a whole.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    text: std::sync::Arc<str>,
    span: Span,
}

impl Origin {
    pub fn of(model: &Model) -> Origin {
        let span = model.formulas.graph.span(model.formulas.intensity).unwrap_or_default();
        Origin { text: model.text.clone(), span }
    }

    fn fault(&self, code: &'static str, message: String) -> Diagnostics {
        let help = "free fewer parameters per stage, or give shared parts a definition";
        vec![Diagnostic::error(&self.text, code, "model.intensity", self.span, message).help(help)]
    }

    fn bug(&self) -> Diagnostics {
        let message =
            "no program that was derived for this model passes its check: a fault of isophote, not of the document";
        let help = "please report the document; spelling the formula in another way may help";
        vec![Diagnostic::error(&self.text, "bug", "model.intensity", self.span, message).help(help)]
    }

    pub fn growth(&self, parameters: usize) -> Diagnostics {
        let most = LIMITS.nodes;
        let message = format!("the derivatives for {parameters} parameters grow past {most} distinct operations");
        self.fault("limit", message)
    }

    /// Past the budget, or too large.
    fn outgrown(&self, graph: &Graph, parameters: usize) -> Diagnostics {
        if graph.budget().is_spent() { self.spent(graph.budget()) } else { self.growth(parameters) }
    }

    /// The document's budget is spent.
    fn spent(&self, budget: &Budget) -> Diagnostics {
        let message = match budget.is_spent() {
            true => format!("deriving what the stages need takes more than {} units of work", LIMITS.work),
            false => format!("the programs of all stages hold more than {} operations", LIMITS.kept),
        };
        let help = "free fewer parameters per stage, merge stages, or give shared parts a definition";
        vec![Diagnostic::error(&self.text, "limit", "model.intensity", self.span, message).help(help)]
    }

    pub fn checked(&self, graph: &Graph, program: Program) -> Result<Program, Diagnostics> {
        let (count, most) = match program.instructions().iter().filter(|i| i.level == Level::Pixel).count() {
            pixel if pixel > LIMITS.instructions => (pixel, LIMITS.instructions),
            _ => (program.instructions().len(), LIMITS.nodes),
        };
        if graph.budget().is_spent() {
            return Err(self.spent(graph.budget()));
        }
        if graph.overflowed() {
            return Err(self.fault("limit", format!("the loop grows past {} distinct operations", LIMITS.nodes)));
        }
        if count > most {
            return Err(
                self.fault("limit", format!("the loop takes {count} instructions; at most {most} are compiled"))
            );
        }
        Ok(program)
    }
}

/// The program that adds the intensity, at shifted coordinates, to a plane.
pub(crate) fn rendering(model: &Model, lowering: Lowering) -> Result<Program, Diagnostics> {
    let mut graph = model.formulas.graph.drawing_on(Budget::default());
    let mut shifted = |graph: &mut Graph, node: &Node| match node {
        Node::Coordinate(c) => {
            let shift = graph.input(Input::Shift(*c));
            let coordinate = graph.coordinate(*c);
            Some(graph.add2(coordinate, shift))
        }
        _ => None,
    };
    let intensity = graph.substitute(model.formulas.shown, &mut shifted);
    let program = schedule::plane(&mut graph, intensity, lowering, model.names(vec!["intensity".into()]));
    Origin::of(model).checked(&graph, program)
}

/// The program that adds what is predicted of a pixel to a plane: the intensity, as it is fitted, inside of the domain, and
/// NaN outside; or its variance, where that reads no channel.
pub(crate) fn prediction(model: &Model, what: Prediction, lowering: Lowering) -> Option<Result<Program, Diagnostics>> {
    let mut graph = model.formulas.graph.drawing_on(Budget::default());
    let value = match what {
        Prediction::Intensity => {
            let intensity = model.formulas.intensity;
            match model.formulas.domain {
                Some(domain) => {
                    let outside = graph.number(f64::NAN);
                    graph.select(domain, intensity, outside)
                }
                None => intensity,
            }
        }
        Prediction::Unbounded => model.formulas.intensity,
        Prediction::Variance => match model.formulas.noise {
            Some(noise) => noise,
            None => graph.number(1.0),
        },
    };
    if graph.reachable(&[value]).iter().any(|n| matches!(graph.node(*n), Node::Channel(_))) {
        return None;
    }
    let program = schedule::plane(&mut graph, value, lowering, model.names(vec!["prediction".into()]));
    Some(Origin::of(model).checked(&graph, program))
}

/// The pixel's variance; `held` reads it at the entry parameters.
pub(crate) fn variance(graph: &mut Graph, model: &Model, held: bool) -> Option<NodeId> {
    let node = model.formulas.noise?;
    let node = if held { at_entry(graph, node) } else { node };
    graph.set_opaque(node);
    Some(node)
}

fn at_entry(graph: &mut Graph, node: NodeId) -> NodeId {
    let mut entry = |graph: &mut Graph, node: &Node| match node {
        Node::Input(Input::Parameter(p)) => Some(graph.input(Input::Entry(*p))),
        _ => None,
    };
    graph.substitute(node, &mut entry)
}

/// observed − intensity; of a pixel at its limit that limit − intensity.
pub(crate) fn residual(graph: &mut Graph, model: &Model) -> NodeId {
    let observed = match model.formulas.clipped {
        Some(channel) => graph.input(Input::Saturation(channel)),
        None => model.formulas.observed,
    };
    graph.sub(observed, model.formulas.intensity)
}

/// Where the model holds, at the entry parameters; of pixels at their limit those.
fn entry_domain(graph: &mut Graph, model: &Model) -> Option<NodeId> {
    let mut domain = model.formulas.domain.map(|d| at_entry(graph, d));
    if let (Saturated::Predicted, Node::Channel(channel)) =
        (model.formulas.saturated, graph.node(model.formulas.observed).clone())
    {
        let limit = graph.input(Input::Saturation(channel));
        let intensity = at_entry(graph, model.formulas.intensity);
        let deviation = match model.formulas.noise {
            Some(noise) => {
                let noise = at_entry(graph, noise);
                graph.sqrt(noise)
            }
            None => graph.number(0.0),
        };
        let most = graph.sum(0.0, [(limit, 1.0), (deviation, -NEAR_LIMIT)]);
        let below = graph.compare(Comparison::Lt, intensity, most);
        domain = Some(domain.map_or(below, |domain| graph.and(domain, below)));
    }
    let Some(channel) = model.formulas.clipped else { return domain };
    let (limit, pixel) = (graph.input(Input::Saturation(channel)), graph.channel(channel));
    let clipped = graph.compare(Comparison::Le, limit, pixel);
    Some(domain.map_or(clipped, |domain| graph.and(domain, clipped)))
}
