//! Checks which pixels a program sums: bounds, masks and limits against the domain itself, at single rims and over a
//! difficult window; rows without pixels must leave no trace.

use isophote_elementary::DoubleDouble;

use crate::graph::hyper::Values;
use crate::graph::random::Random;
use crate::graph::{Node, NodeId};
use crate::likelihood::shape::Shape;
use crate::model::points::{FAR, NEAR, Point, SIZE, centre, limit, plausible};
use crate::program::peephole::arrange;
use crate::program::{ChannelId, LoopNest, Sink};
use crate::proof::TOLERANCE;
use crate::proof::evaluate::{ByLevel, evaluate_at};
use crate::proof::referee::{is_rounding, worst};
use crate::proof::subject::{Subject, sample};
use crate::proof::weighed::Weighed;

/// Distance from a rim, px, within which a pixel may fall on either side.
pub(super) const RIM: f64 = 1e-6;
/// Maximum number of halvings of a step between columns.
const HALVINGS: u32 = 32;
/// Steps between columns, px: the first each way from the target, then doubling, and their number.
const STEP: f64 = 1.37;
const STEPS: i32 = 11;
/// Maximum number of windows tried to find one with pixels.
const WINDOWS: u64 = 3;

/// Tests positions for the domain, at fixed parameters and pixels.
struct Inside<'a> {
    evaluator: Option<Values<'a, f64>>,
    point: &'a Point<f64>,
}

impl<'a> Inside<'a> {
    fn of(subject: &'a Subject, roots: &'a [NodeId], point: &'a Point<f64>) -> Inside<'a> {
        let given = |node: &Node| point.given(node);
        let evaluator = (!roots.is_empty()).then(|| Values::of(&subject.graph, roots, &given));
        Inside { evaluator, point }
    }

    fn holds(&mut self, x: f64, outer: &[f64], pixel: &dyn Fn(usize) -> f64) -> bool {
        let point = self.point;
        let evaluator = self.evaluator.as_mut();
        evaluator.is_none_or(|evaluator| evaluator.holds_at(&|node| point.read(node, x, outer, pixel)))
    }

    /// True where a small step along a coordinate may change the result.
    fn is_rim(&mut self, x: f64, outer: &[f64], pixel: &dyn Fn(usize) -> f64, near: f64) -> bool {
        let here = self.holds(x, outer, pixel);
        let mut differs = |x: f64, outer: &[f64]| self.holds(x, outer, pixel) != here;
        // Where a domain changes within so little, a few steps show it.
        [1.0, -1.0, 0.61, -0.37, 0.23].into_iter().any(|part| {
            let step = part * near;
            let mut beside = |i: usize| {
                let mut moved = outer.to_vec();
                moved[i] += step;
                differs(x, &moved)
            };
            (0..outer.len()).any(&mut beside) || differs(x + step, outer)
        })
    }
}

/// Columns from the middle outwards, and both sides of every rim between them.
pub(super) fn columns_at_rims(middle: f64, inside: &mut dyn FnMut(f64) -> bool) -> Vec<f64> {
    let outwards = (0..STEPS).map(|i| STEP * 2.0_f64.powi(i));
    let mut columns: Vec<f64> = outwards.clone().rev().map(|step| middle - step).collect();
    columns.push(middle);
    columns.extend(outwards.map(|step| middle + step));
    let mut at_right = inside(columns[0]);
    for i in 1..columns.len() {
        let (mut left, mut right) = (columns[i - 1], columns[i]);
        let at_left = std::mem::replace(&mut at_right, inside(right));
        if at_left != at_right {
            for _ in 0..HALVINGS {
                if right - left <= 0.5 * RIM {
                    break;
                }
                let between = 0.5 * (left + right);
                if inside(between) == at_left { left = between } else { right = between }
            }
            columns.extend([left - RIM, right + RIM]);
        }
    }
    columns
}

fn roots(subject: &Subject) -> Vec<NodeId> {
    subject.domain.into_iter().collect()
}

/// A row, and which of its columns are in the domain: whole ones, and both sides of every rim between them.
#[derive(Clone, Debug)]
pub(super) struct Rim {
    point: Point<f64>,
    inside: Vec<bool>,
}

impl Rim {
    /// Rims of a row near the target, one through it, and one far from it; then of a target elsewhere, so that centres
    /// have either sign.
    pub fn all(subject: &Subject) -> Vec<Rim> {
        if subject.domain.is_none() {
            return Vec::new();
        }
        let mut rims = Vec::new();
        for (seed, place, is_near) in [(0, NEAR, true), (1, FAR, false)] {
            let middle = centre(subject.model(), place);
            let base = plausible(subject.model(), middle, &mut Random(seed));
            let mut rows = Vec::new();
            if is_near || base.rows[0].is_empty() {
                rows.push(base.rows[0].clone());
            }
            if let [y, ..] = base.rows[0][..] {
                let along = |y: f64| {
                    let mut row = base.rows[0].clone();
                    row[0] = y;
                    row
                };
                rows.push(along(middle[1].round()));
                rows.extend(is_near.then(|| along(y + 40.0 * SIZE)));
            }
            let of = |row| Rim::of(subject, Point { rows: vec![row], ..base.clone() }, middle[0]);
            rims.extend(rows.into_iter().map(of));
        }
        rims
    }

    fn of(subject: &Subject, mut point: Point<f64>, middle: f64) -> Rim {
        let at_limit = matches!(subject.shape, Shape::Clipped(..));
        let channels = subject.model().channels.len();
        let shown = |channel: usize| if at_limit { limit(channel) + 5.0 } else { limit(channel) - 5.0 };
        let outer = point.rows[0].clone();
        let roots = roots(subject);
        let (columns, inside) = {
            let mut domain = Inside::of(subject, &roots, &point);
            let columns = columns_at_rims(middle, &mut |x| domain.holds(x, &outer, &shown));
            let inside = columns.iter().map(|x| domain.holds(*x, &outer, &shown)).collect();
            (columns, inside)
        };
        point.pixels = (0..channels).flat_map(|c| std::iter::repeat_n(shown(c), columns.len())).collect();
        point.columns = columns;
        Rim { point, inside }
    }

    /// True when the program, or its bare pixel set, takes exactly these pixels of the row, except at rims.
    pub fn is_of(&self, subject: &Subject, loops: &ByLevel<'_>) -> bool {
        let pixel = |channel, column, row| self.point.pixel(channel, column, row);
        let taken = evaluate_at(loops, &sample(loops, &self.point, &pixel)).taken;
        let wrong = differing(&self.inside, &taken);
        are_rims(subject, &self.point, &wrong, 0.5 * RIM)
    }
}

/// Where two lists differ.
fn differing(a: &[bool], b: &[bool]) -> Vec<usize> {
    (0..a.len()).filter(|i| b.get(*i) != Some(&a[*i])).collect()
}

/// True when a small step along a coordinate may change the result at all of these pixels, numbered row by row.
fn are_rims(subject: &Subject, point: &Point<f64>, pixels: &[usize], near: f64) -> bool {
    let roots = roots(subject);
    let mut domain = Inside::of(subject, &roots, point);
    pixels.iter().all(|index| {
        let (column, row) = (index % point.columns.len(), index / point.columns.len());
        let pixel = |channel: usize| point.pixel(channel, column, row);
        domain.is_rim(point.columns[column], &point.rows[row], &pixel, near)
    })
}

/// The program's pixel set, without any sums.
pub(super) fn set_of(program: &LoopNest) -> LoopNest {
    let mut set = program.clone();
    set.sink = Sink::Sums { accumulators: Vec::new(), totals: Vec::new(), outputs: Vec::new() };
    arrange(&mut set);
    set
}

/// A window with rows inside and outside of the domain, one row with all pixels at their limit, and single such pixels;
/// or one that is all outside.
#[derive(Clone, Debug)]
pub(super) struct Windowed {
    point: Point<f64>,
    /// Row by row.
    pub taken: Vec<bool>,
    /// The sums; `None` where they are not finite.
    pub sums: Option<Vec<Weighed>>,
}

impl Windowed {
    /// The windows of a subject; `dropped`: channels whose limit leaves a pixel out.
    pub fn all(subject: &Subject, dropped: &[ChannelId]) -> Vec<Windowed> {
        if subject.domain.is_none() && dropped.is_empty() {
            return Vec::new();
        }
        let at = |seed: u64| Windowed::of(subject, dropped, &mut Random(seed));
        let is_good = |window: &Windowed| window.sums.is_some() && window.taken.contains(&true);
        let good = (0..WINDOWS).map(at).find(is_good).or_else(|| Some(at(0)));
        let away = good.as_ref().filter(|window| window.sums.is_some()).map(|window| window.far_away(subject, dropped));
        good.into_iter().chain(away).collect()
    }

    fn of(subject: &Subject, dropped: &[ChannelId], random: &mut Random) -> Windowed {
        let model = subject.model();
        let middle = centre(model, NEAR);
        let mut point = plausible(model, middle, random);
        // One column and one row pass through the target: there, one pixel is at its limit in one channel alone.
        point.columns.truncate(1);
        point.columns.push(middle[0].round());
        point.columns.extend(subject.domain.map(|_| (middle[0] + 40.0 * SIZE).round()));
        if let Some(y) = point.rows[0].first_mut() {
            *y = middle[1].round() + 1.0;
        }
        let near = point.rows[0].clone();
        point.rows.truncate(1);
        if !near.is_empty() {
            let along = |y: f64| {
                let mut row = near.clone();
                row[0] = y.round();
                row
            };
            if subject.domain.is_some() {
                point.rows.extend([along(middle[1] - 40.0 * SIZE), along(middle[1] + 40.0 * SIZE)]);
            }
            // In this row every pixel is at the limit of a channel.
            point.rows.push(along(near[0] + 1.0));
        }
        let (width, height) = (point.columns.len(), point.rows.len());
        let last = model.channels.len() - 1;
        let pixel = |channel: usize, index: usize, random: &mut Random| {
            let is_last_row = height > 1 && index / width + 1 == height;
            let through = index % width == 1;
            limit(channel)
                + match (is_last_row, through) {
                    (true, false) => (random.bits() % 3) as f64,
                    (true, true) if channel == last => 0.0,
                    (false, true) if channel == 0 => 0.0,
                    _ => -1.0 - 70.0 * random.signed().abs(),
                }
        };
        let channels = 0..model.channels.len();
        point.pixels =
            channels.flat_map(|c| (0..width * height).map(move |i| (c, i))).map(|(c, i)| pixel(c, i, random)).collect();
        Windowed::at(subject, dropped, point)
    }

    fn far_away(&self, subject: &Subject, dropped: &[ChannelId]) -> Windowed {
        let mut point = self.point.clone();
        point.columns.iter_mut().for_each(|x| *x += 80.0 * SIZE);
        Windowed::at(subject, dropped, point)
    }

    pub fn at(subject: &Subject, dropped: &[ChannelId], point: Point<f64>) -> Windowed {
        let roots = roots(subject);
        let mut taken = Vec::new();
        {
            let mut domain = Inside::of(subject, &roots, &point);
            for (row, outer) in point.rows.iter().enumerate() {
                for (column, x) in point.columns.iter().enumerate() {
                    let pixel = |channel: usize| point.pixel(channel, column, row);
                    let at_limit = dropped.iter().any(|c| point.limits[c.index()] <= pixel(c.index()));
                    taken.push(!at_limit && domain.holds(*x, outer, &pixel));
                }
            }
        }
        let mut window = Windowed { point, taken, sums: None };
        let evaluator = &mut subject.evaluator();
        window.sums = subject.weighed(evaluator, &window.point, |column, row| window.takes(column, row));
        window
    }

    fn takes(&self, column: usize, row: usize) -> bool {
        self.taken[row * self.point.columns.len() + column]
    }

    /// True when the program takes these pixels, and its sums agree with the document's.
    pub fn is_summed_by(&self, subject: &Subject, loops: &ByLevel<'_>) -> bool {
        let pixel = |channel, column, row| self.point.pixel(channel, column, row);
        let found = evaluate_at(loops, &sample(loops, &self.point, &pixel));
        let wrong = differing(&self.taken, &found.taken);
        if !wrong.is_empty() {
            return are_rims(subject, &self.point, &wrong, RIM);
        }
        // Sums over no pixels are not read: they are 0, or NaN at parameters without a value.
        let Some(sums) = self.sums.as_ref().filter(|_| self.taken.contains(&true)) else { return true };
        worst(&found.outputs, sums) <= TOLERANCE || {
            let point = self.point.map(DoubleDouble::from);
            let exact = subject.direct(&point, |column, row| self.takes(column, row));
            let pixel = |channel, column, row| point.pixel(channel, column, row);
            is_rounding(&evaluate_at(loops, &sample(loops, &point, &pixel)).outputs, &exact, sums)
        }
    }
}
