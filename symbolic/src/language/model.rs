//! `Model`: a checked document. What comes in: TOML or JSON. What goes out: parameters, roles, stages, and the graph of
//! its formulas, ready to be differentiated. Only [`crate::language::reader`] can make one.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::language::budget::Budget;
use crate::language::estimator::Estimator;
use crate::language::graph::{Graph, Node, NodeId};
use crate::program::{ChannelId, ConstantId, Input, Level, Names, ParameterId};
use isophote_syntax::diagnostic::Span;

/// An unknown of the fit.
#[derive(Clone, PartialEq, Debug)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Where a cold start takes its value from.
    pub start: Start,
    /// Numbers that a cold start tries as well.
    pub others: Vec<f64>,
    /// Lower bound; starts are above it, a fit may end there.
    pub min: Option<f64>,
    /// Upper bound.
    pub max: Option<f64>,
    /// For display.
    pub unit: Option<String>,
    /// Its key in the document.
    pub span: Span,
}

impl Parameter {
    /// One that no document has: it starts at 0.
    pub(crate) fn added(name: String) -> Parameter {
        let (start, span) = (Start::Number(0.0), Span::default());
        Parameter { name, start, others: Vec::new(), min: None, max: None, unit: None, span }
    }
}

/// The start of a parameter.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Start {
    /// A number.
    Number(f64),
    /// Found in the image.
    Estimator(Estimator),
}

/// A number given by session or camera.
#[derive(Clone, PartialEq, Debug)]
pub struct Constant {
    /// Its name.
    pub name: String,
    /// The document's default.
    pub value: f64,
    /// Its key in the document.
    pub span: Span,
}

/// What parameters mean to the tracker, for one target.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Roles {
    /// `None` for the plain `[roles]`.
    pub name: Option<String>,
    /// One a coordinate, or empty.
    pub centre: Vec<ParameterId>,
    /// The upper triangle of A, row by row (the outline is dᵀ A d = 1), or empty: a1, a2, a3 in two dimensions; xx, xy,
    /// xz, yy, yz, zz in three.
    pub shape: Vec<ParameterId>,
    /// Background level.
    pub background: Option<ParameterId>,
    /// Height over the background.
    pub brightness: Option<ParameterId>,
    /// The target's origin in the camera's frame, mm: three, or empty.
    pub position: Vec<ParameterId>,
    /// Modified Rodrigues parameters of the rotation from target axes to camera axes: three, two (the third is 0: one round
    /// spot, whose spin nothing shows), or empty.
    pub orientation: Vec<ParameterId>,
}

/// How a stage steps.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The full Hessian.
    Newton,
    /// JᵀWJ for the Hessian.
    GaussNewton,
    /// As Gauss–Newton, damped from the start.
    LevenbergMarquardt,
}

impl Method {
    /// The name in a document.
    pub fn name(self) -> &'static str {
        match self {
            Method::Newton => "newton",
            Method::GaussNewton => "gauss-newton",
            Method::LevenbergMarquardt => "levenberg-marquardt",
        }
    }
}

/// How residuals count.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub enum Loss {
    /// Their square.
    #[default]
    Squares,
    /// Huber's: beyond c standard deviations linearly.
    Huber(f64),
    /// Tukey's biweight: beyond c standard deviations not at all.
    Tukey(f64),
}

/// How a pixel's prediction is averaged over its area.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Quadrature {
    /// So many Gauss points a side; 1 is the pixel's centre.
    Points(usize),
    /// Chosen for each fit; without a choice [`Quadrature::AUTO`] points.
    Auto,
}

impl Quadrature {
    /// Points a side of what is derived of a model that leaves the choice open.
    pub const AUTO: usize = 2;

    /// Points a side.
    pub fn points(self) -> usize {
        match self {
            Quadrature::Points(points) => points,
            Quadrature::Auto => Quadrature::AUTO,
        }
    }

    /// Nodes and weights of Gauss and Legendre's rule along one side of a pixel: places from its middle, px, −½ … ½; the weights
    /// add up to 1.
    pub fn rule(points: usize) -> Vec<(f64, f64)> {
        let legendre = |x: f64| {
            let (mut before, mut now) = (1.0, x);
            for k in 2..=points {
                let k = k as f64;
                (before, now) = (now, ((2.0 * k - 1.0) * x * now - (k - 1.0) * before) / k);
            }
            (now, points as f64 * (x * now - before) / (x * x - 1.0))
        };
        let node = |i: usize| {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (points as f64 + 0.5)).cos();
            for _ in 0..8 {
                let (value, slope) = legendre(x);
                x -= value / slope;
            }
            // The middle one of an odd number is 0 itself.
            let x = if 2 * i + 1 == points { 0.0 } else { x };
            let (_, slope) = legendre(x);
            (0.5 * x, 1.0 / ((1.0 - x * x) * slope * slope))
        };
        (0..points).map(node).collect()
    }
}

impl Default for Quadrature {
    fn default() -> Quadrature {
        Quadrature::Points(1)
    }
}

/// What becomes of a pixel at its channel's limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Saturated {
    /// It is left out.
    #[default]
    Dropped,
    /// It is left out where it is predicted to be near the limit, whatever it shows.
    Predicted,
    /// It says that there was at least that much light.
    Censored,
}

/// One step of the schedule.
#[derive(Clone, PartialEq, Debug)]
pub struct Stage {
    /// The free parameters, in the order written.
    pub parameters: Vec<ParameterId>,
    /// How it steps.
    pub method: Method,
    /// At most so many steps.
    pub iterations: u32,
    /// It ends when every |δ|/σ is at most this.
    pub tolerance: f64,
}

/// How a program is to be lowered.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Lowering {
    /// Contract a · b + c (the processor has fused multiply-add).
    pub fma: bool,
    /// Leave out and count pixels at or above their channel's limit.
    pub drop_saturated: bool,
}

/// The formulas of a model, as nodes: those of one entry of `observed`, the first as a rule.
#[derive(Clone, Debug)]
pub(crate) struct Formulas {
    pub graph: Arc<Graph>,
    pub observed: NodeId,
    /// The mean over the pixel's Gauss points.
    pub intensity: NodeId,
    /// The intensity at a point: what is rendered.
    pub shown: NodeId,
    pub domain: Option<NodeId>,
    pub noise: Option<NodeId>,
    pub constraints: Vec<NodeId>,
    pub loss: Loss,
    pub saturated: Saturated,
    /// The share of pixels that are at their limit whatever the light, where pixels there are censored.
    pub defects: Option<ConstantId>,
    pub quadrature: Quadrature,
    /// The root mean square of a target's profile less the formula, over its height.
    pub deviation: Option<f64>,
    /// Only pixels at this channel's limit.
    pub clipped: Option<ChannelId>,
    /// All entries of `observed`; never empty.
    pub entries: Vec<Observation>,
    /// Models whose F add up to the document's, this one among them.
    pub siblings: usize,
    /// F is that of all entries, in one loop.
    pub is_joint: bool,
}

/// One entry of `observed` and its prediction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub observed: NodeId,
    pub intensity: NodeId,
    pub shown: NodeId,
    pub noise: Option<NodeId>,
}

impl Formulas {
    /// The same for another entry of `observed`.
    pub fn of_entry(&self, Observation { observed, intensity, shown, noise }: Observation) -> Formulas {
        let entries = vec![Observation { observed, intensity, shown, noise }];
        Formulas { observed, intensity, shown, noise, entries, ..self.clone() }
    }

    /// The entries whose F is summed.
    pub fn summed(&self) -> Vec<Observation> {
        let Formulas { observed, intensity, shown, noise, .. } = *self;
        if self.is_joint { self.entries.clone() } else { vec![Observation { observed, intensity, shown, noise }] }
    }

    /// True when each entry is a channel that nothing else of a pixel's F reads, and what is predicted of one is mostly what is
    /// predicted of the others.
    fn shares_work(&self) -> bool {
        let graph = &self.graph;
        let is_apart = |entry: &Observation| {
            let reads = |node: NodeId| graph.channels(&[node]);
            let corrected = reads(entry.intensity);
            let is_own = |channel: &ChannelId| reads(entry.observed) == [*channel] || corrected.contains(channel);
            matches!(graph.node(entry.observed), Node::Channel(_))
                && reads(entry.shown).is_empty()
                && entry.noise.is_none_or(|noise| reads(noise).iter().all(is_own))
        };
        let pixels = |roots: &[NodeId]| {
            graph.reachable(roots).into_iter().filter(|node| graph.level(*node) == Level::Pixel).count()
        };
        let intensities: Vec<NodeId> = self.entries.iter().map(|entry| entry.intensity).collect();
        let apart: usize = intensities.iter().map(|intensity| pixels(&[*intensity])).sum();
        self.saturated != Saturated::Predicted
            && self.entries.iter().all(is_apart)
            && SHARED * pixels(&intensities) as f64 <= apart as f64
    }
}

/// Values of a pixel are summed in one loop where their predictions, each by itself, have so many times the operations of all.
const SHARED: f64 = 1.5;

/// A part of a model's F; see [`Model::summands`].
#[derive(Clone, Debug)]
pub struct Summand {
    /// The model whose F it is.
    pub model: Model,
    /// It sums pixels at their limit, and no others.
    pub is_clipped: bool,
    /// Values of a pixel that it sums.
    pub entries: usize,
}

impl Summand {
    /// One summand for all of those of pixels below their limit, where a document mixes several channels, so that their
    /// predictions share work: what is predicted of all of them is worked out once. Behind its sums stand two more: how many
    /// values of pixels it summed, and how many are at their limit. It leaves those out itself, each channel for its own,
    /// whatever it is lowered for, and what is no number as well.
    pub fn joint(summands: &[Summand]) -> Option<Summand> {
        let seen: Vec<&Model> = summands.iter().filter(|s| !s.is_clipped).map(|s| &s.model).collect();
        let [first, _, ..] = seen[..] else { return None };
        let entries: Vec<Observation> = seen.iter().flat_map(|model| model.formulas.entries.iter().copied()).collect();
        let entries_count = entries.len();
        let formulas = Formulas { entries, is_joint: true, ..first.formulas.clone() };
        let is_worth_it = formulas.shares_work();
        let model = Model { formulas, ..Model::clone(first) };
        is_worth_it.then_some(Summand { model, is_clipped: false, entries: entries_count })
    }
}

/// A checked document.
#[derive(Clone, Debug)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) description: String,
    pub(crate) text: Arc<str>,
    pub(crate) places: crate::language::places::Places,
    pub(crate) coordinates: Vec<String>,
    pub(crate) channels: Vec<String>,
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) constants: Vec<Constant>,
    pub(crate) roles: Vec<Roles>,
    pub(crate) stages: Vec<Stage>,
    pub(crate) document: Arc<serde_json::Value>,
    pub(crate) digest: String,
    pub(crate) formulas: Formulas,
    /// Units of work that reading it took.
    pub(crate) reading: usize,
    /// What is derived draws on it; absent, each derivation has a budget of its own.
    pub(crate) budget: Option<Budget>,
}

impl Model {
    /// Deviations that a document may state: smaller ones do not show in 8 bits, and with a larger one it is another target.
    pub const DEVIATION: std::ops::RangeInclusive<f64> = 0.001..=0.2;

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }
    /// A sentence for people.
    pub fn description(&self) -> &str {
        &self.description
    }
    /// Names, inner loop first.
    pub fn coordinates(&self) -> &[String] {
        &self.coordinates
    }
    /// Names of the raw planes.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }
    /// In document order.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }
    /// In document order.
    pub fn constants(&self) -> &[Constant] {
        &self.constants
    }
    /// The parameter of that name.
    pub fn parameter(&self, name: &str) -> Option<ParameterId> {
        self.parameters.iter().position(|p| p.name == name).map(|i| ParameterId(i as u32))
    }
    /// The constant of that name.
    pub fn constant(&self, name: &str) -> Option<ConstantId> {
        self.constants.iter().position(|c| c.name == name).map(|i| ConstantId(i as u32))
    }
    /// One a target; never empty.
    pub fn roles(&self) -> &[Roles] {
        &self.roles
    }
    /// The schedule; never empty.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
    /// The document as JSON with sorted keys.
    pub fn document(&self) -> &serde_json::Value {
        &self.document
    }
    /// `sha256:` of [`Model::document`] without blanks.
    pub fn digest(&self) -> &str {
        &self.digest
    }
    /// True when the document gives the variance of a pixel.
    pub fn has_noise(&self) -> bool {
        self.formulas.noise.is_some()
    }
    /// The share of defects among pixels, where pixels at their limit may be some.
    pub fn defects(&self) -> Option<ConstantId> {
        self.formulas.defects
    }
    /// What becomes of pixels at their limit.
    pub fn saturated(&self) -> Saturated {
        self.formulas.saturated
    }
    /// How a pixel's prediction is averaged over its area.
    pub fn quadrature(&self) -> Quadrature {
        self.formulas.quadrature
    }
    /// The stated root mean square of a target's profile less the formula, as a share of its height.
    pub fn deviation(&self) -> Option<f64> {
        self.formulas.deviation
    }
    /// Entries of `observed`: values that a pixel is fitted by.
    pub fn entries(&self) -> usize {
        self.formulas.entries.len()
    }

    /// Models whose F add up to this one's: one for each entry of `observed`, this model itself when there is one only,
    /// each followed by one of the pixels at their limit where those are censored. What is derived from a model is of
    /// its first entry, and of pixels below their limit.
    ///
    /// They share one budget, [`crate::LIMITS`]`.work`: so much is derived of all of them together, for all stages, and then
    /// no more. Whoever derives a whole schedule takes the summands once.
    pub fn summands(&self) -> Vec<Summand> {
        let mut summands = Vec::new();
        let budget = Some(Budget::after(self.reading));
        let siblings = self.siblings();
        for entry in &self.formulas.entries {
            let formulas = Formulas { siblings, ..self.formulas.of_entry(*entry) };
            let clipped = match (self.formulas.saturated, formulas.graph.node(entry.observed)) {
                (Saturated::Censored, Node::Channel(channel)) => {
                    Some(Formulas { clipped: Some(*channel), ..formulas.clone() })
                }
                _ => None,
            };
            let of = |formulas: Formulas, is_clipped| {
                let budget = budget.clone();
                Summand { model: Model { formulas, budget, ..self.clone() }, is_clipped, entries: 1 }
            };
            summands.push(of(formulas, false));
            summands.extend(clipped.map(|formulas| of(formulas, true)));
        }
        summands
    }

    /// How many models' F the document's is the sum of.
    pub(crate) fn siblings(&self) -> usize {
        let each = if self.formulas.saturated == Saturated::Censored { 2 } else { 1 };
        self.formulas.siblings.max(each * self.formulas.entries.len())
    }

    /// The parameter nearest in spelling, for messages.
    pub fn nearest_name(&self, name: &str) -> Option<&str> {
        let names =
            self.parameters.iter().map(|p| p.name.as_str()).chain(self.constants.iter().map(|c| c.name.as_str()));
        isophote_syntax::diagnostic::Spellings::default().nearest(name, names)
    }

    /// True when every bound, itself included, and every constraint holds; false for NaN.
    pub fn constraints_hold(&self, parameters: &[f64], constants: &[f64]) -> bool {
        let bounded = |(p, value): (&Parameter, &f64)| {
            p.min.is_none_or(|min| *value >= min) && p.max.is_none_or(|max| *value <= max) && value.is_finite()
        };
        let leaf = |node: &Node| match node {
            Node::Input(Input::Parameter(p)) => parameters[p.index()],
            Node::Input(Input::Constant(c)) => constants[c.index()],
            _ => f64::NAN,
        };
        self.parameters.iter().zip(parameters).all(bounded)
            && self.formulas.constraints.iter().all(|c| self.formulas.graph.evaluate(*c, &leaf) == 1.0)
    }

    /// `observed` of one pixel, from the values of its channels; the sum of its entries.
    pub fn observed(&self, channels: &[f64], constants: &[f64]) -> f64 {
        let leaf = |node: &Node| match node {
            Node::Channel(c) => channels[c.index()],
            Node::Input(Input::Constant(c)) => constants[c.index()],
            _ => f64::NAN,
        };
        self.formulas.entries.iter().map(|entry| self.formulas.graph.evaluate(entry.observed, &leaf)).sum()
    }

    /// True when the model says something about a place: no domain, or one that holds there. One value a coordinate.
    pub fn domain_holds(&self, place: &[f64], parameters: &[f64], constants: &[f64]) -> bool {
        self.formulas.domain.is_none_or(|domain| self.at_place(domain, place, parameters, constants) == 1.0)
    }

    /// What a derivation may cost.
    pub(crate) fn budget(&self) -> Budget {
        self.budget.clone().unwrap_or_else(|| Budget::after(self.reading))
    }

    /// What it may cost to rewrite the formulas: at most as much as to make them, and to add a few to each.
    pub(crate) fn rewriting(&self) -> Budget {
        Budget::with(2 * self.reading + 4 * self.formulas.graph.len() + 4096)
    }

    /// What its programs call everything.
    pub fn names(&self, outputs: Vec<String>) -> Names {
        Names {
            coordinates: self.coordinates.clone(),
            channels: self.channels.clone(),
            parameters: self.parameters.iter().map(|p| p.name.clone()).collect(),
            constants: self.constants.iter().map(|c| c.name.clone()).collect(),
            outputs,
        }
    }
}
