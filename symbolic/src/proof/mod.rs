//! The check that every program passes once, when it is made: does it compute the derivatives of the document's formulas?
//!
//! What comes in: a program, and the residual that it was derived from. The reference is forward differentiation
//! ([`crate::proof::hyper`]) at random points, which shares nothing with the derivation but the graph of the formulas:
//! 1. in exact arithmetic modulo a prime, elementary functions being values without meaning;
//! 2. in f64 at plausible points, to 1e-12 of the sum of the absolute terms; double-double decides where rounding exceeds that;
//! 3. in f32 by the interpreter, against f64: the gradient's error, scaled by √H_ii, over its largest entry;
//! 4. the row bounds and mask of the pixel set, against the domain itself.

pub(crate) mod calculus;
pub(crate) mod double_double;
#[cfg(test)]
mod duals_tests;
pub(crate) mod evaluate;
pub(crate) mod hyper;
pub(crate) mod likelihood;
pub(crate) mod modular;
pub(crate) mod points;
pub mod ulps;
pub(crate) mod weighed;

use serde::{Deserialize, Serialize};

use crate::language::graph::{Graph, Node, NodeId};
use crate::language::model::{Loss, Model};
use crate::program::interpreter;
use crate::program::{Bindings, Precision, Program};
use crate::proof::double_double::DoubleDouble;
use crate::proof::evaluate::{Number, Sample, evaluate_at};
use crate::proof::hyper::{Evaluator, Hyper, Order};
use crate::proof::likelihood::Shape;
use crate::proof::modular::Modular;
use crate::proof::points::{FAR, LIMIT, NEAR, Point, Random, centre, columns_around, picture, plausible};
use crate::proof::weighed::Weighed;

/// How a program's sums are written down.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// As few sums as the search found.
    Factored,
    /// The same without the rewrites that let a factor change sides.
    Plain,
    /// One sum for every output.
    Unfactored,
}

/// What the check found; part of a model's report.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Proof {
    /// Which form passed.
    pub form: Form,
    /// Equality held exactly at random points modulo 2⁶¹ − 1.
    pub exact: bool,
    /// The largest error in f64 over the sum of the absolute terms; `None` when F or a derivative is not finite at any of
    /// the made-up points.
    pub error: Option<f64>,
    /// The largest error of the gradient in f32, scaled by √H_ii, over its largest entry; `None` as above.
    pub f32_error: Option<f64>,
}

/// Error in f64 over the sum of the absolute terms.
const TOLERANCE: f64 = 1e-12;
/// The same in double-double: numbers that were folded in f64 are all that may differ.
const REFEREE: f64 = 1e-13;
/// Terms below this have lost digits to the smallest numbers of f64.
const SMALLEST: f64 = 1e-290;
/// Error in f32 that no form is turned down for.
const F32_TOLERANCE: f64 = 1e-5;
/// Points tried before a model is said to be finite nowhere.
const POINTS: u64 = 6;
/// A parameter is left out of the error in f32 where changing it by itself changes F by less than this share.
const UNSEEN: f64 = 1e-12;
/// Instructions of a program that is run in f32 on one row only.
const LONG: usize = 2000;
/// How near a rim, px, a pixel may belong or not.
const RIM: f64 = 1e-6;
/// Halvings of three columns that come nearer than that.
const HALVINGS: u32 = 26;
/// Points of exact arithmetic for formulas with conditions: each point sees one branch of a condition.
const CONDITIONAL_POINTS: u64 = 8;
/// Derivatives that forward differentiation may hold at a time: nodes times entries of the Hessian.
const ENTRIES: usize = 4_000_000;

/// What a program claims to sum.
pub(crate) struct Claim<'a> {
    pub model: &'a Model,
    pub graph: &'a Graph,
    pub residual: NodeId,
    pub variance: Option<NodeId>,
    pub shape: Shape,
    pub domain: Option<NodeId>,
    pub parameters: &'a [NodeId],
    pub newton: bool,
}

/// The errors of a program that passed; the one in f32 is for the caller to judge.
pub(crate) struct Errors {
    pub exact: bool,
    pub error: Option<f64>,
    pub f32_error: Option<f64>,
}

/// True when the error in f32 needs no comparison with another form.
pub(crate) fn is_small_f32(error: Option<f64>) -> bool {
    error.is_none_or(|error| error <= F32_TOLERANCE)
}

impl Claim<'_> {
    /// True when checking would take more memory and time than a document is worth.
    pub fn is_too_large(&self) -> bool {
        let n = self.parameters.len();
        let entries = 1 + n + if self.newton { n * (n + 1) / 2 } else { 0 };
        self.graph.reachable(&[self.residual]).len() * entries > ENTRIES
    }

    /// Nothing when the program does not compute what it claims to.
    pub fn check(&self, program: &Program) -> Option<Errors> {
        let reachable = self.graph.reachable(&[self.residual]);
        let is_conditional = self.shape != Shape::Seen(Loss::Squares)
            || reachable.iter().any(|n| matches!(self.graph.node(*n), Node::Select(..) | Node::Abs(_)));
        let seeds = 0..if is_conditional { CONDITIONAL_POINTS } else { 1 };
        let exact = seeds.into_iter().all(|seed| self.agrees_exactly(program, &mut Random(seed)));
        let points: Vec<Point<f64>> =
            (0..POINTS).map(|seed| plausible(self.model, centre(self.model, NEAR), &mut Random(seed))).collect();
        let (error, right) = self.sampled(program, &points);
        if !right
            || (!exact && error.is_none())
            || (is_conditional && !self.is_right_far_off(program))
            || !self.has_its_pixels(program, &points[0], &points[0].rows[0])
        {
            return None;
        }
        Some(Errors { exact, error, f32_error: self.f32_error(program) })
    }

    /// F, gradient and Hessian, upper triangle, summed over the point's pixels.
    fn direct<N: Number>(&self, point: &Point<N>) -> Vec<N> {
        let roots: Vec<NodeId> = [Some(self.residual), self.variance].into_iter().flatten().collect();
        let order = if self.newton { Order::Second } else { Order::First };
        let inputs = |node: &Node| match node {
            Node::Input(input) => point.input(*input),
            _ => N::from(f64::NAN),
        };
        let mut evaluator = Evaluator::new(self.graph, &roots, self.parameters, order, &inputs);
        let n = self.parameters.len() as u16;
        let pairs = || (0..n).flat_map(|i| (i..n).map(move |j| (i, j)));
        let mut outputs = vec![N::from(0.0); 1 + usize::from(n) + pairs().count()];
        for (row, outer) in point.rows.iter().enumerate() {
            for (column, x) in point.columns.iter().enumerate() {
                let leaf = |node: &Node| match node {
                    Node::Coordinate(c) if c.0 == 0 => *x,
                    Node::Coordinate(c) => outer[c.index() - 1],
                    Node::Channel(c) => point.pixel(c.index(), column, row),
                    Node::Input(input) => point.input(*input),
                    _ => N::from(f64::NAN),
                };
                let values = evaluator.at(&leaf);
                let residual = &values[0];
                let mut entries = Vec::with_capacity(outputs.len());
                if self.newton {
                    let f = self.shape.newton(residual, values.get(1));
                    entries.push(f.value);
                    entries.extend((0..n).map(|u| f.gradient(u)));
                    entries.extend(pairs().map(|(u, v)| f.hessian(u, v)));
                } else {
                    let [value, l, q] = self.shape.direct(residual.value, values.get(1).map(|v| v.value));
                    let slope = |u| Hyper::gradient(residual, u);
                    entries.push(value);
                    entries.extend((0..n).map(|u| l * slope(u)));
                    entries.extend(pairs().map(|(u, v)| q * slope(u) * slope(v)));
                }
                outputs.iter_mut().zip(entries).for_each(|(sum, entry)| *sum = *sum + entry);
            }
        }
        outputs
    }

    fn outputs<N: Number>(&self, program: &Program, point: &Point<N>) -> Vec<N> {
        let sample = Sample {
            inputs: program.inputs().iter().map(|input| point.input(*input)).collect(),
            columns: point.columns.clone(),
            rows: point.rows.clone(),
            pixel: &|channel, column, row| point.pixel(channel, column, row),
            every_pixel: true,
        };
        evaluate_at(program, &sample).outputs
    }

    fn agrees_exactly(&self, program: &Program, random: &mut Random) -> bool {
        let coordinates = self.model.coordinates.len();
        let mut some = |count: usize| (0..count).map(|_| Modular::of_bits(random.bits())).collect::<Vec<_>>();
        let (columns, rows) = (2, if coordinates == 1 { 1 } else { 2 });
        let point = Point {
            parameters: some(self.model.parameters.len()),
            constants: some(self.model.constants.len()),
            columns: some(columns),
            rows: (0..rows).map(|_| some(coordinates - 1)).collect(),
            pixels: some(self.model.channels.len() * columns * rows),
        };
        self.outputs(program, &point) == self.direct(&point)
    }

    /// The error in f64 at the first point where all is finite, and whether that is rounding only.
    fn sampled(&self, program: &Program, points: &[Point<f64>]) -> (Option<f64>, bool) {
        for point in points {
            let direct = self.direct(&point.map(Weighed::from));
            let found = self.outputs(program, point);
            if !direct.iter().all(|x| x.value.is_finite() && x.terms.is_finite()) {
                continue;
            }
            let ratio = |(found, direct): (f64, &Weighed)| {
                let error = (found - direct.value).abs() / direct.terms.max(SMALLEST);
                if error.is_nan() { f64::INFINITY } else { error }
            };
            let error = found.iter().copied().zip(&direct).map(ratio).fold(0.0, f64::max);
            if error <= TOLERANCE {
                return (Some(error), true);
            }
            return (Some(error), self.is_rounding(program, point, &direct));
        }
        (None, true)
    }

    /// True when in double-double nothing is left of the difference; `direct` holds the sums of the absolute terms.
    fn is_rounding(&self, program: &Program, point: &Point<f64>, direct: &[Weighed]) -> bool {
        let point = point.map(DoubleDouble::from);
        let (found, exact) = (self.outputs(program, &point), self.direct(&point));
        found
            .iter()
            .zip(&exact)
            .zip(direct)
            .all(|((found, exact), direct)| (*found - *exact).to_f64().abs() <= REFEREE * direct.terms.max(SMALLEST))
    }

    /// True when every branch that far-off parameters take is right as well.
    fn is_right_far_off(&self, program: &Program) -> bool {
        (0..CONDITIONAL_POINTS).all(|seed| {
            let mut random = Random(seed);
            let mut point = plausible(self.model, centre(self.model, NEAR), &mut random);
            // All by nearly the same factor: shapes that are far from round cancel more digits than there are.
            let far = 3.0 * random.signed();
            point.parameters.iter_mut().for_each(|p| *p *= 10.0_f64.powf(far + 0.3 * random.signed()));
            let direct = self.direct(&point.map(Weighed::from));
            let all_finite = direct.iter().all(|x| x.value.is_finite() && x.terms.is_finite())
                && self.outputs(program, &point).iter().all(|x| x.is_finite());
            !all_finite || self.is_rounding(program, &point, &direct)
        })
    }

    /// True when the pixel set is that of the domain: at whole columns, and on both sides of every rim between them.
    fn has_its_pixels(&self, program: &Program, point: &Point<f64>, outer: &[f64]) -> bool {
        let Some(domain) = self.domain else { return true };
        let inputs = |node: &Node| match node {
            Node::Input(input) => point.input(*input),
            _ => f64::NAN,
        };
        let roots = [domain];
        let mut evaluator = Evaluator::new(self.graph, &roots, &[], Order::First, &inputs);
        let mut inside = |x: f64| {
            evaluator.holds_at(&|node| match node {
                Node::Coordinate(c) if c.0 == 0 => x,
                Node::Coordinate(c) => outer[c.index() - 1],
                Node::Channel(c) => point.pixel(c.index(), 0, 0),
                node => inputs(node),
            })
        };
        let mut columns: Vec<f64> = columns_around(centre(self.model, NEAR)[0]).into_iter().step_by(3).collect();
        for i in 1..columns.len() {
            let (mut left, mut right) = (columns[i - 1], columns[i]);
            let at_left = inside(left);
            if at_left != inside(right) {
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (left + right);
                    if inside(middle) == at_left { left = middle } else { right = middle }
                }
                columns.extend([left - RIM, right + RIM]);
            }
        }
        let sample = Sample {
            inputs: program.inputs().iter().map(|input| point.input(*input)).collect(),
            columns: columns.clone(),
            rows: vec![outer.to_vec()],
            pixel: &|channel, _, _| point.pixel(channel, 0, 0),
            every_pixel: false,
        };
        let taken = evaluate_at(program, &sample).taken;
        columns.into_iter().zip(taken).all(|(x, taken)| inside(x) == taken || inside(x - RIM) != inside(x + RIM))
    }

    /// The gradient's error in f32 on a picture of the target beside its place; `None` when it is finite nowhere.
    pub fn f32_error(&self, program: &Program) -> Option<f64> {
        let n = self.parameters.len();
        let height = if program.instructions().len() < LONG { 2 } else { 1 };
        (0..POINTS).find_map(|seed| {
            let mut random = Random(seed);
            let point = plausible(self.model, centre(self.model, FAR), &mut random);
            let picture = picture(self.model, &point, height, &mut random);
            let constants = &point.constants;
            let limit = if matches!(self.shape, Shape::Clipped(_)) { LIMIT } else { f64::INFINITY };
            let saturation = vec![limit; self.model.channels.len()];
            let bindings = Bindings {
                parameters: &point.parameters,
                entry: &point.parameters,
                constants,
                saturation: &saturation,
                shift: &[],
            };
            let run =
                |precision| interpreter::run(program, precision, &bindings, &picture, picture.window, None).outputs;
            let (single, double) = (run(Precision::F32), run(Precision::F64));
            let mut diagonal = 1 + n;
            let (mut error, mut largest) = (0.0_f64, 0.0_f64);
            for i in 0..n {
                let scale = double[diagonal].abs().sqrt();
                let seen = double[diagonal].abs() * self.value(i, &point).powi(2).max(1.0);
                diagonal += n - i;
                if seen > UNSEEN * double[0].abs() {
                    error = error.max((single[1 + i] - double[1 + i]).abs() / scale);
                    largest = largest.max(double[1 + i].abs() / scale);
                }
            }
            let all_finite = single.iter().chain(&double).all(|x| x.is_finite());
            (all_finite && largest > 0.0).then_some(error / largest)
        })
    }

    /// The value of the i-th free parameter.
    fn value(&self, i: usize, point: &Point<f64>) -> f64 {
        match self.graph.node(self.parameters[i]) {
            Node::Input(input) => point.input(*input),
            _ => f64::NAN,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::{Input, Opcode, ParameterId, Sink, Value};
    use crate::{Lowering, Method};

    const SPOT: &str = r#"
name = "spot"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a = { start = "extent.xx", min = 0 }
v1 = { start = "amplitude", min = 0 }
[definitions]
s = "a * ((x - bx)^2 + (y - by)^2)"
[model]
intensity = "v1 * (1 - s) * PROFILE"
domain = "s <= 1"
"#;

    /// The program of all parameters, changed, and what the check says of it.
    fn passes(profile: &str, method: Method, change: impl FnOnce(&mut Program)) -> Option<Errors> {
        let model = Model::from_toml(&SPOT.replace("PROFILE", profile)).unwrap();
        let subset: Vec<ParameterId> = (0..4).map(ParameterId).collect();
        let objective = model.objective(&subset, method).unwrap();
        let mut program = objective.program(Lowering { fma: true, drop_saturated: false }).unwrap();
        change(&mut program);
        let mut graph = Graph::clone(&model.formulas.graph);
        let residual = graph.sub(model.formulas.observed, model.formulas.intensity);
        let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let claim = Claim {
            model: &model,
            graph: &graph,
            residual,
            variance: None,
            shape: model.formulas.shape(),
            domain: model.formulas.domain,
            parameters: &parameters,
            newton: method == Method::Newton,
        };
        claim.check(&program)
    }

    #[test]
    fn sums_as_they_are_derived_pass() {
        for method in [Method::Newton, Method::GaussNewton] {
            for profile in ["1 / (2 + s)", "exp(-s)", "if(s < 0.5, 1, s)^1.5", "sqrt(1 + s) * tanh(s) + abs(s - 0.5)"] {
                let errors = passes(profile, method, |_| ()).unwrap_or_else(|| panic!("{profile}"));
                assert!(errors.exact && errors.error.unwrap() < 1e-12, "{profile}");
                assert!(errors.f32_error.unwrap() < 1e-4, "{profile}");
            }
        }
    }

    #[test]
    fn every_planted_fault_is_caught() {
        let planted = faults("exp(-s)", Method::Newton) + faults("if(a < 0.5, s^2, tanh(s))", Method::GaussNewton);
        assert!(planted > 100, "{planted}");
    }

    /// Changes one instruction after the other; the check must see each change.
    fn faults(profile: &str, method: Method) -> usize {
        let mut count = 0;
        passes(profile, method, |program| count = program.instructions.len()).unwrap();
        let mut planted = 0;
        for i in 0..count {
            let (mut changed, mut text) = (false, String::new());
            let verdict = passes(profile, method, |program| {
                let op = &mut program.instructions[i].op;
                let new = match op.parts() {
                    (Opcode::Add, &[a, b]) => Opcode::Sub.of([a, b]),
                    (Opcode::Sub, &[a, b]) => Opcode::Add.of([a, b]),
                    (Opcode::Mul, &[a, b]) if a != b => Opcode::Mul.of([a, a]),
                    (Opcode::Fma, &[a, b, c]) if a != b => Opcode::Fma.of([a, a, c]),
                    (Opcode::Neg, &[a]) => Opcode::Add.of([a, a]),
                    _ => *op,
                };
                changed = new != *op;
                *op = new;
                text = program.to_string();
            });
            planted += usize::from(changed);
            assert!(!changed || verdict.is_none(), "instruction {i} may be changed without anyone noticing: {text}");
        }
        planted
    }

    #[test]
    fn a_missing_output_or_a_wrong_bound_is_caught() {
        let swapped = passes("1", Method::Newton, |program| {
            let Sink::Sums { outputs, .. } = &mut program.sink else { return };
            outputs.swap(1, 2);
        });
        assert!(swapped.is_none());
        let wide = passes("1", Method::Newton, |program| program.pixel_set.bounds = None);
        assert!(wide.is_none());
        let turned = passes("1", Method::Newton, |program| {
            let (lo, hi): (Value, Value) = program.pixel_set.bounds.unwrap();
            program.pixel_set.bounds = Some((hi, lo));
        });
        assert!(turned.is_none());
    }
}
