//! `Model`: a checked document with parameters, roles, stages, and the graph of its formulas, ready to be
//! differentiated. Only a text without errors becomes one. This folder knows no text formats and no derivatives: it
//! evaluates the formulas at single positions, adds backgrounds and offsets to them, and makes up points at which they
//! are compared.

pub(crate) mod corrected;
pub(crate) mod entry;
pub(crate) mod estimator;
mod places;
pub(crate) mod points;
pub(crate) mod remark;
pub(crate) mod sample;
mod summand;
pub(crate) mod variant;
mod whole_model;

pub use summand::Summand;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::graph::budget::Budget;
use crate::graph::{Graph, Node, NodeId};
use crate::model::estimator::Estimator;
use crate::program::{ConstantId, Input, Names, ParameterId};
use isophote_syntax::diagnostic::Span;

/// An unknown of the fit.
#[derive(Clone, PartialEq, Debug)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Source of its value at a cold start.
    pub start: Start,
    /// Further values that a cold start tries.
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
    /// A parameter outside any document; starts at 0.
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
    /// Estimated from the image.
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

/// Roles of parameters in the tracker, for one target.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Roles {
    /// `None` for the plain `[roles]`.
    pub name: Option<String>,
    /// One per coordinate, or empty.
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
    /// Modified Rodrigues parameters of the rotation from target axes to camera axes: three, two (the third is 0: the
    /// spin of one round spot is not observable), or empty.
    pub orientation: Vec<ParameterId>,
}

/// Optimisation method of a stage.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Uses the full Hessian.
    Newton,
    /// JᵀWJ approximates the Hessian.
    GaussNewton,
    /// As Gauss–Newton, damped from the first step.
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

/// Loss function of residuals.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub enum Loss {
    /// Their square.
    #[default]
    Squares,
    /// Huber's: linear beyond c standard deviations.
    Huber(f64),
    /// Tukey's biweight: no weight beyond c standard deviations.
    Tukey(f64),
}

/// How a pixel's prediction is averaged over its area.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Quadrature {
    /// Gauss points per side; 1 is the pixel's centre.
    Points(usize),
    /// Chosen for each fit; by default [`Quadrature::AUTO`] points.
    Auto,
}

impl Quadrature {
    /// Points per side of derivations from a model with [`Quadrature::Auto`].
    pub const AUTO: usize = 2;

    /// Points per side.
    pub fn points(self) -> usize {
        match self {
            Quadrature::Points(points) => points,
            Quadrature::Auto => Quadrature::AUTO,
        }
    }

    /// Nodes and weights of Gauss–Legendre quadrature along one side of a pixel: offsets from its middle, px, −½ … ½;
    /// the weights add up to 1.
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
            // The middle node of an odd number is exactly 0.
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

/// Treatment of a pixel at its channel's limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Saturated {
    /// Left out.
    #[default]
    Dropped,
    /// Left out where the prediction is near the limit, whatever the pixel's value.
    Predicted,
    /// A lower bound on the light.
    Censored,
}

/// One step of the schedule.
#[derive(Clone, PartialEq, Debug)]
pub struct Stage {
    /// The free parameters, in the order written.
    pub parameters: Vec<ParameterId>,
    /// Step method.
    pub method: Method,
    /// Maximum number of steps.
    pub iterations: u32,
    /// Ends when every |δ|/σ is at most this.
    pub tolerance: f64,
}

/// The formulas of a model, as nodes.
#[derive(Clone, Debug)]
pub(crate) struct Formulas {
    pub graph: Arc<Graph>,
    /// The entries of `observed`; never empty.
    pub entries: Vec<Observation>,
    pub domain: Option<NodeId>,
    pub constraints: Vec<NodeId>,
    pub loss: Loss,
    pub saturated: Saturated,
    /// Share of pixels at their limit whatever the light, for censored pixels.
    pub defects: Option<ConstantId>,
    pub quadrature: Quadrature,
    /// RMS deviation of a target's profile from the formula, over its height.
    pub deviation: Option<f64>,
}

/// One entry of `observed` and its prediction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub observed: NodeId,
    /// The mean over the pixel's Gauss points.
    pub intensity: NodeId,
    /// The intensity at a point, for rendering.
    pub shown: NodeId,
    pub noise: Option<NodeId>,
}

/// The strings of a document with their keys, in document order.
pub(crate) type Places = Arc<[(Span, String)]>;

/// Numbers for the leaves of formulas, by position; a missing one is NaN.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Leaves<'a> {
    /// One number a coordinate.
    pub place: &'a [f64],
    pub channels: &'a [f64],
    pub parameters: &'a [f64],
    pub constants: &'a [f64],
}

impl Leaves<'_> {
    pub fn value(&self, node: &Node) -> f64 {
        let number = match node {
            Node::Coordinate(c) => self.place.get(c.index()),
            Node::Channel(c) => self.channels.get(c.index()),
            Node::Input(Input::Parameter(p) | Input::Entry(p)) => self.parameters.get(p.index()),
            Node::Input(Input::Constant(c)) => self.constants.get(c.index()),
            _ => None,
        };
        number.copied().unwrap_or(f64::NAN)
    }
}

/// A checked document.
#[derive(Clone, Debug)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) description: String,
    pub(crate) text: Arc<str>,
    pub(crate) places: Places,
    pub(crate) coordinates: Vec<String>,
    pub(crate) channels: Vec<String>,
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) constants: Vec<Constant>,
    pub(crate) roles: Vec<Roles>,
    pub(crate) stages: Vec<Stage>,
    pub(crate) document: Arc<serde_json::Value>,
    pub(crate) digest: String,
    pub(crate) formulas: Formulas,
    /// Units of work spent on reading.
    pub(crate) reading: usize,
}

impl Model {
    /// Allowed deviations: smaller ones do not show in 8 bits, larger ones mean another target.
    pub const DEVIATION: std::ops::RangeInclusive<f64> = 0.001..=0.2;

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }
    /// Its description.
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
    /// One per target; never empty.
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
        self.formulas.entries[0].noise.is_some()
    }
    /// The constant with the share of defective pixels, where pixels at their limit may be some.
    pub fn defects(&self) -> Option<ConstantId> {
        self.formulas.defects
    }
    /// Treatment of pixels at their limit.
    pub fn saturated(&self) -> Saturated {
        self.formulas.saturated
    }
    /// How a pixel's prediction is averaged over its area.
    pub fn quadrature(&self) -> Quadrature {
        self.formulas.quadrature
    }
    /// Stated RMS deviation of a target's profile from the formula, as a share of its height.
    pub fn deviation(&self) -> Option<f64> {
        self.formulas.deviation
    }
    /// Number of entries of `observed`: values fitted per pixel.
    pub fn entries(&self) -> usize {
        self.formulas.entries.len()
    }

    /// The parameter or constant nearest in spelling, for messages.
    pub fn nearest_name(&self, name: &str) -> Option<&str> {
        let names =
            self.parameters.iter().map(|p| p.name.as_str()).chain(self.constants.iter().map(|c| c.name.as_str()));
        isophote_syntax::diagnostic::Spellings::default().nearest(name, names)
    }

    /// True when every bound (inclusive) and every constraint holds; false for NaN.
    pub fn constraints_hold(&self, parameters: &[f64], constants: &[f64]) -> bool {
        let bounded = |(p, value): (&Parameter, &f64)| {
            p.min.is_none_or(|min| *value >= min) && p.max.is_none_or(|max| *value <= max) && value.is_finite()
        };
        let leaf = Leaves { parameters, constants, ..Leaves::default() };
        self.parameters.iter().zip(parameters).all(bounded)
            && self
                .formulas
                .constraints
                .iter()
                .all(|c| self.formulas.graph.evaluate(*c, &|node| leaf.value(node)) == 1.0)
    }

    /// `observed` of one pixel from its channel values; the sum of its entries.
    pub fn observed(&self, channels: &[f64], constants: &[f64]) -> f64 {
        self.observed_of(&self.formulas.entries, channels, constants)
    }

    /// The sum of some entries of `observed`, of one pixel.
    pub(crate) fn observed_of(&self, entries: &[Observation], channels: &[f64], constants: &[f64]) -> f64 {
        let leaf = Leaves { channels, constants, ..Leaves::default() };
        let observed = entries.iter().map(|entry| entry.observed);
        observed.map(|node| self.formulas.graph.evaluate(node, &|node| leaf.value(node))).sum()
    }

    /// True when there is no domain or it holds at `place`, which has one value per coordinate.
    pub fn domain_holds(&self, place: &[f64], parameters: &[f64], constants: &[f64]) -> bool {
        self.formulas.domain.is_none_or(|domain| self.at_place(domain, place, parameters, constants) == 1.0)
    }

    /// Budget of rewriting the formulas: twice the work of reading them, and 4 units per node.
    pub(crate) fn rewriting(&self) -> Budget {
        Budget::with(2 * self.reading + 4 * self.formulas.graph.len() + 4096)
    }

    /// Names for its programs.
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
