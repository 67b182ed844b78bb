//! `Objective`: F, its gradient and its Hessian for a subset of the parameters, as sums of pixel values with
//! coefficients outside of the pixel loop. It brings derivation, schedule and check together: a model comes in, and
//! programs that passed go out.
//!
//! Per pixel F = r²/σ² (σ² = 1 without `noise`), r = observed − intensity. With forms over cuts l, m (shared nodes such
//! as s, treated as variables): F_u = Σ L_l l_u and F_uv = Σ Q_lm l_u l_v + Σ L_l l_uv. L and Q are the costly pixel
//! values; l_u and l_uv are expanded into pixel and row monomials, so that a few accumulators, each L or Q times a
//! monomial, serve every entry. Gauss–Newton keeps Σ Q_lm l_u l_v with Q from ∂²F/∂r² alone.

mod passes;
pub(crate) mod planes;

use std::sync::{Arc, OnceLock};

use crate::derive::absorb::{Scaling, gather, reciprocals};
use crate::derive::derivation::{By, Cuts, Derivation, Differentiand};
use crate::derive::joint::{counted, full};
use crate::derive::monomial::whole_output;
use crate::derive::search;
use crate::graph::budget::Budget;
use crate::graph::expressions::Expressions;
use crate::graph::hyper::Order;
use crate::graph::{Graph, NodeId};
use crate::likelihood::claim::{Claim, Part, ValueKind};
use crate::likelihood::terms::{PixelValue, entry_domain, rewritten_values, values};
use crate::model::{Method, Model, Summand};
use crate::objective::planes::Prediction;
use crate::program::interpreter::{Pixels, Window};
use crate::program::{Bindings, ChannelId, Comparison, Cost, Input, LoopNest, ParameterId};
use crate::proof::direct::DirectSums;
use crate::proof::program::Program;
use crate::proof::referee::Referee;
use crate::proof::{Errors, Form, Proof, is_small_f32};
use crate::schedule::domain::region;
use crate::schedule::sums::{FactoredSums, Output};
use crate::schedule::{self, Lowering};
use isophote_syntax::diagnostic::Diagnostics;

/// Budget for lowering an objective again, with one more condition, as a multiple of the work of the first time.
const AGAIN: usize = 4;

/// The sums of an objective; see the module's text.
#[derive(Clone, Debug)]
pub struct Objective {
    graph: Graph,
    sums: FactoredSums,
    subset: Vec<ParameterId>,
    names: Arc<crate::program::Names>,
    domain: Option<NodeId>,
    /// Leaves out NaN pixels.
    is_seeing: bool,
    proof: Option<Proof>,
    /// Units of work of the lowering, charged to the document once more; `None` while it draws on the document's
    /// budget.
    paid: Option<usize>,
    /// The program proved first, lowered as [`CHECKED`].
    checked: OnceLock<Program>,
    /// Checks its programs.
    referee: Arc<Referee>,
    forms: Vec<(String, NodeId)>,
}

impl Summand {
    /// F, its gradient and its Hessian for a subset of the parameters.
    pub fn objective(&self, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        let claim = Claim::Derivatives { newton: method == Method::Newton, part: Part::Both };
        let referee = Referee::of(self, subset, claim)?;
        let setting = DerivationSetting::of(&referee, subset, self.budget());
        let (budget, mut lowering) = (setting.graph.budget().clone(), 0);
        let mut candidate = |form: Form| -> Result<Objective, Refusal> {
            let mut objective = setting.objective(form).map_err(Refusal::Limit)?;
            // Others may draw on the budget at the same time: only the graph's own work counts.
            let mut graph = objective.graph.drawing_on(budget.clone());
            let nest = objective.lowered_in(CHECKED, &mut graph).map_err(Refusal::Limit)?;
            lowering = graph.work();
            let Some((program, Errors { exact, error })) = objective.proved(nest, CHECKED) else {
                return Err(Refusal::Wrong);
            };
            objective.proof = Some(Proof { form, exact, error, f32_error: referee.f32_error(&program) });
            objective.checked = program.into();
            Ok(objective)
        };
        let found = safest(&mut candidate).map_err(|refusal| match refusal {
            Refusal::Limit(faults) => faults,
            Refusal::Wrong => self.unproved(referee.is_blind()),
        });
        found.and_then(|objective| objective.paid(lowering))
    }

    /// F alone.
    pub fn value_objective(&self, kind: ValueKind) -> Result<Objective, Diagnostics> {
        let mut graph = self.model().formulas.graph.drawing_on(self.budget());
        let values = values(&mut graph, self, Claim::Value(kind));
        let [full, chi] = full(&mut graph, self.shape(), &values, |value| value.variance);
        let mut outputs = match kind {
            ValueKind::Entry => vec![whole_output(&mut graph, "chi2", chi)],
            ValueKind::Full => vec![whole_output(&mut graph, "F", full), whole_output(&mut graph, "chi2", chi)],
        };
        outputs.extend(counted(&mut graph, &values));
        let domain = entry_domain(&mut graph, self, Claim::Value(kind));
        let referee = Referee::of(self, &[], Claim::Value(kind))?;
        Objective::unchecked(referee, &[], graph, FactoredSums { outputs, shift: None }, domain).measured()
    }
}

/// The same for the first summand, on a budget of its own.
impl Model {
    /// [`Summand::objective`] of the first summand.
    pub fn objective(&self, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        self.first_summand().objective(subset, method)
    }
    /// [`Summand::part_objective`] of the first summand.
    pub fn part_objective(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Objective, Diagnostics> {
        self.first_summand().part_objective(subset, method, part)
    }
    /// [`Summand::value_objective`] of the first summand.
    pub fn value_objective(&self, kind: ValueKind) -> Result<Objective, Diagnostics> {
        self.first_summand().value_objective(kind)
    }
    /// [`Summand::rendering`] of the first summand.
    pub fn rendering(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        self.first_summand().rendering(lowering)
    }
    /// [`Summand::prediction`] of the first summand.
    pub fn prediction(&self, what: Prediction, lowering: Lowering) -> Option<Result<Program, Diagnostics>> {
        self.first_summand().prediction(what, lowering)
    }
}

/// The lowering that is checked; others differ in contraction and in the pixels that they leave out.
const CHECKED: Lowering = Lowering { fma: true, drop_saturated: false };

impl Objective {
    /// The free parameters.
    pub fn subset(&self) -> &[ParameterId] {
        &self.subset
    }

    /// The loop nest, checked against the document's formulas; a form that fails gives way to a plainer one.
    ///
    /// # Errors
    /// When it is too long, or when no form passes, which is a bug.
    pub fn program(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        let lowering = self.own(lowering);
        if lowering.fma == CHECKED.fma {
            let passed = self.passed()?;
            if !lowering.drop_saturated {
                return Ok(passed.clone());
            }
            let dropped = self.dropped(lowering);
            let nest = self.referee.summand().within_limits(&self.graph, passed.without_saturated(&dropped))?;
            if let Some(program) = self.referee.proved_alike(nest, &dropped, passed) {
                return Ok(program);
            }
        }
        self.lowered(lowering)
    }

    /// The effective lowering: joint loops mask the values of a pixel one by one.
    fn own(&self, lowering: Lowering) -> Lowering {
        Lowering { drop_saturated: lowering.drop_saturated && !self.is_joint(), ..lowering }
    }

    /// True when several values of a pixel are summed.
    pub(crate) fn is_joint(&self) -> bool {
        self.referee.summand().is_joint()
    }

    /// The program of [`CHECKED`], proved once.
    fn passed(&self) -> Result<&Program, Diagnostics> {
        if let Some(program) = self.checked.get() {
            return Ok(program);
        }
        let program = self.lowered(CHECKED)?;
        Ok(self.checked.get_or_init(|| program))
    }

    fn lowered(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        let nest = self.nest(lowering, self.budget())?;
        if let Some((program, _)) = self.proved(nest, lowering) {
            return Ok(program);
        }
        let budget = self.referee.summand().budget();
        self.plainer(lowering, &budget).ok_or_else(|| match budget.is_spent() {
            true => self.referee.summand().spent(&budget),
            false => self.referee.summand().unproved(self.referee.is_blind()),
        })
    }

    /// The budget for lowering it.
    fn budget(&self) -> Budget {
        self.paid.map_or_else(|| self.graph.budget().clone(), |units| Budget::with(AGAIN * units))
    }

    /// The loop nest before its check.
    fn nest(&self, lowering: Lowering, budget: Budget) -> Result<LoopNest, Diagnostics> {
        self.lowered_in(lowering, &mut self.graph.drawing_on(budget))
    }

    /// The same in this copy of the graph, which counts the work.
    fn lowered_in(&self, lowering: Lowering, graph: &mut Graph) -> Result<LoopNest, Diagnostics> {
        let nest = schedule::sums(graph, &self.sums, self.domain, lowering, self.names.clone());
        self.referee.summand().within_limits(graph, nest)
    }

    fn proved(&self, nest: LoopNest, lowering: Lowering) -> Option<(Program, Errors)> {
        self.referee.proved(nest, &self.dropped(lowering))
    }

    /// Channels whose limit leaves a pixel out.
    fn dropped(&self, lowering: Lowering) -> Vec<ChannelId> {
        if lowering.drop_saturated { self.channels() } else { Vec::new() }
    }

    /// Evaluates the formulas on a picture, for tests; see [`DirectSums`].
    #[doc(hidden)]
    pub fn direct(
        &self,
        lowering: Lowering,
        bindings: &Bindings<'_>,
        pixels: &dyn Pixels,
        window: Window,
        nudge: f64,
    ) -> DirectSums {
        self.referee.direct(&self.dropped(self.own(lowering)), bindings, pixels, window, nudge)
    }

    pub(crate) fn referee(&self) -> &Referee {
        &self.referee
    }

    /// Channels that the sums read.
    pub(crate) fn channels(&self) -> Vec<ChannelId> {
        self.graph.channels(&self.sums.pixels())
    }

    /// The same sums in the plainest way that passes, on the document's budget: other forms, then without contraction.
    pub(crate) fn plainer(&self, lowering: Lowering, budget: &Budget) -> Option<Program> {
        let of = |objective: &Objective, lowering: Lowering| {
            let nest = objective.nest(lowering, budget.clone()).ok()?;
            objective.proved(nest, lowering).map(|(program, _)| program)
        };
        let forms = || {
            if self.referee.claim().part().is_none() {
                return Vec::new();
            }
            let form = |form| {
                let mut objective =
                    DerivationSetting::of(&self.referee, &self.subset, budget.clone()).objective(form).ok()?;
                if self.is_seeing {
                    objective.domain = seeing(&mut objective.graph, objective.domain, &self.channels());
                }
                Some(objective)
            };
            [Form::Plain, Form::Unfactored].into_iter().filter_map(form).collect()
        };
        let others = forms();
        others.iter().find_map(|objective| of(objective, lowering)).or_else(|| {
            let uncontracted = Lowering { fma: false, ..lowering };
            std::iter::once(self).chain(&others).find_map(|objective| of(objective, uncontracted))
        })
    }

    /// Charges the document's budget in advance for the programs that callers request, once for all pixels and once
    /// without saturated ones, and for the memory that stays in use. The objective then draws on a budget of its own.
    fn paid(mut self, work: usize) -> Result<Objective, Diagnostics> {
        let mut budget = self.graph.budget().clone();
        self.paid = Some(work);
        self.graph.draw_on(self.budget());
        budget.charge(work);
        let instructions = self.checked.get().map_or(0, |program| program.instructions().len());
        let is_room = budget.keep(self.graph.len() + 2 * instructions);
        if budget.is_spent() || !is_room { Err(self.referee.summand().spent(&budget)) } else { Ok(self) }
    }

    /// The same sums without pixels that are NaN in a channel that the sums read: pixels that a caller masks in a
    /// picture.
    pub fn skipping_nan(&self) -> Objective {
        if self.is_joint() {
            return self.clone();
        }
        let mut objective = Objective { checked: OnceLock::new(), is_seeing: true, ..self.clone() };
        objective.graph.draw_on(self.budget());
        let channels = self.channels();
        objective.referee = Arc::new(self.referee.within(|graph, domain| seeing(graph, domain, &channels)));
        objective.domain = seeing(&mut objective.graph, objective.domain, &channels);
        objective
    }

    /// Cost of the loop nest without F itself (the convention of the flops table).
    pub fn cost(&self, lowering: Lowering) -> Result<Cost, Diagnostics> {
        let mut graph = self.graph.drawing_on(self.budget());
        let mut sums = self.sums.clone();
        if self.referee.claim().part().is_some() && sums.outputs.len() > 1 {
            sums.outputs.remove(0);
        }
        let nest = schedule::sums(&mut graph, &sums, self.domain, self.own(lowering), self.names.clone());
        Ok(self.referee.summand().within_limits(&graph, nest)?.cost())
    }

    /// The graph of [`Self::outputs`] and [`Self::forms`].
    pub fn expressions(&self) -> Expressions<'_> {
        Expressions::of(&self.graph)
    }
    /// The sums by output: F, its gradient, its upper Hessian row by row.
    pub fn outputs(&self) -> &[Output] {
        &self.sums.outputs
    }
    /// The costly pixel values L and Q that a factored derivation multiplies, with their letters.
    pub fn forms(&self) -> &[(String, NodeId)] {
        &self.forms
    }
    /// The names of the model.
    pub fn names(&self) -> &crate::program::Names {
        &self.names
    }

    fn unchecked(
        referee: Arc<Referee>,
        subset: &[ParameterId],
        graph: Graph,
        sums: FactoredSums,
        domain: Option<NodeId>,
    ) -> Objective {
        let outputs = sums.outputs.iter().map(|output| output.name.clone()).collect();
        Objective {
            names: referee.summand().model().names(outputs).into(),
            referee,
            graph,
            sums,
            subset: subset.to_vec(),
            domain,
            is_seeing: false,
            proof: None,
            paid: None,
            checked: OnceLock::new(),
            forms: Vec::new(),
        }
    }

    /// Lowers it once to measure the work, and pays for it.
    pub(super) fn measured(self) -> Result<Objective, Diagnostics> {
        let mut graph = self.graph.copied();
        let before = graph.work();
        self.lowered_in(CHECKED, &mut graph)?;
        self.paid(graph.work() - before)
    }

    /// The result of the check; `None` for a value objective.
    pub fn proof(&self) -> Option<&Proof> {
        self.proof.as_ref()
    }
}

/// The part of a domain whose pixels are numbers in these channels.
fn seeing(graph: &mut Graph, domain: Option<NodeId>, channels: &[ChannelId]) -> Option<NodeId> {
    channels.iter().fold(domain, |domain, channel| {
        let pixel = graph.channel(*channel);
        let is_number = graph.compare(Comparison::Eq, pixel, pixel);
        Some(domain.map_or(is_number, |domain| graph.and(domain, is_number)))
    })
}

/// The input of a derivation, shared by all forms.
pub(super) struct DerivationSetting<'a> {
    referee: &'a Arc<Referee>,
    graph: Graph,
    values: Vec<PixelValue>,
    domain: Option<NodeId>,
    is_masked: bool,
    subset: Vec<ParameterId>,
    parameters: Vec<NodeId>,
    newton: bool,
}

impl<'a> DerivationSetting<'a> {
    pub(super) fn of(referee: &'a Arc<Referee>, subset: &[ParameterId], budget: Budget) -> DerivationSetting<'a> {
        let summand = referee.summand();
        let mut graph = summand.model().formulas.graph.drawing_on(budget);
        let (newton, claim) = (referee.claim().is_newton(), referee.claim());
        let values = rewritten_values(&mut graph, summand, claim, &|graph, node, is_held| {
            let node = reciprocals(graph, node);
            // Predictions at the parameters themselves are rewritten as the residual is, so that both share values.
            let node = if !is_held || claim.is_at_entry() { gather(graph, node) } else { node };
            graph.set_opaque(node);
            node
        });
        let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let domain = entry_domain(&mut graph, summand, claim);
        let reads_alike = !newton && !claim.is_at_entry() && values[0].variance.is_some();
        let region = domain.filter(|_| reads_alike).map(|domain| region(&mut graph.copied(), domain));
        let is_masked = region.is_some_and(|region| region.mask.is_some());
        let subset = subset.to_vec();
        DerivationSetting { is_masked, referee, graph, values, domain, subset, parameters, newton }
    }

    /// The sums in one form, not yet checked.
    pub(super) fn objective(&self, form: Form) -> Result<Objective, Diagnostics> {
        let (summand, part) = (self.referee.summand(), self.referee.claim().part().unwrap_or(Part::Both));
        let names: Vec<String> =
            self.subset.iter().map(|p| summand.model().parameters[p.index()].name.clone()).collect();
        // Without noise both methods have the same gradient, which needs no second derivatives.
        let is_second = self.newton && (part.has_hessian() || self.values[0].variance.is_some());
        let order = if is_second { Order::Second } else { Order::First };
        let differentiand = Differentiand {
            parameters: &self.parameters,
            names: &names,
            values: self.values.clone(),
            is_opening: self.referee.claim().is_at_entry(),
            is_masked: self.is_masked,
            shape: summand.shape(),
            order,
            part,
        };
        let derived = match form {
            Form::Factored => search::fewest_flops(&self.graph, &differentiand, Scaling::Unified),
            Form::Plain => search::fewest_flops(&self.graph, &differentiand, Scaling::AsWritten),
            Form::Unfactored => Derivation::new(self.graph.copied(), &differentiand, &Cuts::default(), By::Variables)
                .and_then(|mut derivation| derivation.unfactored().map(|sums| (derivation, sums))),
        };
        let (mut derivation, mut sums) = derived.ok_or_else(|| summand.outgrown(&self.graph, self.subset.len()))?;
        sums.outputs.extend(derivation.closing());
        let (referee, forms) = (self.referee.clone(), derivation.forms);
        let objective = Objective::unchecked(referee, &self.subset, derivation.graph, sums, self.domain);
        Ok(Objective { forms, ..objective })
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
