//! The check of programs that sum: F, gradients, Hessians, in every lowering.
//!
//! What comes in: what a program claims to sum, and drafts of such programs. What goes out: those that do. The reference values
//! are worked out once, however many drafts are held against them. It never knows how a draft was derived.

use std::sync::OnceLock;

use isophote_elementary::{DoubleDouble, Modular};

use crate::language::budget::Budget;
use crate::language::graph::{Graph, Node, NodeId};
use crate::language::model::Model;
use crate::program::interpreter;
use crate::program::{Bindings, ChannelId, Lanes, Op, Opcode, Precision, Program, Sink};
use crate::proof::budget::Room;
use crate::proof::claim::Claim;
use crate::proof::draft::Draft;
use crate::proof::evaluate::LoopNest;
use crate::proof::hyper::{Evaluator, Hyper};
use crate::proof::likelihood::Shape;
use crate::proof::pixels::{Rim, Windowed, set_of};
use crate::proof::points::{
    BESIDE, FAR, NEAR, Picture, Point, Random, anywhere, centre, limit, pictures, plausible, residues,
};
use crate::proof::subject::Subject;
use crate::proof::weighed::Weighed;
use crate::proof::{ENOUGH, Errors, POINTS, REFEREE, SMALLEST, TOLERANCE};

/// A parameter is left out of the error in f32 where changing it by itself changes F by less than this share.
const UNSEEN: f64 = 1e-12;
/// Units of work that a condition added to a domain may take.
const DOMAIN: usize = 4096;
/// Instructions of a program that is run in f32 on one row only.
const LONG: usize = 2000;

/// Works out what rounding errors are measured against.
type Weighing<'a> = Evaluator<'a, Hyper<Weighed>>;

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
    pictured: OnceLock<(Point<f64>, Vec<Picture>)>,
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
        // A referee outlives the derivation that paid for it.
        subject.graph.draw_on(Budget::with(DOMAIN));
        subject.domain = domain(&mut subject.graph, subject.domain);
        Referee { subject, rims: OnceLock::new(), windows: Default::default(), ..self.clone() }
    }

    /// The program, when it sums what it claims to; `dropped`: without pixels at the limit of one of these channels.
    pub fn proved(&self, draft: Draft, dropped: &[ChannelId]) -> Option<(Program, Errors)> {
        let errors = self.check(draft.program(), dropped)?;
        Some((draft.passed(), errors))
    }

    /// The program, when it is one that passed but for its saturated pixels, and leaves those of these channels out.
    pub fn proved_alike(&self, draft: Draft, dropped: &[ChannelId], passed: &Program) -> Option<Program> {
        let loops = LoopNest::of(draft.program());
        let is_right = loops.program().pixel_set().saturated.is_some() != dropped.is_empty()
            && loops.program().is_alike(passed)
            && self.windows(dropped).iter().all(|window| window.is_summed_by(&self.subject, &loops));
        is_right.then(|| draft.passed())
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
        let loops = &LoopNest::of(program);
        let agrees = |known: &Known<Modular, Modular>| self.subject.found(loops, &known.point) == known.sums;
        let exact = self.exact.get_or_init(|| self.residues(0..1)).iter().all(agrees)
            && (!(self.is_conditional || has_branches(program)) || self.further().iter().all(agrees));
        let (error, right) = match self.sampled() {
            Some(known) => self.compared(loops, known, |_| true),
            None => (None, true),
        };
        let right = right
            && (exact || error.is_some())
            && self.beside().iter().all(|known| self.compared(loops, known, |_| true).1)
            // Far off, powers may leave f64's range in a program that do not in the formulas: such a sum tells nothing.
            && (!self.is_conditional || self.far().iter().all(|known| self.compared(loops, known, f64::is_finite).1))
            && self.has_its_rims(program)
            && self.windows(dropped).iter().all(|window| window.is_summed_by(&self.subject, loops));
        right.then_some(Errors { exact, error })
    }

    fn further(&self) -> &[Known<Modular, Modular>] {
        self.exact_further.get_or_init(|| self.residues(1..self.room.points))
    }

    fn residues(&self, seeds: std::ops::Range<u64>) -> Vec<Known<Modular, Modular>> {
        let mut evaluator = self.subject.evaluator();
        let at = |seed| {
            let point = residues(&self.subject.model, &mut Random(seed));
            let sums = self.subject.summed(&mut evaluator, &point, |_, _| true, |_| true).unwrap_or_default();
            Known { point, sums }
        };
        seeds.map(at).collect()
    }

    /// True when no made-up point has a finite value: nothing is known of any program.
    pub fn is_blind(&self) -> bool {
        self.sampled().is_none()
    }

    fn known(&self, evaluator: &mut Weighing<'_>, point: Point<f64>) -> Option<Known<f64, Weighed>> {
        let sums = self.subject.weighed(evaluator, &point, |_, _| true)?;
        Some(Known { point, sums })
    }

    /// Single pixels somewhere, at any parameters: what formulas have a value for may be elsewhere than targets are put.
    fn anywhere(&self) -> &[Known<f64, Weighed>] {
        self.anywhere.get_or_init(|| {
            let mut evaluator = self.subject.evaluator();
            let at = |seed| self.known(&mut evaluator, anywhere(&self.subject.model, &mut Random(seed)));
            (0..self.room.elsewhere).filter_map(at).take(ENOUGH).collect()
        })
    }

    /// The first point where all is finite.
    fn sampled(&self) -> Option<&Known<f64, Weighed>> {
        let made = || {
            let mut evaluator = self.subject.evaluator();
            (0..POINTS).find_map(|seed| {
                let model = &self.subject.model;
                let point = plausible(model, centre(model, NEAR), &mut Random(seed));
                self.known(&mut evaluator, point)
            })
        };
        self.sampled.get_or_init(|| made().or_else(|| self.anywhere().first().cloned())).as_ref()
    }

    fn beside(&self) -> &[Known<f64, Weighed>] {
        self.beside.get_or_init(|| {
            let (model, subject) = (&self.subject.model, &self.subject);
            let (mut values, mut evaluator) = (subject.values(), subject.evaluator());
            let at = |seed| {
                let mut point = plausible(model, centre(model, BESIDE), &mut Random(seed));
                point.columns.truncate(2);
                point.rows.truncate(1);
                if !subject.show_threshold(&mut values, &mut point) {
                    return None;
                }
                self.known(&mut evaluator, point)
            };
            let found: Vec<_> = (0..if self.is_conditional { self.room.points } else { 1 }).filter_map(at).collect();
            if found.is_empty() { self.anywhere().to_vec() } else { found }
        })
    }

    /// Where every branch that far-off parameters take shows.
    fn far(&self) -> &[Known<f64, Weighed>] {
        self.far.get_or_init(|| {
            let mut evaluator = self.subject.evaluator();
            let at = |seed| {
                let mut random = Random(seed);
                let model = &self.subject.model;
                let mut point = plausible(model, centre(model, NEAR), &mut random);
                point.move_far(&mut random);
                self.known(&mut evaluator, point)
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
            let loops = LoopNest::of(&set);
            rims.iter().all(|rim| rim.is_of(&self.subject, &loops))
        }
    }

    fn rims(&self) -> &[Rim] {
        self.rims.get_or_init(|| Rim::all(&self.subject))
    }

    fn windows(&self, dropped: &[ChannelId]) -> &[Windowed] {
        self.windows[usize::from(!dropped.is_empty())].get_or_init(|| Windowed::all(&self.subject, dropped))
    }

    /// The error in f64 of the sums that are told, and whether that is rounding only.
    fn compared(
        &self,
        loops: &LoopNest<'_>,
        known: &Known<f64, Weighed>,
        is_told: fn(f64) -> bool,
    ) -> (Option<f64>, bool) {
        let found = self.subject.found(loops, &known.point);
        let told: Vec<usize> = (0..found.len()).filter(|i| is_told(found[*i])).collect();
        let sums = picked(&known.sums, &told);
        let error = worst(&picked(&found, &told), &sums);
        let is_rounding = || {
            let point = known.point.map(DoubleDouble::from);
            let (found, exact) = (self.subject.found(loops, &point), self.subject.direct(&point, |_, _| true));
            is_rounding(&picked(&found, &told), &picked(&exact, &told), &sums)
        };
        (Some(error), error <= TOLERANCE || is_rounding())
    }

    /// The gradient's error in f32 on a picture of the target beside its place, with pixels far from there; infinite where f32
    /// loses a sum that the formulas have; `None` when it is finite nowhere.
    pub fn f32_error(&self, program: &Program) -> Option<f64> {
        let height = if program.instructions().len() < LONG { 2 } else { 1 };
        let made = |seed| {
            let (model, mut random) = (&self.subject.model, Random(seed));
            let point = plausible(model, centre(model, FAR), &mut random);
            let pictures = pictures(model, &point, height, &mut random);
            (point, pictures)
        };
        let (point, pictures) = self.pictured.get_or_init(|| made(0));
        self.f32_error_at(program, point, pictures).or_else(|| {
            (1..POINTS).find_map(|seed| {
                let (point, pictures) = made(seed);
                self.f32_error_at(program, &point, &pictures)
            })
        })
    }

    fn f32_error_at(&self, program: &Program, point: &Point<f64>, pictures: &[Picture]) -> Option<f64> {
        let n = self.subject.parameters.len();
        let is_clipped = matches!(self.subject.shape, Shape::Clipped(..));
        let channels = 0..self.subject.model.channels.len();
        let saturation: Vec<f64> = channels.map(|c| if is_clipped { limit(c) } else { f64::INFINITY }).collect();
        let bindings = Bindings {
            parameters: &point.parameters,
            entry: &point.parameters,
            constants: &point.constants,
            saturation: &saturation,
            shift: &[],
        };
        let run = |precision, picture: &Picture| {
            interpreter::run(program, precision, Lanes::Four, &bindings, picture, picture.window, None).outputs
        };
        // A pixel where the sums are not finite in f64 either tells nothing.
        let sums = pictures.iter().map(|picture| [Precision::F32, Precision::F64].map(|p| run(p, picture)));
        let is_told = |sums: &[Vec<f64>; 2]| sums[1].iter().all(|x| x.is_finite());
        let [single, double] = sums.filter(is_told).reduce(|mut all, sums| {
            all.iter_mut().zip(&sums).for_each(|(all, sums)| all.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x));
            all
        })?;
        if !single.iter().all(|x| x.is_finite()) {
            return Some(f64::INFINITY);
        }
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
        (largest > 0.0).then_some(error / largest)
    }
}

/// True when what is summed takes branches, which one point does not show.
fn has_branches(program: &Program) -> bool {
    let Sink::Sums { accumulators, totals, outputs } = program.sink() else { return false };
    let summed = program.made_of(accumulators.iter().chain(totals).chain(outputs).copied());
    let branches = |op: Op| matches!(op.code, Opcode::Abs | Opcode::Select);
    program.instructions().iter().zip(summed).any(|(instruction, summed)| summed && branches(instruction.op))
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
