//! The check of programs that sum: F, gradients, Hessians, in every lowering.
//!
//! What comes in: what a program claims to sum, and drafts of such programs. What goes out: those that do. The reference values
//! are worked out once, however many drafts are held against them. It never knows how a draft was derived.

use std::sync::OnceLock;

use isophote_elementary::{DoubleDouble, Function1};

use crate::language::graph::{Graph, Node, NodeId};
use crate::language::model::{Loss, Model};
use crate::program::interpreter;
use crate::program::{Bindings, ChannelId, Op, Opcode, Precision, Program, Sink};
use crate::proof::budget::Room;
use crate::proof::claim::{Claim, ValueKind};
use crate::proof::draft::Draft;
use crate::proof::evaluate::{Number, Sample, evaluate_at};
use crate::proof::hyper::{Bare, Evaluator, Hyper, Order, Values};
use crate::proof::likelihood::Shape;
use crate::proof::modular::Modular;
use crate::proof::pixels::{Rim, Windowed, set_of};
use crate::proof::points::{
    BESIDE, FAR, NEAR, Picture, Point, Random, anywhere, centre, limit, picture, plausible, residues,
};
use crate::proof::weighed::Weighed;
use crate::proof::{ENOUGH, Errors, LARGEST, POINTS, REFEREE, SMALLEST, TOLERANCE};

/// A parameter is left out of the error in f32 where changing it by itself changes F by less than this share.
const UNSEEN: f64 = 1e-12;
/// How much larger a prediction may be than a residual of which f64 knows on which side of a threshold it is.
const CERTAIN: f64 = 1e10;
/// Instructions of a program that is run in f32 on one row only.
const LONG: usize = 2000;

/// What the sums are of, as the document says it: no rewrite has seen it.
#[derive(Clone, Debug)]
pub(crate) struct Subject {
    pub model: Model,
    pub graph: Graph,
    pub residual: NodeId,
    pub variance: Option<NodeId>,
    pub shape: Shape,
    pub domain: Option<NodeId>,
    pub parameters: Vec<NodeId>,
    pub claim: Claim,
}

/// A point, and what the sums are there.
#[derive(Clone, Debug)]
struct Known<N, M> {
    point: Point<N>,
    sums: Vec<M>,
}

/// Holds drafts against what they claim; see the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Referee {
    pub(super) subject: Subject,
    is_conditional: bool,
    room: Room,
    exact: OnceLock<Vec<Known<Modular, Modular>>>,
    /// Further ones, for branches of the formulas or of a program.
    exact_further: OnceLock<Vec<Known<Modular, Modular>>>,
    sampled: OnceLock<Option<Known<f64, Weighed>>>,
    /// Single pixels where formulas have a value, wherever that is.
    anywhere: OnceLock<Vec<Known<f64, Weighed>>>,
    /// On the other side of the origin, and about the loss' threshold.
    beside: OnceLock<Vec<Known<f64, Weighed>>>,
    far: OnceLock<Vec<Known<f64, Weighed>>>,
    rims: OnceLock<Vec<Rim>>,
    windows: [OnceLock<Vec<Windowed>>; 2],
    pictured: OnceLock<(Point<f64>, Picture)>,
}

impl Referee {
    pub fn new(subject: Subject, room: Room) -> Referee {
        let reachable = subject.graph.reachable(&subject.roots());
        let is_conditional = subject.shape.is_conditional()
            || reachable.iter().any(|n| matches!(subject.graph.node(*n), Node::Select(..) | Node::Abs(_)));
        Referee {
            subject,
            is_conditional,
            room,
            exact: OnceLock::new(),
            exact_further: OnceLock::new(),
            sampled: OnceLock::new(),
            anywhere: OnceLock::new(),
            beside: OnceLock::new(),
            far: OnceLock::new(),
            rims: OnceLock::new(),
            windows: Default::default(),
            pictured: OnceLock::new(),
        }
    }

    pub fn model(&self) -> &Model {
        &self.subject.model
    }

    pub fn claim(&self) -> Claim {
        self.subject.claim
    }

    /// The same sums over fewer pixels.
    pub fn within(&self, domain: impl FnOnce(&mut Graph, Option<NodeId>) -> Option<NodeId>) -> Referee {
        let mut subject = self.subject.clone();
        subject.domain = domain(&mut subject.graph, subject.domain);
        Referee { subject, rims: OnceLock::new(), windows: Default::default(), ..self.clone() }
    }

    /// The program, when it sums what it claims to; `dropped`: without pixels at the limit of one of these channels.
    pub fn proved(&self, draft: Draft, dropped: &[ChannelId]) -> Option<(Program, Errors)> {
        let errors = self.check(draft.program(), dropped)?;
        Some((draft.passed(), errors))
    }

    pub(super) fn check(&self, program: &Program, dropped: &[ChannelId]) -> Option<Errors> {
        let outputs = program.sink().outputs().len();
        let set = program.pixel_set();
        let is_whole = set.bounds.is_none() && set.mask.is_none();
        if outputs != self.subject.outputs()
            || (self.subject.domain.is_none() && !is_whole)
            || set.saturated.is_some() == dropped.is_empty()
        {
            return None;
        }
        let agrees = |known: &Known<Modular, Modular>| self.subject.found(program, &known.point) == known.sums;
        let exact = self.exact.get_or_init(|| self.residues(0..1)).iter().all(agrees)
            && (!(self.is_conditional || has_branches(program)) || self.further().iter().all(agrees));
        let (error, right) = match self.sampled() {
            Some(known) => {
                let (error, right) = self.compared(program, known, |_| true);
                (Some(error), right)
            }
            None => (None, true),
        };
        let right = right
            && (exact || error.is_some())
            && self.beside().iter().all(|known| self.compared(program, known, |_| true).1)
            // Far off, powers may leave f64's range in a program that do not in the formulas: such a sum tells nothing.
            && (!self.is_conditional || self.far().iter().all(|known| self.compared(program, known, f64::is_finite).1))
            && self.has_its_rims(program)
            && self.windows(dropped).iter().all(|window| window.is_summed_by(&self.subject, program));
        right.then_some(Errors { exact, error })
    }

    fn further(&self) -> &[Known<Modular, Modular>] {
        self.exact_further.get_or_init(|| self.residues(1..self.room.points))
    }

    fn residues(&self, seeds: std::ops::Range<u64>) -> Vec<Known<Modular, Modular>> {
        let at = |seed| {
            let point = residues(&self.subject.model, &mut Random(seed));
            let sums = self.subject.direct(&point, |_, _| true);
            Known { point, sums }
        };
        seeds.map(at).collect()
    }

    /// True when no made-up point has a finite value: nothing is known of any program.
    pub fn is_blind(&self) -> bool {
        self.sampled().is_none()
    }

    fn known(&self, point: Point<f64>) -> Option<Known<f64, Weighed>> {
        let sums = self.subject.weighed(&point, |_, _| true)?;
        Some(Known { point, sums })
    }

    /// Single pixels somewhere, at any parameters: what formulas have a value for may be elsewhere than targets are put.
    fn anywhere(&self) -> &[Known<f64, Weighed>] {
        self.anywhere.get_or_init(|| {
            let at = |seed| self.known(anywhere(&self.subject.model, &mut Random(seed)));
            (0..self.room.elsewhere).filter_map(at).take(ENOUGH).collect()
        })
    }

    /// The first point where all is finite.
    fn sampled(&self) -> Option<&Known<f64, Weighed>> {
        let made = || {
            (0..POINTS).find_map(|seed| {
                let model = &self.subject.model;
                let point = plausible(model, centre(model, NEAR), &mut Random(seed));
                self.known(point)
            })
        };
        self.sampled.get_or_init(|| made().or_else(|| self.anywhere().first().cloned())).as_ref()
    }

    fn beside(&self) -> &[Known<f64, Weighed>] {
        self.beside.get_or_init(|| {
            let (model, subject) = (&self.subject.model, &self.subject);
            let at = |seed| {
                let mut point = plausible(model, centre(model, BESIDE), &mut Random(seed));
                point.columns.truncate(2);
                point.rows.truncate(1);
                if !subject.show_threshold(&mut point) {
                    return None;
                }
                self.known(point)
            };
            let found: Vec<_> = (0..if self.is_conditional { self.room.points } else { 1 }).filter_map(at).collect();
            if found.is_empty() { self.anywhere().to_vec() } else { found }
        })
    }

    /// Where every branch that far-off parameters take shows.
    fn far(&self) -> &[Known<f64, Weighed>] {
        self.far.get_or_init(|| {
            let at = |seed| {
                let mut random = Random(seed);
                let model = &self.subject.model;
                let mut point = plausible(model, centre(model, NEAR), &mut random);
                point.move_far(&mut random);
                self.known(point)
            };
            (0..self.room.points).filter_map(at).collect()
        })
    }

    /// True when the pixel set ends where the domain does.
    fn has_its_rims(&self, program: &Program) -> bool {
        let rims = self.rims();
        rims.is_empty() || {
            let mut set = set_of(program);
            set.pixel_set.saturated = None;
            rims.iter().all(|rim| rim.is_of(&self.subject, &set))
        }
    }

    fn rims(&self) -> &[Rim] {
        self.rims.get_or_init(|| Rim::all(&self.subject))
    }

    fn windows(&self, dropped: &[ChannelId]) -> &[Windowed] {
        self.windows[usize::from(!dropped.is_empty())].get_or_init(|| Windowed::all(&self.subject, dropped))
    }

    /// The error in f64 of the sums that are told, and whether that is rounding only.
    fn compared(&self, program: &Program, known: &Known<f64, Weighed>, is_told: fn(f64) -> bool) -> (f64, bool) {
        let found = self.subject.found(program, &known.point);
        let told: Vec<usize> = (0..found.len()).filter(|i| is_told(found[*i])).collect();
        let sums = picked(&known.sums, &told);
        let error = worst(&picked(&found, &told), &sums);
        let is_rounding = || {
            let point = known.point.map(DoubleDouble::from);
            let (found, exact) = (self.subject.found(program, &point), self.subject.direct(&point, |_, _| true));
            is_rounding(&picked(&found, &told), &picked(&exact, &told), &sums)
        };
        (error, error <= TOLERANCE || is_rounding())
    }

    /// The gradient's error in f32 on a picture of the target beside its place; `None` when it is finite nowhere.
    pub fn f32_error(&self, program: &Program) -> Option<f64> {
        let height = if program.instructions().len() < LONG { 2 } else { 1 };
        let made = |seed| {
            let (model, mut random) = (&self.subject.model, Random(seed));
            let point = plausible(model, centre(model, FAR), &mut random);
            let picture = picture(model, &point, height, &mut random);
            (point, picture)
        };
        let (point, picture) = self.pictured.get_or_init(|| made(0));
        self.f32_error_at(program, point, picture).or_else(|| {
            (1..POINTS).find_map(|seed| {
                let (point, picture) = made(seed);
                self.f32_error_at(program, &point, &picture)
            })
        })
    }

    fn f32_error_at(&self, program: &Program, point: &Point<f64>, picture: &Picture) -> Option<f64> {
        let n = self.subject.parameters.len();
        let is_clipped = matches!(self.subject.shape, Shape::Clipped(_));
        let channels = 0..self.subject.model.channels.len();
        let saturation: Vec<f64> = channels.map(|c| if is_clipped { limit(c) } else { f64::INFINITY }).collect();
        let bindings = Bindings {
            parameters: &point.parameters,
            entry: &point.parameters,
            constants: &point.constants,
            saturation: &saturation,
            shift: &[],
        };
        let run = |precision| interpreter::run(program, precision, &bindings, picture, picture.window, None).outputs;
        let (single, double) = (run(Precision::F32), run(Precision::F64));
        let mut diagonal = 1 + n;
        let (mut error, mut largest) = (0.0_f64, 0.0_f64);
        for i in 0..n {
            let scale = double[diagonal].abs().sqrt();
            let seen = double[diagonal].abs() * self.subject.value(i, point).powi(2).max(1.0);
            diagonal += n - i;
            if seen > UNSEEN * double[0].abs() {
                error = error.max((single[1 + i] - double[1 + i]).abs() / scale);
                largest = largest.max(double[1 + i].abs() / scale);
            }
        }
        let all_finite = single.iter().chain(&double).all(|x| x.is_finite());
        (all_finite && largest > 0.0).then_some(error / largest)
    }
}

/// True when what is summed takes branches, which one point does not show.
fn has_branches(program: &Program) -> bool {
    let Sink::Sums { accumulators, totals, outputs } = program.sink() else { return false };
    let summed = program.made_of(accumulators.iter().chain(totals).chain(outputs).copied());
    let branches = |op: Op| matches!(op.code, Opcode::Abs | Opcode::Select);
    program.instructions().iter().zip(summed).any(|(instruction, summed)| summed && branches(instruction.op))
}

/// What a program reads at a point.
pub(super) fn sample<'a, N: Number>(
    program: &Program,
    point: &'a Point<N>,
    pixel: &'a dyn Fn(usize, usize, usize) -> N,
) -> Sample<'a, N> {
    Sample {
        inputs: program.inputs().iter().map(|input| point.input(*input)).collect(),
        columns: point.columns.clone(),
        rows: point.rows.clone(),
        pixel,
        every_pixel: false,
    }
}

fn picked<T: Copy>(all: &[T], indices: &[usize]) -> Vec<T> {
    indices.iter().map(|i| all[*i]).collect()
}

/// The largest error over the sum of the absolute terms.
pub(super) fn worst(found: &[f64], sums: &[Weighed]) -> f64 {
    let ratio = |(found, direct): (&f64, &Weighed)| {
        let error = (found - direct.value).abs() / direct.terms.max(SMALLEST);
        if error.is_nan() { f64::INFINITY } else { error }
    };
    found.iter().zip(sums).map(ratio).fold(0.0, f64::max)
}

/// True when in double-double nothing is left of the difference, beside the value or the sum of the absolute terms in f64.
pub(super) fn is_rounding(found: &[DoubleDouble], exact: &[DoubleDouble], weighed: &[Weighed]) -> bool {
    let is_near = |((found, exact), weighed): ((&DoubleDouble, &DoubleDouble), &Weighed)| {
        (*found - *exact).to_f64().abs() <= REFEREE * weighed.terms.max(exact.to_f64().abs()).max(SMALLEST)
    };
    found.iter().zip(exact).zip(weighed).all(is_near)
}

impl Subject {
    fn roots(&self) -> Vec<NodeId> {
        [Some(self.residual), self.variance].into_iter().flatten().collect()
    }

    /// How many numbers the sums are.
    fn outputs(&self) -> usize {
        let n = self.parameters.len();
        match self.claim {
            Claim::Value(ValueKind::Entry) => 1,
            Claim::Value(ValueKind::Full) => 2,
            Claim::Derivatives { part, .. } => {
                1 + usize::from(part.has_gradient()) * n + usize::from(part.has_hessian()) * (n * (n + 1) / 2)
            }
        }
    }

    /// Fills the point's pixels with values whose residuals are about where a robust loss changes, on both sides of it; false
    /// where those are what rounding leaves of much larger numbers.
    fn show_threshold(&self, point: &mut Point<f64>) -> bool {
        let threshold = match self.shape {
            Shape::Seen(Loss::Huber(c) | Loss::Tukey(c)) | Shape::Clipped(Loss::Huber(c) | Loss::Tukey(c)) => c,
            Shape::Seen(Loss::Squares) | Shape::Clipped(Loss::Squares) => 1.0,
        };
        // Without pixels the residual is −intensity, as far as observed values are pixels.
        point.pixels = vec![0.0; self.model.channels.len() * point.rows.len() * point.columns.len()];
        let (mut pixels, mut are_sure) = (Vec::new(), true);
        for values in self.values(point) {
            let deviation = values.get(1).map_or(1.0, |variance| variance.value.sqrt());
            let side = if pixels.len() % 2 == 0 { 1.03 } else { 0.97 };
            are_sure &= values[0].value.abs() < CERTAIN * threshold * deviation;
            pixels.push(side * threshold * deviation - values[0].value);
        }
        point.pixels = (0..self.model.channels.len()).flat_map(|_| pixels.iter().copied()).collect();
        are_sure
    }

    /// Residual and variance at each pixel of a point, row by row.
    fn values(&self, point: &Point<f64>) -> Vec<Vec<Bare<f64>>> {
        let roots = self.roots();
        let mut evaluator = Values::of(&self.graph, &roots, &|node| point.given(node));
        let places = (0..point.rows.len()).flat_map(|row| (0..point.columns.len()).map(move |column| (column, row)));
        let at = |(column, row): (usize, usize)| {
            let pixel = |channel| point.pixel(channel, column, row);
            evaluator.at(&|node| point.read(node, point.columns[column], &point.rows[row], &pixel))
        };
        places.map(at).collect()
    }

    /// The sums over pixels that take part, with their terms. `None` where they are no evidence: a robust loss makes a number of
    /// what is no number, or too large for its powers.
    pub(super) fn weighed(
        &self,
        point: &Point<f64>,
        takes_part: impl Fn(usize, usize) -> bool,
    ) -> Option<Vec<Weighed>> {
        let width = point.columns.len();
        let is_ordinary = |(i, values): (usize, &Vec<Bare<f64>>)| {
            !takes_part(i % width, i / width) || values.iter().all(|x| x.value.abs() < LARGEST)
        };
        if !self.values(point).iter().enumerate().all(is_ordinary) {
            return None;
        }
        let sums = self.direct(&point.map(Weighed::from), takes_part);
        sums.iter().all(|x| x.value.is_finite() && x.terms < LARGEST).then_some(sums)
    }

    /// How far the formulas are differentiated.
    pub(super) fn order(&self) -> Order {
        match self.claim {
            Claim::Derivatives { newton: true, .. } => Order::Second,
            _ => Order::First,
        }
    }

    /// What the document's formulas make the sums, over the point's pixels that take part.
    pub(super) fn direct<N: Number>(&self, point: &Point<N>, takes_part: impl Fn(usize, usize) -> bool) -> Vec<N> {
        let roots = self.roots();
        let given = |node: &Node| point.given(node);
        let mut evaluator = Evaluator::new(&self.graph, &roots, &self.parameters, self.order(), &given);
        let mut sums = vec![N::from(0.0); self.outputs()];
        for (row, outer) in point.rows.iter().enumerate() {
            for (column, x) in point.columns.iter().enumerate() {
                if !takes_part(column, row) {
                    continue;
                }
                let pixel = |channel| point.pixel(channel, column, row);
                let entries = self.entries(&evaluator.at(&|node| point.read(node, *x, outer, &pixel)));
                sums.iter_mut().zip(entries).for_each(|(sum, entry)| *sum = *sum + entry);
            }
        }
        sums
    }

    /// What one pixel adds, by its residual and variance.
    fn entries<N: Number>(&self, values: &[Hyper<N>]) -> Vec<N> {
        let n = self.parameters.len() as u16;
        let (residual, variance) = (&values[0], values.get(1));
        let mut entries = Vec::with_capacity(self.outputs());
        match self.claim {
            Claim::Value(kind) => {
                let variance = variance.map(|v| v.value);
                let [value, ..] = self.shape.direct(residual.value, variance);
                if kind == ValueKind::Full {
                    let logarithm = variance.filter(|_| self.shape.has_logarithm()).map(|v| v.call1(Function1::Log));
                    entries.push(logarithm.map_or(value, |logarithm| value + logarithm));
                }
                entries.push(value);
            }
            Claim::Derivatives { newton: true, part } => {
                let f = self.shape.newton(residual, variance);
                entries.push(f.value);
                if part.has_gradient() {
                    entries.extend(f.gradients(n));
                }
                if part.has_hessian() {
                    entries.extend(f.hessians(n));
                }
            }
            Claim::Derivatives { newton: false, part } => {
                let [value, l, q] = self.shape.direct(residual.value, variance.map(|v| v.value));
                let slopes: Vec<N> = residual.gradients(n).collect();
                entries.push(value);
                if part.has_gradient() {
                    entries.extend(slopes.iter().map(|slope| l * *slope));
                }
                if part.has_hessian() {
                    let rows = slopes.iter().enumerate();
                    entries.extend(rows.flat_map(|(i, u)| slopes[i..].iter().map(move |v| q * *u * *v)));
                }
            }
        }
        entries
    }

    /// What the program makes the sums, every pixel of the point taking part.
    fn found<N: Number>(&self, program: &Program, point: &Point<N>) -> Vec<N> {
        let pixel = |channel, column, row| point.pixel(channel, column, row);
        evaluate_at(program, &Sample { every_pixel: true, ..sample(program, point, &pixel) }).outputs
    }

    /// The value of the i-th free parameter.
    fn value(&self, i: usize, point: &Point<f64>) -> f64 {
        match self.graph.node(self.parameters[i]) {
            Node::Input(input) => point.input(*input),
            _ => f64::NAN,
        }
    }
}
