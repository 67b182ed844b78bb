//! Models derived from a model by adding parameters and constants: a background polynomial, or a common offset.

use std::sync::Arc;

use crate::graph::hyper::{Evaluator, Hyper, Order};
use crate::graph::random::Random;
use crate::graph::{Graph, Node, NodeId};
use crate::model::points::{NEAR, centre, plausible};
use crate::model::{Constant, Formulas, Method, Model, Observation, Parameter, Stage};
use crate::program::{Comparison, ConstantId, CoordinateId, Input, ParameterId};

/// Minimum share of a polynomial term that is independent of the model's own parameters.
const NEW: f64 = 1e-3;
/// Sample points along each coordinate for that test, and their reach, px.
const GRID: usize = 9;
const REACH_PX: f64 = 24.0;
/// Iterations of the one stage: nearly all fits that converge have done so after thirty, and the others never do.
const ITERATIONS: u32 = 40;

impl Model {
    /// The model with a polynomial in the first two coordinates added to its intensity, and with one stage, which frees
    /// the parameters of the last stage and the coefficients. Added constants: the polynomial's origin, one per
    /// coordinate, and the length that the coordinates are divided by, in px. Added parameters, which start at 0: a
    /// coefficient for each term that the model does not already have, in pixel values. The domain ends at most `reach`
    /// outlines from a centre, where centre and shape are parameters. Also returns the powers of the terms.
    pub fn with_background(&self, degree: u32, reach: f64) -> (Model, Vec<[u32; 2]>) {
        let mut model = self.clone();
        let axes = self.coordinates.len().min(2);
        let first = model.constants.len();
        let origins = (0..axes).map(|axis| (format!("background.origin{axis}"), 0.0));
        for (name, value) in origins.chain([("background.length".to_string(), 1.0)]) {
            model.constants.push(Constant { name, value, span: Default::default() });
        }
        let mut graph = model.formulas.graph.drawing_on(self.rewriting());
        let mut new = Vec::new();
        let terms = self.new_terms(degree, axes);
        let mut entries = model.formulas.entries.clone();
        for (number, entry) in entries.iter_mut().enumerate() {
            let mut sum = vec![(entry.intensity, 1.0)];
            for powers in &terms {
                let id = ParameterId(model.parameters.len() as u32);
                let name = format!("background.{number}.x{}y{}", powers[0], powers[1]);
                model.parameters.push(Parameter::added(name));
                new.push(id);
                let coefficient = graph.input(Input::Parameter(id));
                let mut factors = vec![(coefficient, 1)];
                for (axis, power) in powers.iter().enumerate().take(axes).filter(|(_, power)| **power > 0) {
                    factors.push((offset(&mut graph, first, axis, axes), *power as i32));
                }
                sum.push((graph.product(1.0, factors), 1.0));
            }
            let intensity = graph.sum(0.0, sum);
            graph.set_opaque(intensity);
            let noise = entry.noise.map(|noise| graph.replaced(noise, entry.intensity, intensity));
            *entry = Observation { intensity, noise, ..*entry };
        }
        let domain = self.near(&mut graph, reach);
        let formulas = Formulas { graph: Arc::new(graph), entries, domain, ..model.formulas };
        let mut free = self.stages.last().map_or_else(Vec::new, |stage| stage.parameters.clone());
        free.extend(new);
        let tolerance = self.stages.last().map_or(1e-3, |stage| stage.tolerance);
        let method = Method::LevenbergMarquardt;
        let stages = vec![Stage { parameters: free, method, iterations: ITERATIONS, tolerance }];
        (Model { formulas, stages, ..model }, terms)
    }

    /// The model with one more parameter, the last, in pixel values: it is added to the intensity of every entry of
    /// `observed`, and not to the intensity that the noise reads. No stage frees it.
    pub fn with_offset(&self) -> (Model, ParameterId) {
        let mut model = self.clone();
        let id = ParameterId(model.parameters.len() as u32);
        model.parameters.push(Parameter::added("common.offset".to_string()));
        let mut graph = model.formulas.graph.drawing_on(self.rewriting());
        let common = graph.input(Input::Parameter(id));
        let mut entries = model.formulas.entries.clone();
        for entry in &mut entries {
            entry.intensity = graph.add2(entry.intensity, common);
            graph.set_opaque(entry.intensity);
        }
        let formulas = Formulas { graph: Arc::new(graph), entries, ..model.formulas };
        (Model { formulas, ..model }, id)
    }

    /// The domain restricted to dᵀ A d ≤ reach² around a target.
    fn near(&self, graph: &mut Graph, reach: f64) -> Option<NodeId> {
        let n = self.coordinates.len();
        let mut any = None;
        for roles in &self.roles {
            if roles.centre.len() != n || roles.shape.len() != n * (n + 1) / 2 {
                return self.formulas.domain;
            }
            let input = |graph: &mut Graph, p: ParameterId| graph.input(Input::Parameter(p));
            let offsets: Vec<NodeId> = (0..n)
                .map(|axis| {
                    let (at, centre) = (graph.coordinate(CoordinateId(axis as u32)), input(graph, roles.centre[axis]));
                    graph.sub(at, centre)
                })
                .collect();
            let pairs = (0..n).flat_map(|i| (i..n).map(move |j| (i, j)));
            let mut terms = Vec::new();
            for ((i, j), entry) in pairs.zip(&roles.shape) {
                let entry = input(graph, *entry);
                let weight = if i == j { 1.0 } else { 2.0 };
                terms.push((graph.product(1.0, [(entry, 1), (offsets[i], 1), (offsets[j], 1)]), weight));
            }
            let (distance, most) = (graph.sum(0.0, terms), graph.number(reach * reach));
            let near = graph.compare(Comparison::Le, distance, most);
            any = Some(any.map_or(near, |any| graph.or(any, near)));
        }
        match (self.formulas.domain, any) {
            (Some(domain), Some(near)) => Some(graph.and(domain, near)),
            (domain, near) => near.or(domain),
        }
    }

    /// Powers of the terms up to a degree that the parameters of the last stage do not already span.
    fn new_terms(&self, degree: u32, axes: usize) -> Vec<[u32; 2]> {
        let mut terms = Vec::new();
        for total in 1..=degree {
            let of = |y: u32| [total - y, y];
            terms.extend((0..=total).map(of).filter(|powers| axes > 1 || powers[1] == 0));
        }
        if terms.is_empty() {
            return terms;
        }
        let mut graph = self.formulas.graph.drawing_on(self.rewriting());
        let free = self.stages.last().map_or(&[][..], |stage| &stage.parameters);
        let parameters: Vec<NodeId> = free.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let point = plausible(self, centre(self, NEAR), &mut Random(0));
        let inputs = |node: &Node| match node {
            Node::Input(input) => point.input(*input),
            _ => f64::NAN,
        };
        let roots = [self.formulas.entries[0].intensity];
        let mut evaluator = Evaluator::<Hyper<f64>>::new(&graph, &roots, &parameters, Order::First);
        evaluator.enter(&inputs);
        let middle = centre(self, NEAR);
        let step = |i: usize| REACH_PX * (i as f64 / (GRID - 1) as f64 - 0.5) * 2.0;
        let mut columns = vec![Vec::new(); free.len() + terms.len()];
        for index in 0..GRID.pow(axes as u32) {
            let place = [step(index % GRID), step(index / GRID)];
            let at = |c: usize| if c < axes { middle[c] + place[c] } else { middle[c] };
            let value = evaluator.at(&|node| match node {
                Node::Coordinate(c) => at(c.index()),
                node => inputs(node),
            });
            let slopes = value[0].gradients(free.len() as u16);
            columns.iter_mut().zip(slopes).for_each(|(column, slope)| column.push(slope));
            for (i, powers) in terms.iter().enumerate() {
                let monomial = (0..axes).map(|axis| (place[axis] / REACH_PX).powi(powers[axis] as i32)).product();
                columns[free.len() + i].push(monomial);
            }
        }
        let mut basis: Vec<Vec<f64>> = Vec::new();
        let mut kept = Vec::new();
        for (i, mut column) in columns.into_iter().enumerate() {
            let before = norm(&column);
            for known in &basis {
                let share: f64 = known.iter().zip(&column).map(|(a, b)| a * b).sum();
                column.iter_mut().zip(known).for_each(|(value, known)| *value -= share * known);
            }
            let rest = norm(&column);
            if rest > NEW * before && rest.is_finite() {
                column.iter_mut().for_each(|value| *value /= rest);
                basis.push(column);
                kept.extend(i.checked_sub(free.len()).map(|term| terms[term]));
            }
        }
        kept
    }
}

/// (coordinate − origin) / length.
fn offset(graph: &mut Graph, first: usize, axis: usize, axes: usize) -> NodeId {
    let constant = |graph: &mut Graph, i: usize| graph.input(Input::Constant(ConstantId((first + i) as u32)));
    let (origin, length) = (constant(graph, axis), constant(graph, axes));
    let coordinate = graph.coordinate(CoordinateId(axis as u32));
    let difference = graph.sub(coordinate, origin);
    graph.div(difference, length)
}

fn norm(column: &[f64]) -> f64 {
    column.iter().map(|value| value * value).sum::<f64>().sqrt()
}
