//! The subject of a program's sums, and their reference values at a point in any arithmetic: forward differentiation,
//! pixel by pixel. Independent of the derivation; it also evaluates a program at the same point.

use isophote_elementary::Function1;

use crate::graph::hyper::{Bare, Evaluator, Hyper, Order, Values};
use crate::graph::{Graph, Node, NodeId};
use crate::likelihood::claim::{Claim, Part, ValueKind};
use crate::likelihood::shape::Shape;
use crate::likelihood::terms::{PixelValue, counts, entry_domain, values};
use crate::model::points::Point;
use crate::model::{Loss, Model, Summand};
use crate::program::{Input, ParameterId};
use crate::proof::LARGEST;
use crate::proof::evaluate::{ByLevel, Number, Raster, evaluate_at};
use crate::proof::weighed::Weighed;
use isophote_syntax::diagnostic::Diagnostics;

/// Largest ratio of a prediction to a residual at which f64 still decides the residual's side of a threshold.
const CERTAIN: f64 = 1e10;

/// The sums as the document states them, without any rewrite.
#[derive(Clone, Debug)]
pub(crate) struct Subject {
    pub summand: Summand,
    pub graph: Graph,
    /// Never empty; all have the same nodes.
    pub values: Vec<PixelValue>,
    /// Two indicators a value, if values are masked: 1 below the limit, and 1 at it.
    pub counts: Vec<NodeId>,
    pub shape: Shape,
    pub domain: Option<NodeId>,
    pub parameters: Vec<NodeId>,
    pub claim: Claim,
}

impl Subject {
    /// The subject of the sums over a subset of the parameters.
    pub fn of(summand: &Summand, subset: &[ParameterId], claim: Claim) -> Result<Subject, Diagnostics> {
        let mut graph = summand.model().formulas.graph.drawing_on(summand.budget());
        let values = values(&mut graph, summand, claim);
        let parameters = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let counts = counts(&mut graph, &values);
        let (domain, shape) = (entry_domain(&mut graph, summand, claim), summand.shape());
        if graph.overflowed() {
            return Err(summand.outgrown(&graph, subset.len()));
        }
        Ok(Subject { summand: summand.clone(), graph, values, counts, shape, domain, parameters, claim })
    }

    pub(super) fn model(&self) -> &Model {
        self.summand.model()
    }

    pub(super) fn roots(&self) -> Vec<NodeId> {
        self.values.iter().flat_map(PixelValue::nodes).chain(self.counts.iter().copied()).collect()
    }

    /// Number of nodes of each value.
    fn nodes_each(&self) -> usize {
        self.values[0].nodes().count()
    }

    /// Number of outputs.
    pub(super) fn outputs(&self) -> usize {
        let n = self.parameters.len();
        let derivatives = self.claim.part().map_or(0, |part| {
            let entries = |row| (row..n).filter(move |column| part.has_entry(row, *column));
            usize::from(part.has_gradient()) * n + (0..n).flat_map(entries).count()
        });
        let values = match self.claim {
            Claim::Derivatives { .. } | Claim::Opening | Claim::Value(ValueKind::Entry) => 1,
            Claim::Value(ValueKind::Full) => 2,
            Claim::Closing => 3,
        };
        values + derivatives + self.counted()
    }

    /// Number of counts, which follow the other outputs.
    fn counted(&self) -> usize {
        if self.counts.is_empty() { 0 } else { 2 }
    }

    /// Fills the point's pixels with values whose residuals lie near a robust loss' threshold, on both sides of it;
    /// false where rounding of much larger numbers may decide the side.
    pub(super) fn show_threshold(&self, evaluator: &mut Values<'_, f64>, point: &mut Point<f64>) -> bool {
        let threshold = match self.shape {
            Shape::Seen(Loss::Huber(c) | Loss::Tukey(c)) | Shape::Clipped(Loss::Huber(c) | Loss::Tukey(c), _) => c,
            Shape::Seen(Loss::Squares) | Shape::Clipped(Loss::Squares, _) => 1.0,
        };
        // Zero pixels make the residual −intensity, as far as observed values are pixels.
        let (mut pixels, mut are_sure) = (Vec::new(), true);
        evaluator.enter(&|node| point.given(node));
        for (outer, x) in point.rows.iter().flat_map(|outer| point.columns.iter().map(move |x| (outer, *x))) {
            let values = evaluator.at(&|node| point.read(node, x, outer, &|_| 0.0));
            let mut shown = |value: &[&Bare<f64>]| {
                let deviation = value.get(1).map_or(1.0, |variance| variance.value.sqrt());
                let side = if pixels.len() % 2 == 0 { 1.03 } else { 0.97 };
                are_sure &= value[0].value.abs() < CERTAIN * threshold * deviation;
                side * threshold * deviation - value[0].value
            };
            let each = values[..self.nodes_each() * self.values.len()].chunks(self.nodes_each());
            let each: Vec<f64> = each.map(&mut shown).collect();
            pixels.push(each);
        }
        let channels = 0..self.model().channels.len();
        let of = |channel: usize| pixels.iter().map(move |each| each[channel.min(each.len() - 1)]);
        point.pixels = channels.flat_map(of).collect();
        are_sure
    }

    /// The sums over pixels that take part, with their terms. `None` where they are no evidence: a robust loss turns
    /// NaN into a number, or a value is too large for its powers.
    pub(super) fn weighed(
        &self,
        evaluator: &mut Evaluator<'_, Hyper<Weighed>>,
        point: &Point<f64>,
        takes_part: impl Fn(usize, usize) -> bool,
    ) -> Option<Vec<Weighed>> {
        let is_ordinary = |values: &[&Hyper<Weighed>]| values.iter().all(|x| x.value.value.abs() < LARGEST);
        let sums = self.summed(evaluator, &point.map(Weighed::from), takes_part, is_ordinary)?;
        sums.iter().all(|x| x.value.is_finite() && x.terms < LARGEST).then_some(sums)
    }

    /// The order of differentiation of the formulas.
    pub(super) fn order(&self) -> Order {
        if self.claim.is_newton() { Order::Second } else { Order::First }
    }

    /// Evaluates the formulas with their derivatives, at successive points.
    pub(super) fn evaluator<N: Number>(&self) -> Evaluator<'_, Hyper<N>> {
        Evaluator::new(&self.graph, &self.roots(), &self.parameters, self.order())
    }

    /// The same without derivatives.
    pub(super) fn values(&self) -> Values<'_, f64> {
        Evaluator::new(&self.graph, &self.roots(), &[], Order::First)
    }

    /// The sums by the document's formulas, over the point's pixels that take part.
    pub(super) fn direct<N: Number>(&self, point: &Point<N>, takes_part: impl Fn(usize, usize) -> bool) -> Vec<N> {
        self.summed(&mut self.evaluator(), point, takes_part, |_| true).unwrap_or_default()
    }

    /// The same; `None` where the values of a pixel that takes part are no evidence.
    pub(super) fn summed<N: Number>(
        &self,
        evaluator: &mut Evaluator<'_, Hyper<N>>,
        point: &Point<N>,
        takes_part: impl Fn(usize, usize) -> bool,
        is_evidence: impl Fn(&[&Hyper<N>]) -> bool,
    ) -> Option<Vec<N>> {
        evaluator.enter(&|node| point.given(node));
        let share = self.model().formulas.defects.map(|constant| point.constants[constant.index()]);
        let mut sums = vec![N::from(0.0); self.outputs()];
        for (row, outer) in point.rows.iter().enumerate() {
            for (column, x) in point.columns.iter().enumerate() {
                if !takes_part(column, row) {
                    continue;
                }
                let pixel = |channel| point.pixel(channel, column, row);
                let values = evaluator.at(&|node| point.read(node, *x, outer, &pixel));
                if !is_evidence(&values) {
                    return None;
                }
                let entries = self.entries(&values, share);
                sums.iter_mut().zip(entries).for_each(|(sum, entry)| *sum = *sum + entry);
            }
        }
        Some(sums)
    }

    /// The summands of one pixel.
    fn entries<N: Number>(&self, values: &[&Hyper<N>], share: Option<N>) -> Vec<N> {
        let (of_values, counts) = values.split_at(self.nodes_each() * self.values.len());
        let each = of_values.chunks(self.nodes_each());
        if counts.is_empty() {
            return each.flat_map(|value| self.entries_of(value, share)).collect();
        }
        let mut entries = vec![N::from(0.0); self.outputs() - self.counted()];
        let mut counted = [N::from(0.0); 2];
        for (value, count) in each.zip(counts.chunks(2)) {
            counted.iter_mut().zip(count).for_each(|(sum, count)| *sum = *sum + count.value);
            if count[0].value != N::from(0.0) {
                entries.iter_mut().zip(self.entries_of(value, share)).for_each(|(sum, entry)| *sum = *sum + entry);
            }
        }
        entries.extend(counted);
        entries
    }

    /// The summands of one value of a pixel, from its residual and variance, and the share of defects.
    fn entries_of<N: Number>(&self, values: &[&Hyper<N>], share: Option<N>) -> Vec<N> {
        let n = self.parameters.len() as u16;
        let (residual, variance) = (values[0], values.get(1).map(|variance| variance.value));
        let mut entries = Vec::with_capacity(self.outputs());
        let full = |variance: Option<N>| {
            let [value, ..] = self.shape.direct(residual.value, variance, share);
            let logarithm = variance.filter(|_| self.shape.has_logarithm()).map(|v| v.call1(Function1::Log));
            [logarithm.map_or(value, |logarithm| value + logarithm), value]
        };
        match self.claim {
            Claim::Value(ValueKind::Entry) => entries.push(full(variance)[1]),
            Claim::Value(ValueKind::Full) => entries.extend(full(variance)),
            Claim::Derivatives { newton: true, part } => {
                let f = self.shape.newton(residual, values.get(1).copied(), share);
                entries.push(f.value);
                if part.has_gradient() {
                    entries.extend(f.gradients(n));
                }
                if part.has_hessian() {
                    entries.extend(f.hessians(n));
                }
            }
            Claim::Derivatives { newton: false, .. } | Claim::Opening | Claim::Closing => {
                let [value, l, q] = self.shape.direct(residual.value, variance, share);
                let slopes: Vec<N> = residual.gradients(n).collect();
                entries.push(value);
                let part = self.claim.part();
                if part.is_some_and(Part::has_gradient) {
                    entries.extend(slopes.iter().map(|slope| l * *slope));
                }
                let is_entry = |i: usize, j: &usize| part.is_some_and(|part| part.has_entry(i, *j));
                for (i, u) in slopes.iter().enumerate() {
                    let row = (i..slopes.len()).filter(|j| is_entry(i, j));
                    entries.extend(row.map(|j| q * *u * slopes[j]));
                }
                if self.claim == Claim::Closing {
                    entries.extend(full(values.get(2).map(|variance| variance.value)));
                }
            }
        }
        entries
    }

    /// The sums by the program, with every pixel of the point taking part.
    pub(super) fn found<N: Number>(&self, loops: &ByLevel<'_>, point: &Point<N>) -> Vec<N> {
        let pixel = |channel, column, row| point.pixel(channel, column, row);
        evaluate_at(loops, &Raster { every_pixel: true, ..sample(loops, point, &pixel) }).outputs
    }

    /// The value of the i-th free parameter.
    pub(super) fn value(&self, i: usize, point: &Point<f64>) -> f64 {
        match self.graph.node(self.parameters[i]) {
            Node::Input(input) => point.input(*input),
            _ => f64::NAN,
        }
    }
}

/// A program's input at a point.
pub(super) fn sample<'a, N: Number>(
    loops: &ByLevel<'_>,
    point: &'a Point<N>,
    pixel: &'a dyn Fn(usize, usize, usize) -> N,
) -> Raster<'a, N> {
    Raster {
        inputs: loops.program().inputs().iter().map(|input| point.input(*input)).collect(),
        columns: point.columns.clone(),
        rows: point.rows.clone(),
        pixel,
        every_pixel: false,
    }
}
