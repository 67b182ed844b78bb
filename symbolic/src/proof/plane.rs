//! Checks programs that fill a plane (predictions, variances, rendered pictures): each pixel must have its formula's
//! value, exactly modulo a prime and in f64. The reference is the formula's graph as it was read, at the shifted
//! coordinates, evaluated node by node.

use isophote_elementary::DoubleDouble;

use crate::graph::hyper::Values;
use crate::graph::random::Random;
use crate::graph::{Graph, Node, NodeId};
use crate::model::Summand;
use crate::model::points::{FAR, NEAR, Point, SIZE, anywhere, centre, plausible, residues};
use crate::program::{AccumulatorId, Instruction, Level, LoopNest, Opcode, Sink, TotalId, Value};
use crate::proof::evaluate::{ByLevel, Number, Raster, evaluate_at};
use crate::proof::pixels::{RIM, columns_at_rims};
use crate::proof::program::Program;
use crate::proof::weighed::Weighed;
use crate::proof::{ANYWHERE, CONDITIONAL_POINTS, ENOUGH, REFEREE, SMALLEST, TOLERANCE};

/// The claimed contents of a plane.
pub(crate) struct Shown<'a> {
    pub summand: &'a Summand,
    pub graph: &'a Graph,
    pub value: NodeId,
    /// NaN outside of this domain.
    pub domain: Option<NodeId>,
    /// Reads the coordinates plus their shifts.
    pub is_shifted: bool,
}

/// The program, when it passes.
pub(crate) fn proved(shown: &Shown<'_>, nest: LoopNest) -> Option<Program> {
    shown.is_what(&nest).then(|| Program::passed(nest))
}

impl Shown<'_> {
    fn is_what(&self, program: &LoopNest) -> bool {
        let Some(summing) = summing(program) else { return false };
        let summing = ByLevel::of(&summing);
        let exact = (0..CONDITIONAL_POINTS).all(|seed| {
            let point = residues(self.summand.model(), &mut Random(seed));
            self.values(&point) == pixels(&summing, &point)
        });
        let mut compared = 0;
        let right = (0..CONDITIONAL_POINTS).all(|seed| {
            let mut random = Random(seed);
            let mut point = plausible(self.summand.model(), centre(self.summand.model(), NEAR), &mut random);
            if seed > 0 && seed % 2 == 0 {
                point.move_far(&mut random);
            }
            self.is_right_at(&summing, &point, &mut compared)
        });
        let is_shown = exact || compared > 0 || self.is_right_anywhere(&summing);
        right && is_shown && self.is_right_at_rims(&summing)
    }

    /// True when there is a pixel with a finite value, and the program is right at all of them.
    fn is_right_anywhere(&self, summing: &ByLevel<'_>) -> bool {
        let mut compared = 0;
        self.anywhere().all(|point| self.is_right_at(summing, &point, &mut compared)) && compared > 0
    }

    /// Pixels with a finite value.
    fn anywhere(&self) -> impl Iterator<Item = Point<f64>> {
        let points = (0..ANYWHERE).map(|seed| anywhere(self.summand.model(), &mut Random(seed)));
        points.filter(|point| self.values(point).iter().all(|x| x.is_finite())).take(ENOUGH)
    }

    /// True when there are none: no program can be checked.
    pub fn is_blind(&self) -> bool {
        self.anywhere().next().is_none()
    }

    /// True when the plane ends where the domain does.
    fn is_right_at_rims(&self, summing: &ByLevel<'_>) -> bool {
        let Some(domain) = self.domain else { return true };
        let roots = [domain];
        [(NEAR, 0.0), (FAR, 0.0), (NEAR, 2.0 * SIZE)].into_iter().all(|(place, off)| {
            let middle = centre(self.summand.model(), place);
            let mut point = plausible(self.summand.model(), middle, &mut Random(1));
            if let Some(y) = point.rows[0].first_mut() {
                *y += off;
            }
            let mut truths = Values::of(self.graph, &roots, &|node| point.given(node));
            let outer = point.rows[0].clone();
            let mut inside = |x: f64| truths.holds_at(&|node| point.read(node, x, &outer, &|_| 0.0));
            let mut columns = columns_at_rims(middle[0], &mut inside);
            columns.retain(|x| {
                let here = inside(*x);
                [0.5, -0.5, 0.31, -0.19, 0.11].into_iter().all(|part| inside(x + part * RIM) == here)
            });
            let expected: Vec<bool> = columns.iter().map(|x| inside(*x)).collect();
            point.pixels = vec![0.0; self.summand.model().channels.len() * columns.len()];
            (point.columns, point.rows) = (columns, vec![outer]);
            let (shown, formula) = (pixels(summing, &point), self.values(&point));
            // Infinite parts permit any value.
            let is_shown = |((inside, shown), formula): ((&bool, &f64), &f64)| match inside {
                true => !formula.is_finite() || !shown.is_nan(),
                false => shown.is_nan(),
            };
            expected.iter().zip(&shown).zip(&formula).all(is_shown)
        })
    }

    fn is_right_at(&self, summing: &ByLevel<'_>, point: &Point<f64>, compared: &mut usize) -> bool {
        let expected = self.values(&point.map(Weighed::from));
        let found = pixels(summing, point);
        let is_near = |(found, expected): (&f64, &Weighed)| {
            (found.is_nan() && expected.value.is_nan())
                || !expected.terms.is_finite()
                || (found - expected.value).abs() <= TOLERANCE * expected.terms.max(SMALLEST)
        };
        *compared += expected.iter().filter(|x| x.value.is_finite() && x.terms.is_finite()).count();
        found.len() == expected.len()
            && (found.iter().zip(&expected).all(is_near) || {
                let point = point.map(DoubleDouble::from);
                let (found, exact) = (pixels(summing, &point), self.values(&point));
                found.iter().zip(&exact).zip(&expected).all(|((found, exact), expected)| {
                    let error = (*found - *exact).to_f64().abs();
                    !expected.value.is_finite()
                        || !expected.terms.is_finite()
                        || error <= REFEREE * expected.terms.max(SMALLEST)
                })
            })
    }

    /// The formula at each pixel, row by row.
    fn values<N: Number>(&self, point: &Point<N>) -> Vec<N> {
        let roots: Vec<NodeId> = vec![self.value];
        let domain: Vec<NodeId> = self.domain.into_iter().collect();
        let given = |node: &Node| point.given(node);
        let mut numbers = Values::of(self.graph, &roots, &given);
        let mut truths = Values::of(self.graph, &domain, &given);
        let shift = |c: usize| if self.is_shifted { point.shift[c] } else { N::from(0.0) };
        let mut values = Vec::with_capacity(point.rows.len() * point.columns.len());
        for (row, outer) in point.rows.iter().enumerate() {
            let outer: Vec<N> = outer.iter().enumerate().map(|(i, c)| *c + shift(1 + i)).collect();
            for (column, x) in point.columns.iter().enumerate() {
                let pixel = |channel| point.pixel(channel, column, row);
                let leaf = |node: &Node| point.read(node, *x + shift(0), &outer, &pixel);
                values.push(match domain.is_empty() || truths.holds_at(&leaf) {
                    true => numbers.at(&leaf)[0].value,
                    false => N::from(f64::NAN),
                });
            }
        }
        values
    }
}

/// The same program with its plane's value summed: over one pixel the sum is the pixel.
fn summing(program: &LoopNest) -> Option<LoopNest> {
    let Sink::Plane(value) = program.sink else { return None };
    let mut program = program.clone();
    let first = program.instructions.len() as u32;
    let ends = [(Opcode::RowTotal(AccumulatorId(0)), Level::RowEnd), (Opcode::PassTotal(TotalId(0)), Level::PassEnd)];
    program.instructions.extend(ends.map(|(code, level)| Instruction { op: code.of([]), level, span: None }));
    let (totals, outputs) = (vec![Value(first)], vec![Value(first + 1)]);
    program.sink = Sink::Sums { accumulators: vec![value], totals, outputs };
    Some(program)
}

/// The program's values at each pixel, row by row. A pixel outside of the program's own set shows nothing.
fn pixels<N: Number>(summing: &ByLevel<'_>, point: &Point<N>) -> Vec<N> {
    let mut values = Vec::with_capacity(point.rows.len() * point.columns.len());
    for (row, outer) in point.rows.iter().enumerate() {
        for (column, x) in point.columns.iter().enumerate() {
            let sample = Raster {
                inputs: summing.program().inputs().iter().map(|input| point.input(*input)).collect(),
                columns: vec![*x],
                rows: vec![outer.clone()],
                pixel: &|channel, _, _| point.pixel(channel, column, row),
                every_pixel: false,
            };
            values.extend(evaluate_at(summing, &sample).outputs);
        }
    }
    values
}
