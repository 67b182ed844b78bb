//! `Objective`: F, its gradient and its Hessian for a subset of the parameters, as sums of pixel values with coefficients
//! that leave the pixel loop.
//!
//! Per pixel F = r²/σ² (σ² = 1 without `noise`), r = observed − intensity. With forms over cuts l, m (shared nodes such as
//! s, treated as variables): F_u = Σ L_l l_u and F_uv = Σ Q_lm l_u l_v + Σ L_l l_uv. L and Q are the costly pixel values;
//! l_u and l_uv are expanded into pixel and row monomials, so that a few accumulators, each L or Q times a monomial, serve
//! every entry. Gauss–Newton keeps Σ Q_lm l_u l_v with Q from ∂²F/∂r² alone.

use std::sync::{Arc, OnceLock};

use crate::derive::absorb::{Scaling, gather, reciprocals};
use crate::derive::derivation::{By, Cuts, Derivation, Differentiand};
use crate::derive::domain::region;
use crate::derive::expressions::Expressions;
use crate::derive::joint::{counted, full};
use crate::derive::monomial::whole_output;
use crate::derive::schedule;
use crate::derive::search;
use crate::derive::sums::{FactoredSums, Output};
use crate::derive::terms::{entry_domain, referee, rewritten_values, values};
use crate::derive::whole_model::WholeModel;
use crate::language::budget::Budget;
use crate::language::graph::{Graph, NodeId};
use crate::language::model::{Lowering, Method, Model};
use crate::program::interpreter::{Pixels, Window};
use crate::program::{Bindings, ChannelId, Comparison, Cost, Input, ParameterId, Program};
use crate::proof::claim::{Claim, Part, ValueKind};
use crate::proof::direct::DirectSums;
use crate::proof::draft::Draft;
use crate::proof::hyper::Order;
use crate::proof::referee::Referee;
use crate::proof::subject::PixelValue;
use crate::proof::{Errors, Form, Proof, is_small_f32};
use isophote_syntax::diagnostic::Diagnostics;

/// How often as much as the first time it may take to lower an objective again, with a condition more.
const AGAIN: usize = 4;

/// What is to be summed; see the module's text.
#[derive(Clone, Debug)]
pub struct Objective {
    graph: Graph,
    sums: FactoredSums,
    /// Outputs that are F itself: left out of the cost.
    values: usize,
    subset: Vec<ParameterId>,
    names: Arc<crate::program::Names>,
    domain: Option<NodeId>,
    /// Pixels that are no number take no part.
    is_seeing: bool,
    proof: Option<Proof>,
    /// Units of work that lowering it took, and that the document has paid for once more; `None` while it draws on a budget.
    paid: Option<usize>,
    /// The program that was proved first: that of [`CHECKED`].
    checked: OnceLock<Program>,
    /// What its programs are held against.
    referee: Arc<Referee>,
    origin: WholeModel,
    forms: Vec<(String, NodeId)>,
}

/// How a program is lowered for its check; others differ in contraction and in the pixels that they leave out.
const CHECKED: Lowering = Lowering { fma: true, drop_saturated: false };

impl Objective {
    /// The free parameters.
    pub fn subset(&self) -> &[ParameterId] {
        &self.subset
    }

    /// The loop nest. It was held against the document's formulas: one that does not sum what they say gives way to a plainer
    /// one.
    ///
    /// # Errors
    /// When it is too long; when no form passes, which is a bug.
    pub fn program(&self, lowering: Lowering) -> Result<Program, Diagnostics> {
        let lowering = self.own(lowering);
        if lowering.fma == CHECKED.fma {
            let passed = self.passed()?;
            if !lowering.drop_saturated {
                return Ok(passed.clone());
            }
            let dropped = self.dropped(lowering);
            let draft = self.origin.checked(&self.graph, Draft::new(passed.without_saturated(&dropped)))?;
            if let Some(program) = self.referee.proved_alike(draft, &dropped, passed) {
                return Ok(program);
            }
        }
        self.lowered(lowering)
    }

    /// How it is lowered: several values of a pixel are left out one by one.
    fn own(&self, lowering: Lowering) -> Lowering {
        Lowering { drop_saturated: lowering.drop_saturated && !self.is_joint(), ..lowering }
    }

    /// Several values of a pixel are summed.
    pub(crate) fn is_joint(&self) -> bool {
        self.referee.model().formulas.is_joint
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
        let draft = self.draft(lowering, self.budget())?;
        if let Some((program, _)) = self.proved(draft, lowering) {
            return Ok(program);
        }
        let budget = self.referee.model().budget();
        self.plainer(lowering, &budget).ok_or_else(|| match budget.is_spent() {
            true => self.origin.spent(&budget),
            false => self.origin.unproved(&self.referee),
        })
    }

    /// The budget for lowering it.
    fn budget(&self) -> Budget {
        self.paid.map_or_else(|| self.graph.budget().clone(), |units| Budget::with(AGAIN * units))
    }

    /// The loop nest before its check.
    fn draft(&self, lowering: Lowering, budget: Budget) -> Result<Draft, Diagnostics> {
        self.drafted(lowering, &mut self.graph.drawing_on(budget))
    }

    /// The same in a copy of the graph, which then knows what that took.
    fn drafted(&self, lowering: Lowering, graph: &mut Graph) -> Result<Draft, Diagnostics> {
        let draft = schedule::sums(graph, &self.sums, self.domain, lowering, self.names.clone());
        self.origin.checked(graph, draft)
    }

    fn proved(&self, draft: Draft, lowering: Lowering) -> Option<(Program, Errors)> {
        self.referee.proved(draft, &self.dropped(lowering))
    }

    /// Channels whose limit leaves a pixel out.
    fn dropped(&self, lowering: Lowering) -> Vec<ChannelId> {
        if lowering.drop_saturated { self.channels() } else { Vec::new() }
    }

    /// What the formulas make of a picture, for tests; see [`DirectSums`].
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

    /// The same sums in the plainest way that passes, on the document's budget: other forms, and none of them contracted.
    pub(crate) fn plainer(&self, lowering: Lowering, budget: &Budget) -> Option<Program> {
        let of = |objective: &Objective, lowering: Lowering| {
            let draft = objective.draft(lowering, budget.clone()).ok()?;
            objective.proved(draft, lowering).map(|(program, _)| program)
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

    /// Takes what is yet to come from the document's budget: the programs that callers ask for, once for all pixels and once
    /// without saturated ones, and the memory that stays in use. After that the objective is its holder's.
    fn paid(mut self, work: usize) -> Result<Objective, Diagnostics> {
        let mut budget = self.graph.budget().clone();
        self.paid = Some(work);
        self.graph.draw_on(self.budget());
        budget.charge(work);
        let instructions = self.checked.get().map_or(0, |program| program.instructions().len());
        let is_room = budget.keep(self.graph.len() + 2 * instructions);
        if budget.is_spent() || !is_room { Err(self.origin.spent(&budget)) } else { Ok(self) }
    }

    /// The same sums without pixels that are no number (NaN) in a channel that the sums read: those that a caller takes out
    /// of a picture.
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

    /// What the loop nest costs, F itself left out (the convention of the flops table).
    pub fn cost(&self, lowering: Lowering) -> Result<Cost, Diagnostics> {
        let mut graph = self.graph.drawing_on(self.budget());
        let mut sums = self.sums.clone();
        if sums.outputs.len() > self.values {
            sums.outputs.drain(..self.values);
        }
        let draft = schedule::sums(&mut graph, &sums, self.domain, self.own(lowering), self.names.clone());
        Ok(self.origin.checked(&graph, draft)?.cost())
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
        let values = values(&mut graph, model, Claim::Value(kind));
        let [full, chi] = full(&mut graph, model.formulas.shape(), &values, |value| value.variance);
        let mut outputs = match kind {
            ValueKind::Entry => vec![whole_output(&mut graph, "chi2", chi)],
            ValueKind::Full => vec![whole_output(&mut graph, "F", full), whole_output(&mut graph, "chi2", chi)],
        };
        outputs.extend(counted(&mut graph, &values));
        let names = model.names(outputs.iter().map(|o| o.name.clone()).collect()).into();
        let domain = entry_domain(&mut graph, model, Claim::Value(kind));
        let sums = FactoredSums { outputs, shift: None };
        let referee = referee(model, &[], Method::GaussNewton, Claim::Value(kind))?;
        let objective = Objective {
            referee,
            graph,
            sums,
            values: 0,
            subset: Vec::new(),
            names,
            domain,
            is_seeing: false,
            proof: None,
            paid: None,
            checked: OnceLock::new(),
            origin: WholeModel::of(model),
            forms: Vec::new(),
        };
        objective.measured()
    }

    /// Lowers it once, to know what that takes, and pays for it.
    pub(super) fn measured(self) -> Result<Objective, Diagnostics> {
        let mut graph = self.graph.copied();
        let before = graph.work();
        self.drafted(CHECKED, &mut graph)?;
        self.paid(graph.work() - before)
    }

    pub(crate) fn derive(model: &Model, subset: &[ParameterId], method: Method) -> Result<Objective, Diagnostics> {
        let claim = Claim::Derivatives { newton: method == Method::Newton, part: Part::Both };
        let referee = referee(model, subset, method, claim)?;
        let setting = DerivationSetting::of(&referee, subset, model.budget());
        let (budget, mut lowering) = (setting.graph.budget().clone(), 0);
        let mut candidate = |form: Form| -> Result<Objective, Refusal> {
            let mut objective = setting.objective(form).map_err(Refusal::Limit)?;
            // Others may draw on the budget at the same time: what counts is the graph's own work.
            let mut graph = objective.graph.drawing_on(budget.clone());
            let draft = objective.drafted(CHECKED, &mut graph).map_err(Refusal::Limit)?;
            lowering = graph.work();
            let Some((program, Errors { exact, error })) = objective.proved(draft, CHECKED) else {
                return Err(Refusal::Wrong);
            };
            objective.proof = Some(Proof { form, exact, error, f32_error: referee.f32_error(&program) });
            objective.checked = program.into();
            Ok(objective)
        };
        let found = safest(&mut candidate).map_err(|refusal| match refusal {
            Refusal::Limit(faults) => faults,
            Refusal::Wrong => WholeModel::of(model).unproved(&referee),
        });
        found.and_then(|objective| objective.paid(lowering))
    }

    /// What the check of the program found; `None` for a value objective.
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

/// What is derived from, the same for every form.
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
        let model = referee.model();
        let mut graph = model.formulas.graph.drawing_on(budget);
        let (newton, claim) = (referee.claim().is_newton(), referee.claim());
        let values = rewritten_values(&mut graph, model, claim, &|graph, node, is_held| {
            let node = reciprocals(graph, node);
            // What is predicted at the parameters themselves is written as the residual is, so that both are made of the same
            // values.
            let node = if !is_held || claim.is_at_entry() { gather(graph, node) } else { node };
            graph.set_opaque(node);
            node
        });
        let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let domain = entry_domain(&mut graph, model, claim);
        let reads_alike = !newton && !claim.is_at_entry() && values[0].variance.is_some();
        let region = domain.filter(|_| reads_alike).map(|domain| region(&mut graph.copied(), domain));
        let is_masked = region.is_some_and(|region| region.mask.is_some());
        let subset = subset.to_vec();
        DerivationSetting { is_masked, referee, graph, values, domain, subset, parameters, newton }
    }

    /// The sums in one form, not yet checked.
    pub(super) fn objective(&self, form: Form) -> Result<Objective, Diagnostics> {
        let (model, part) = (self.referee.model(), self.referee.claim().part().unwrap_or(Part::Both));
        let names: Vec<String> = self.subset.iter().map(|p| model.parameters[p.index()].name.clone()).collect();
        // Without noise the gradient is the same by both methods, and second derivatives are not wanted for it.
        let is_second = self.newton && (part.has_hessian() || self.values[0].variance.is_some());
        let order = if is_second { Order::Second } else { Order::First };
        let differentiand = Differentiand {
            parameters: &self.parameters,
            names: &names,
            values: self.values.clone(),
            is_opening: self.referee.claim().is_at_entry(),
            is_masked: self.is_masked,
            shape: model.formulas.shape(),
            order,
            part,
        };
        let derived = match form {
            Form::Factored => search::fewest_flops(&self.graph, &differentiand, Scaling::Unified),
            Form::Plain => search::fewest_flops(&self.graph, &differentiand, Scaling::AsWritten),
            Form::Unfactored => Derivation::new(self.graph.copied(), &differentiand, &Cuts::default(), By::Variables)
                .and_then(|mut derivation| derivation.unfactored().map(|sums| (derivation, sums))),
        };
        let origin = WholeModel::of(model);
        let (mut derivation, mut sums) = derived.ok_or_else(|| origin.outgrown(&self.graph, self.subset.len()))?;
        sums.outputs.extend(derivation.closing());
        Ok(Objective {
            names: model.names(sums.outputs.iter().map(|o| o.name.clone()).collect()).into(),
            sums,
            values: 1,
            referee: self.referee.clone(),
            subset: self.subset.clone(),
            domain: self.domain,
            is_seeing: false,
            origin,
            forms: derivation.forms,
            graph: derivation.graph,
            proof: None,
            paid: None,
            checked: OnceLock::new(),
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
