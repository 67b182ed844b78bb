//! Checks programs that sum (F, gradients, Hessians), in every lowering, against their claim. The reference values are
//! computed once for all programs, independently of the derivation.

use std::sync::{Arc, OnceLock};

use isophote_elementary::{DoubleDouble, Modular};

use crate::graph::budget::Budget;
use crate::graph::hyper::{Evaluator, Hyper};
use crate::graph::random::Random;
use crate::graph::{Graph, Node, NodeId};
use crate::likelihood::claim::Claim;
use crate::likelihood::shape::Shape;
use crate::model::Summand;
use crate::model::points::{BESIDE, FAR, NEAR, Point, anywhere, centre, limit, plausible, residues};
use crate::program::interpreter;
use crate::program::{Bindings, ChannelId, Lanes, LoopNest, Op, Opcode, ParameterId, Precision, Sink};
use crate::proof::budget::{self, Room};
use crate::proof::evaluate::ByLevel;
use crate::proof::pictures::Picture;
use crate::proof::pictures::pictures;
use crate::proof::pixels::{Rim, Windowed, set_of};
use crate::proof::program::Program;
use crate::proof::subject::Subject;
use crate::proof::weighed::Weighed;
use crate::proof::{ENOUGH, Errors, POINTS, REFEREE, SMALLEST, TOLERANCE};
use isophote_syntax::diagnostic::Diagnostics;

/// A parameter is left out of the error in f32 if changing it alone changes F by less than this share.
const UNSEEN: f64 = 1e-12;
/// Budget of a condition added to a domain, in units of work.
const DOMAIN: usize = 4096;
/// Number of instructions from which a program is run in f32 on one row only.
const LONG: usize = 2000;

/// Evaluates the scale of rounding errors.
type Weighing<'a> = Evaluator<'a, Hyper<Weighed>>;

/// A point, and the sums there.
#[derive(Clone, Debug)]
struct Known<N, M> {
    point: Point<N>,
    sums: Vec<M>,
}

/// Checks loop nests against their claim; see the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Referee {
    pub(super) subject: Subject,
    is_conditional: bool,
    room: Room,
    points: Points,
    pixels: PixelSets,
}

/// Points and the sums there, made up when a check needs them.
#[derive(Clone, Debug, Default)]
struct Points {
    exact: OnceLock<Vec<Known<Modular, Modular>>>,
    /// Further points, for branches of the formulas or of a program.
    exact_further: OnceLock<Vec<Known<Modular, Modular>>>,
    sampled: OnceLock<Option<Known<f64, Weighed>>>,
    /// Single pixels anywhere at which the formulas have a value.
    anywhere: OnceLock<Vec<Known<f64, Weighed>>>,
    /// Points on the other side of the origin, and about the loss' threshold.
    beside: OnceLock<Vec<Known<f64, Weighed>>>,
    far: OnceLock<Vec<Known<f64, Weighed>>>,
    pictured: OnceLock<(Point<f64>, Vec<Picture>)>,
}

/// The same for the pixels of a domain.
#[derive(Clone, Debug, Default)]
struct PixelSets {
    rims: OnceLock<Vec<Rim>>,
    windows: [OnceLock<Vec<Windowed>>; 2],
}

impl Referee {
    /// The referee of a claim, if the document's budget allows one.
    pub fn of(summand: &Summand, subset: &[ParameterId], claim: Claim) -> Result<Arc<Referee>, Diagnostics> {
        let room = budget::room(summand, subset, claim).ok_or_else(|| summand.costly())?;
        let subject = Subject::of(summand, subset, claim)?;
        let reachable = subject.graph.reachable(&subject.roots());
        let is_conditional = subject.shape.is_conditional()
            || reachable.iter().any(|n| matches!(subject.graph.node(*n), Node::Select(..) | Node::Abs(_)));
        Ok(Arc::new(Referee { subject, is_conditional, room, points: Points::default(), pixels: PixelSets::default() }))
    }

    pub fn summand(&self) -> &Summand {
        &self.subject.summand
    }

    pub fn claim(&self) -> Claim {
        self.subject.claim
    }

    /// The same sums over fewer pixels.
    pub fn within(&self, domain: impl FnOnce(&mut Graph, Option<NodeId>) -> Option<NodeId>) -> Referee {
        let mut subject = self.subject.clone();
        // A referee outlives the derivation that paid for it, so this draws on a budget of its own.
        subject.graph.draw_on(Budget::with(DOMAIN));
        subject.domain = domain(&mut subject.graph, subject.domain);
        Referee { subject, pixels: PixelSets::default(), ..self.clone() }
    }

    /// The program, if it passes; `dropped`: it leaves out pixels at the limit of one of these channels.
    pub fn proved(&self, nest: LoopNest, dropped: &[ChannelId]) -> Option<(Program, Errors)> {
        let errors = self.check(&nest, dropped)?;
        Some((Program::passed(nest), errors))
    }

    /// The program, if it equals one that passed except for leaving out pixels saturated in these channels.
    pub fn proved_alike(&self, nest: LoopNest, dropped: &[ChannelId], passed: &Program) -> Option<Program> {
        let loops = ByLevel::of(&nest);
        let is_right = loops.program().pixel_set().saturated.is_some() != dropped.is_empty()
            && loops.program().is_alike(passed)
            && self.windows(dropped).iter().all(|window| window.is_summed_by(&self.subject, &loops));
        is_right.then(|| Program::passed(nest))
    }

    pub(super) fn check(&self, program: &LoopNest, dropped: &[ChannelId]) -> Option<Errors> {
        let outputs = program.sink().outputs().len();
        let set = program.pixel_set();
        let is_whole = set.bounds.is_none() && set.mask.is_none();
        if outputs != self.subject.outputs()
            || (self.subject.domain.is_none() && !is_whole)
            || set.saturated.is_some() == dropped.is_empty()
        {
            return None;
        }
        let loops = &ByLevel::of(program);
        let agrees = |known: &Known<Modular, Modular>| self.subject.found(loops, &known.point) == known.sums;
        let exact = self.points.exact.get_or_init(|| self.residues(0..1)).iter().all(agrees)
            && (!(self.is_conditional || has_branches(program)) || self.further().iter().all(agrees));
        let (error, right) = match self.sampled() {
            Some(known) => self.compared(loops, known, |_| true),
            None => (None, true),
        };
        let right = right
            && (exact || error.is_some())
            && self.beside().iter().all(|known| self.compared(loops, known, |_| true).1)
            // Far off, a program's powers may leave f64's range where the formulas' do not: such a sum is no evidence.
            && (!self.is_conditional || self.far().iter().all(|known| self.compared(loops, known, f64::is_finite).1))
            && self.has_its_rims(program)
            && self.windows(dropped).iter().all(|window| window.is_summed_by(&self.subject, loops));
        right.then_some(Errors { exact, error })
    }

    fn further(&self) -> &[Known<Modular, Modular>] {
        self.points.exact_further.get_or_init(|| self.residues(1..self.room.points))
    }

    fn residues(&self, seeds: std::ops::Range<u64>) -> Vec<Known<Modular, Modular>> {
        let mut evaluator = self.subject.evaluator();
        let at = |seed| {
            let point = residues(self.subject.model(), &mut Random(seed));
            let sums = self.subject.summed(&mut evaluator, &point, |_, _| true, |_| true).unwrap_or_default();
            Known { point, sums }
        };
        seeds.map(at).collect()
    }

    /// True when no made-up point has a finite value: no program can be checked.
    pub fn is_blind(&self) -> bool {
        self.sampled().is_none()
    }

    fn known(&self, evaluator: &mut Weighing<'_>, point: Point<f64>) -> Option<Known<f64, Weighed>> {
        let sums = self.subject.weighed(evaluator, &point, |_, _| true)?;
        Some(Known { point, sums })
    }

    /// Single pixels anywhere, at any parameters: formulas may have values elsewhere than at the made-up targets.
    fn anywhere(&self) -> &[Known<f64, Weighed>] {
        self.points.anywhere.get_or_init(|| {
            let mut evaluator = self.subject.evaluator();
            let at = |seed| self.known(&mut evaluator, anywhere(self.subject.model(), &mut Random(seed)));
            (0..self.room.elsewhere).filter_map(at).take(ENOUGH).collect()
        })
    }

    /// The first point where all sums are finite.
    fn sampled(&self) -> Option<&Known<f64, Weighed>> {
        let made = || {
            let mut evaluator = self.subject.evaluator();
            (0..POINTS).find_map(|seed| {
                let model = self.subject.model();
                let point = plausible(model, centre(model, NEAR), &mut Random(seed));
                self.known(&mut evaluator, point)
            })
        };
        self.points.sampled.get_or_init(|| made().or_else(|| self.anywhere().first().cloned())).as_ref()
    }

    fn beside(&self) -> &[Known<f64, Weighed>] {
        self.points.beside.get_or_init(|| {
            let (model, subject) = (self.subject.model(), &self.subject);
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

    /// Points with far-off parameters, for the branches taken there.
    fn far(&self) -> &[Known<f64, Weighed>] {
        self.points.far.get_or_init(|| {
            let mut evaluator = self.subject.evaluator();
            let at = |seed| {
                let mut random = Random(seed);
                let model = self.subject.model();
                let mut point = plausible(model, centre(model, NEAR), &mut random);
                point.move_far(&mut random);
                self.known(&mut evaluator, point)
            };
            (0..self.room.points).filter_map(at).collect()
        })
    }

    /// True when the pixel set ends where the domain does.
    fn has_its_rims(&self, program: &LoopNest) -> bool {
        let rims = self.rims();
        rims.is_empty() || {
            let mut set = set_of(program);
            set.pixel_set.saturated = None;
            let loops = ByLevel::of(&set);
            rims.iter().all(|rim| rim.is_of(&self.subject, &loops))
        }
    }

    fn rims(&self) -> &[Rim] {
        self.pixels.rims.get_or_init(|| Rim::all(&self.subject))
    }

    fn windows(&self, dropped: &[ChannelId]) -> &[Windowed] {
        self.pixels.windows[usize::from(!dropped.is_empty())].get_or_init(|| Windowed::all(&self.subject, dropped))
    }

    /// The error in f64 of the sums that `is_told` selects, and whether it is rounding only.
    fn compared(
        &self,
        loops: &ByLevel<'_>,
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

    /// The gradient's error in f32 on a picture of the slightly displaced target, and on pixels far from it; infinite
    /// where f32 loses a sum that the formulas have; `None` when it is finite nowhere.
    pub fn f32_error(&self, program: &LoopNest) -> Option<f64> {
        let height = if program.instructions().len() < LONG { 2 } else { 1 };
        let made = |seed| {
            let (model, mut random) = (self.subject.model(), Random(seed));
            let point = plausible(model, centre(model, FAR), &mut random);
            let pictures = pictures(&self.subject.summand, &point, height, &mut random);
            (point, pictures)
        };
        let (point, pictures) = self.points.pictured.get_or_init(|| made(0));
        self.f32_error_at(program, point, pictures).or_else(|| {
            (1..POINTS).find_map(|seed| {
                let (point, pictures) = made(seed);
                self.f32_error_at(program, &point, &pictures)
            })
        })
    }

    fn f32_error_at(&self, program: &LoopNest, point: &Point<f64>, pictures: &[Picture]) -> Option<f64> {
        let n = self.subject.parameters.len();
        let is_clipped = matches!(self.subject.shape, Shape::Clipped(..));
        let channels = 0..self.subject.model().channels.len();
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
        // A pixel where the sums are not finite in f64 either is no evidence.
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

/// True when the sums depend on branches, which one point does not all take.
fn has_branches(program: &LoopNest) -> bool {
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

/// True when in double-double the difference vanishes against the value or the sum of the absolute terms.
pub(super) fn is_rounding(found: &[DoubleDouble], exact: &[DoubleDouble], weighed: &[Weighed]) -> bool {
    let is_near = |((found, exact), weighed): ((&DoubleDouble, &DoubleDouble), &Weighed)| {
        (*found - *exact).to_f64().abs() <= REFEREE * weighed.terms.max(exact.to_f64().abs()).max(SMALLEST)
    };
    found.iter().zip(exact).zip(weighed).all(is_near)
}
