//! The check that every program passes once, when it is made: does it compute the derivatives of the document's formulas?
//!
//! What comes in: a program, and the residual that it was derived from. The reference is forward differentiation
//! ([`crate::hyper`]) at random points, which shares nothing with the derivation but the graph of the formulas:
//! 1. in exact arithmetic modulo a prime, elementary functions being values without meaning;
//! 2. in f64 at plausible points, to 1e-12 of the sum of the absolute terms; double-double decides where rounding exceeds that;
//! 3. in f32 by the interpreter, against f64: the gradient's error, scaled by √H_ii, over its largest entry;
//! 4. the row bounds and mask of the pixel set, against the domain itself.

use serde::{Deserialize, Serialize};

use crate::calculus::derivatives;
use crate::double_double::DoubleDouble;
use crate::evaluate::{Number, Sample, evaluate_at};
use crate::function::Function1;
use crate::graph::{Graph, Node, NodeId};
use crate::hyper::{Evaluator, Hyper, Order};
use crate::interpreter::{self, Pixels, Slices, Window};
use crate::model::{Estimator, Model, Start};
use crate::modular::Modular;
use crate::program::{Bindings, Input, Precision, Program};
use crate::weighed::Weighed;

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
/// How near a rim, px, a pixel may belong or not.
const RIM: f64 = 1e-6;
/// Columns and rows of the picture for f32; of a third and fourth coordinate it has two.
const PICTURE: (usize, usize) = (48, 3);
/// Where the made-up target is, px: in the middle of a camera's picture for f32, and where terms are as small as their sum
/// for f64.
const FAR: [f64; 4] = [300.3, 200.7, 20.3, 10.7];
const NEAR: [f64; 4] = [0.3, -0.3, 0.3, -0.3];
/// How large it is, px.
const SIZE: f64 = 12.0;

/// What a program claims to sum.
pub(crate) struct Claim<'a> {
    pub model: &'a Model,
    pub graph: &'a Graph,
    pub residual: NodeId,
    pub variance: Option<NodeId>,
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

/// Random numbers that are the same every time.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    /// In −1 … 1.
    fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Numbers for everything that formulas read.
struct Point<N> {
    parameters: Vec<N>,
    constants: Vec<N>,
    columns: Vec<N>,
    rows: Vec<Vec<N>>,
    /// Channel by channel, row by row.
    pixels: Vec<N>,
}

impl<N: Number> Point<N> {
    fn input(&self, input: Input) -> N {
        match input {
            Input::Parameter(p) | Input::Entry(p) => self.parameters[p.index()],
            Input::Constant(c) => self.constants[c.index()],
            Input::Saturation(_) => N::from(f64::MAX),
            Input::Shift(_) => N::from(0.0),
        }
    }

    fn pixel(&self, channel: usize, column: usize, row: usize) -> N {
        self.pixels[(channel * self.rows.len() + row) * self.columns.len() + column]
    }

    fn map<M>(&self, to: impl Fn(N) -> M) -> Point<M> {
        let all = |list: &[N]| list.iter().map(|x| to(*x)).collect::<Vec<M>>();
        Point {
            parameters: all(&self.parameters),
            constants: all(&self.constants),
            columns: all(&self.columns),
            rows: self.rows.iter().map(|row| all(row)).collect(),
            pixels: all(&self.pixels),
        }
    }
}

impl Claim<'_> {
    /// Nothing when the program does not compute what it claims to.
    pub fn check(&self, program: &Program) -> Option<Errors> {
        let exact = self.agrees_exactly(program, &mut Random(0));
        let points: Vec<Point<f64>> =
            (0..POINTS).map(|seed| self.plausible(self.centre(NEAR), &mut Random(seed))).collect();
        let (error, right) = self.sampled(program, &points);
        if !right
            || (!exact && error.is_none())
            || !points[..2].iter().all(|point| self.has_its_pixels(program, point, &point.rows[0]))
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
        let two = N::from(2.0);
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
                    let mut f = residual.power(2);
                    if let Some(variance) = values.get(1) {
                        f = f
                            .mul(&variance.power(-1))
                            .add(&variance.unary(derivatives(Function1::Log, variance.value)));
                    }
                    entries.push(f.value);
                    entries.extend((0..n).map(|u| f.gradient(u)));
                    entries.extend(pairs().map(|(u, v)| f.hessian(u, v)));
                } else {
                    let weight = values.get(1).map_or(N::from(1.0), |variance| N::from(1.0) / variance.value);
                    let slope = |u| Hyper::gradient(residual, u);
                    entries.push(residual.value * residual.value * weight);
                    entries.extend((0..n).map(|u| two * residual.value * slope(u) * weight));
                    entries.extend(pairs().map(|(u, v)| two * slope(u) * slope(v) * weight));
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
            let point = point.map(DoubleDouble::from);
            let (found, exact) = (self.outputs(program, &point), self.direct(&point));
            let right = found.iter().zip(&exact).zip(&direct).all(|((found, exact), direct)| {
                (*found - *exact).to_f64().abs() <= REFEREE * direct.terms.max(SMALLEST)
            });
            return (Some(error), right);
        }
        (None, true)
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
        let mut columns: Vec<f64> = columns_around(self.centre(NEAR)[0]).into_iter().step_by(3).collect();
        for i in 1..columns.len() {
            let (mut left, mut right) = (columns[i - 1], columns[i]);
            let at_left = inside(left);
            if at_left != inside(right) {
                while right - left > 0.1 * RIM {
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

    /// Where the first target is: numbers of the document count, everything else is put where the caller wants it.
    fn centre(&self, otherwise: [f64; 4]) -> [f64; 4] {
        let role = |i: usize| self.model.roles.first()?.centre.get(i).copied();
        std::array::from_fn(|i| match role(i).map(|p| self.model.parameters[p.index()].start) {
            Some(Start::Number(number)) => number,
            Some(Start::Estimator(_)) => otherwise[i],
            None => 0.5 * PICTURE.0 as f64,
        })
    }

    /// Parameters near their starts, with the target in the middle of some columns and rows.
    fn plausible(&self, centre: [f64; 4], random: &mut Random) -> Point<f64> {
        let parameters: Vec<f64> = self.model.parameters.iter().map(|p| made_up(p, centre, random)).collect();
        let coordinates = self.model.coordinates.len();
        let near = |centre: f64, random: &mut Random| (centre + 0.8 * SIZE * random.signed()).round();
        let columns: Vec<f64> = (0..4).map(|_| near(centre[0], random)).collect();
        let outer = |random: &mut Random| (1..coordinates).map(|i| near(centre[i], random)).collect::<Vec<_>>();
        let rows: Vec<Vec<f64>> = (0..if coordinates == 1 { 1 } else { 2 }).map(|_| outer(random)).collect();
        let pixels = self.model.channels.len() * columns.len() * rows.len();
        Point {
            parameters,
            constants: self.model.constants.iter().map(|c| c.value).collect(),
            pixels: (0..pixels).map(|_| 110.0 + 90.0 * random.signed()).collect(),
            columns,
            rows,
        }
    }

    /// The gradient's error in f32 on a picture of the target beside its place; `None` when it is finite nowhere.
    pub fn f32_error(&self, program: &Program) -> Option<f64> {
        let n = self.parameters.len();
        (0..POINTS).find_map(|seed| {
            let mut random = Random(seed);
            let point = self.plausible(self.centre(FAR), &mut random);
            let picture = self.picture(&point, &mut random);
            let constants = &point.constants;
            let saturation = vec![f64::INFINITY; self.model.channels.len()];
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

    /// What the model shows with its parameters a little off, and some noise.
    fn picture(&self, point: &Point<f64>, random: &mut Random) -> Picture {
        let (width, height) = PICTURE;
        let centre = self.centre(FAR);
        let x = columns_around(centre[0])[0].max(0.0) as usize;
        let y = (centre[1] - 0.5 * height as f64).round().max(0.0) as usize;
        let coordinates = self.model.coordinates.len();
        let height = if coordinates == 1 { 1 } else { height };
        let slices = Slices {
            first: [2, 3].map(|i| if i < coordinates { centre[i].floor().max(0.0) as usize } else { 0 }),
            count: [2, 3].map(|i| if i < coordinates { 2 } else { 1 }),
        };
        let window = Window { x, y: if height == 1 { 0 } else { y }, width, height, slices };
        let away = |i: usize, value: f64| match self.model.parameters[i].start {
            Start::Estimator(Estimator::Centroid(_)) => value + 0.3,
            _ => 1.03 * value,
        };
        let parameters: Vec<f64> = point.parameters.iter().enumerate().map(|(i, value)| away(i, *value)).collect();
        let channels = self.model.channels.len();
        let [depth, length] = slices.count;
        let mut pixels = Vec::with_capacity(channels * width * height * depth * length);
        let inputs = |node: &Node| match node {
            Node::Input(Input::Parameter(p) | Input::Entry(p)) => parameters[p.index()],
            Node::Input(Input::Constant(c)) => point.constants[c.index()],
            _ => 0.0,
        };
        let formulas = &self.model.formulas;
        let roots = [formulas.intensity];
        let mut evaluator = Evaluator::new(&formulas.graph, &roots, &[], Order::First, &inputs);
        for _ in 0..channels {
            for row in 0..height * depth * length {
                let (slice, y) = (row / height, window.y + row % height);
                let [z, w] = [slices.first[0] + slice % depth, slices.first[1] + slice / depth];
                for column in 0..width {
                    let shown = evaluator.at(&|node| match node {
                        Node::Coordinate(c) => [window.x + column, y, z, w][c.index()] as f64,
                        node => inputs(node),
                    });
                    pixels.push(f64::from((shown[0].value + 1.5 * random.signed()) as f32));
                }
            }
        }
        Picture { window, pixels }
    }
}

fn columns_around(centre: f64) -> Vec<f64> {
    let first = (centre - 0.5 * PICTURE.0 as f64).round();
    (0..PICTURE.0).map(|i| first + i as f64).collect()
}

struct Picture {
    window: Window,
    pixels: Vec<f64>,
}

impl Pixels for Picture {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let [z, w] = self.window.slices.first;
        self.at_place(channel, [x, y, z, w])
    }
    fn at_place(&self, channel: usize, [x, y, z, w]: [usize; 4]) -> f64 {
        let Window { width, height, slices: Slices { first, count }, .. } = self.window;
        let volume = channel * count[1] + w - first[1];
        let slice = volume * count[0] + z - first[0];
        self.pixels[(slice * height + y - self.window.y) * width + x - self.window.x]
    }
}

/// A plausible value within the bounds.
fn made_up(parameter: &crate::model::Parameter, centre: [f64; 4], random: &mut Random) -> f64 {
    let jitter = random.signed();
    let value = match parameter.start {
        Start::Number(value) => value + 0.05 * jitter * if value == 0.0 { 1.0 } else { value },
        Start::Estimator(estimator) => match estimator {
            Estimator::Centroid(axis) => centre[axis] + jitter,
            Estimator::Extent(row, column) if row == column => (1.0 + 0.2 * jitter) / (SIZE * SIZE),
            Estimator::Extent(..) => 0.3 * jitter / (SIZE * SIZE),
            Estimator::Size(_) => SIZE * (1.0 + 0.2 * jitter),
            Estimator::Background => 20.0 + 5.0 * jitter,
            Estimator::Amplitude => {
                (150.0 + 30.0 * jitter) * if parameter.max.is_some_and(|m| m <= 0.0) { -1.0 } else { 1.0 }
            }
        },
    };
    let inside = parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
    match (inside, parameter.start, parameter.min, parameter.max) {
        (true, ..) => value,
        (_, Start::Number(start), ..) => start,
        (_, _, Some(min), Some(max)) => 0.5 * (min + max),
        (_, _, Some(min), None) => min + 1.0,
        (_, _, None, Some(max)) => max - 1.0,
        (_, _, None, None) => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::{Op, ParameterId, Sink, Value};
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
        let mut graph = model.formulas.graph.clone();
        let residual = graph.sub(model.formulas.observed, model.formulas.intensity);
        let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
        let claim = Claim {
            model: &model,
            graph: &graph,
            residual,
            variance: None,
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
        let count = {
            let mut count = 0;
            passes("exp(-s)", Method::Newton, |program| count = program.instructions.len()).unwrap();
            count
        };
        let mut planted = 0;
        for i in 0..count {
            let (mut changed, mut text) = (false, String::new());
            let verdict = passes("exp(-s)", Method::Newton, |program| {
                let bounds = program.pixel_set.bounds;
                let op = &mut program.instructions[i].op;
                let new = match *op {
                    Op::Add(a, b) => Op::Sub(a, b),
                    Op::Sub(a, b) => Op::Add(a, b),
                    Op::Mul(a, b) if a != b => Op::Mul(a, a),
                    Op::Fma(a, b, c) if a != b => Op::Fma(a, a, c),
                    Op::Neg(a) => Op::Add(a, a),
                    other => other,
                };
                changed = new != *op && bounds.is_some();
                *op = new;
                text = program.to_string();
            });
            planted += usize::from(changed);
            assert!(!changed || verdict.is_none(), "instruction {i} may be changed without anyone noticing: {text}");
        }
        assert!(planted > 50, "{planted}");
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
