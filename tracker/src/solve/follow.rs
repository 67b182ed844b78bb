//! The short way through a stage from a start that is nearly right: where a target is predicted to be.
//!
//! What comes in: a [`CostFunction`] and a start. What goes out: moved parameters, the last pass and a report; or nothing, and
//! then the stage is run as from anywhere ([`stage::run`](crate::solve::stage::run)). It never knows kernels, pixels or time.
//!
//! The start fixes the pixel set and the weights of every pass, so that F of one pass is comparable with F of the next; where the
//! way has led to other pixels, they are taken anew at its end, and the way goes on. The
//! pass at the point where a step leads both judges that step and makes the next one. Lengths are in standard deviations,
//! `√(δᵀC⁻¹δ)`. Of two steps in a row of lengths a and b, with q = b/a, what is left after the second is at most
//! `b (q + q² + …) = b q/(1 − q)` where steps go on to shrink as they do. Newton's shrink faster, by a share that falls with
//! their length, down to what noise bends: so the next q is taken to be `(b + c)/(a + c)` of the last, with a c that is longer
//! than any noise. When what is left is a small share of a standard deviation the fit is over: two passes from a tenth of a
//! pixel, three from a whole one. Where the frame's budget ends it before, the last step is taken, though nothing has judged it:
//! from a start that is nearly right it leads nearer.
//!
//! The pass after a whole step is likely to be the last, and what it lacks is a gradient: H is much what it was. So it sums F and g
//! alone, and the report of the end with them, and its step is made of the H that the last one was made of. How much H changes on
//! the way the steps tell: of three in a row where F bends by its third derivatives T, `a`, then `b ≈ ½ T a²`, then `c ≈ T a b`
//! where H is kept, so that c/b is 2 b/a, and H itself changes by that share. A brightness that has changed is not seen in that, so
//! the diagonal of H is summed as well, to which H is scaled. Where either is too much the next pass sums all, else such passes
//! follow each other until little is left.
//!
//! What a start is wrong about is where the target is: the rest is as it was a frame ago. To second order a target that is
//! elsewhere looks like one that is wider and fainter as well, and Newton's step believes it. So a step that changes the rest by
//! more than noise does, though the places account for much of what it promises, moves the places alone; the next one moves all.

use crate::estimate::{Ending, StageReport, TracePoint};
use crate::scaled::Definite;
use crate::solve::stage::{Arrival, CostFunction, Pass, ROUNDS_AGAIN, Rules, Stride, eigen_resolution};
use crate::solve::trust::{Quadratic, Spectrum};

/// What may be left of the way to the minimum, in standard deviations.
const LEFT: f64 = 0.05;
/// A step this long, in standard deviations, shrinks the next one no more than a shorter one does.
const BENT: f64 = 30.0;
/// The Hessian of one pass serves the next one where steps show that it changes by no more than this share, …
const STALE: f64 = 0.15;
/// … and the entries of its diagonal, to which it is scaled, by no more than this one in the mean: that of a parameter which hardly
/// matters may change by itself.
const CHANGED: f64 = 0.1;
/// F a pixel may be this many times what it was where the step to the start began.
const WORSE: f64 = 1.5;
/// Passes after which a start was not nearly right.
const PASSES: u32 = 6;
/// A step moves the places alone where the rest would change by so many standard deviations more, …
const REST: f64 = 10.0;
/// … and the places alone take this share of what it promises.
const BY_PLACE: f64 = 0.25;

/// A way that has left no more than this share of its pixels needs no new ones: a budget. The pixels at the rim say little of the rest.
const PIXELS_CHANGED: f64 = 0.01;

/// What a start that was nearly right came to.
pub(crate) struct ShortWay {
    pub report: StageReport,
    /// At the point where the last step began; F is what it will be at its end.
    pub pass: Pass,
    /// The point that fixed the pixels and weights of that pass.
    pub entry: Vec<f64>,
    /// That pass summed the report of the end as well.
    pub is_told: bool,
    /// The factors of its Hessian, where its last step was made of them.
    pub factors: Option<Definite>,
}

/// How far from some point a way may lead.
pub(crate) struct Tether<'a> {
    /// All parameters.
    pub from: &'a [f64],
    /// In standard deviations.
    pub length: f64,
}

impl Tether<'_> {
    pub fn holds(&self, at: &[f64], rules: &Rules, pass: &Pass, variance: f64) -> bool {
        square_apart([at, self.from], rules, pass, variance) <= self.length * self.length
    }
}

/// How far two points are from each other, squared: `½ dᵀHd` over the variance of a residual.
fn square_apart([a, b]: [&[f64]; 2], rules: &Rules, pass: &Pass, variance: f64) -> f64 {
    let apart = |row: usize| a[rules.free[row]] - b[rules.free[row]];
    let columns = pass.quadratic.hessian.column_iter().enumerate();
    let term = |column: &[f64]| column.iter().enumerate().map(|(row, entry)| entry * apart(row)).sum::<f64>();
    let square: f64 = columns.map(|(number, column)| apart(number) * term(column.as_slice())).sum();
    0.5 * square / variance
}

/// Moves `point` to the minimum; lost, with `point` as it was, where a step does not do what it promises, where bounds or
/// rounding have a say, or where too many steps would be needed. What ends every pass is for the caller to find out anew.
/// `before`: the step that led to the point.
pub(crate) fn follow<P: CostFunction>(
    problem: &mut P,
    rules: &Rules,
    point: &mut [f64],
    before: Option<Stride>,
    tether: Option<&Tether>,
) -> Arrival<ShortWay> {
    let free = rules.free.len();
    let (mut at, mut entry, mut pass) = (point.to_vec(), point.to_vec(), Pass::of(free));
    let (of_places, moved) = (Definite::with_room(rules.places.len()), Vec::with_capacity(rules.places.len()));
    let mut step = Step { of_places, moved, ..Step::default() };
    let mut report = StageReport { ending: Ending::SmallStep, ..StageReport::default() };
    // F, and the length of the step from there; not known of one that did not move all.
    let mut earlier: Option<(f64, Option<f64>)> = None;
    // By how much F should fall by the step at hand.
    let mut promised = None;
    let mut is_clear = false;
    // How often pixels were taken anew, and passes since.
    let (mut again, mut passes) = (0, 0);
    while passes < PASSES.min(rules.iterations) {
        let closing = if is_clear { problem.closing(&at, &entry, &mut pass) } else { None };
        let is_closing = closing.is_some();
        // By what share the diagonal of H differs from that of the H at hand.
        let changed = match closing.unwrap_or_else(|| problem.gradient(&at, &entry, &mut pass).map(|()| 0.0)) {
            Ok(changed) => changed,
            Err(Ending::Budget) => return left(promised, rules, report, (pass, entry), (at, point)),
            Err(_) => return Arrival::Lost,
        };
        if report.passes == 0 {
            (report.pixels_first, report.pixels_least) = (pass.pixels, pass.pixels);
        }
        (report.pixels_least, report.pixels_last) = (report.pixels_least.min(pass.pixels), pass.pixels);
        report.passes += 1;
        passes += 1;
        if pass.pixels < rules.pixels_needed(report.pixels_first) || !pass.quadratic.is_finite() {
            return Arrival::Lost;
        }
        pass.quadratic.hold_back(&rules.bounds, |row| at[rules.free[row]]);
        let objective = pass.quadratic.objective;
        let slack = rules.slack(objective, pass.pixels);
        if rules.is_traced {
            let fell = |promised: f64| Some((earlier?.0 - objective + slack) / (promised + slack));
            report.note(TracePoint { objective, radius: None, ratio: promised.and_then(fell) });
        }
        if report.passes == 1 {
            // Over other pixels F is much the same only by the pixel.
            earlier = before.map(|stride| (WORSE * stride.mean * pass.pixels as f64, stride.length));
        }
        if earlier.is_some_and(|(last, _)| objective > last + slack) {
            return Arrival::Lost;
        }
        let whole = match is_closing {
            true => Some(step.again(&pass.quadratic)),
            false => step.newton(&pass.quadratic, eigen_resolution(rules.precision)),
        };
        let Some(whole) = whole else { return Arrival::Lost };
        let of_places = if is_closing { None } else { step.of_places(rules, &pass, whole) };
        let (is_whole, reduction) = (of_places.is_none(), of_places.unwrap_or(whole));
        let variance = if rules.noise { 1.0 } else { rules.reduced(&pass).unwrap_or(0.0) };
        if !reduction.is_finite() || variance <= 0.0 {
            return Arrival::Lost;
        }
        report.iterations += 1;
        rules.free.iter().zip(&step.delta).for_each(|(&i, delta)| at[i] += delta);
        if !problem.allowed(&at) {
            return Arrival::Lost;
        }
        let length = (reduction.max(0.0) / variance).sqrt();
        if tether.is_some_and(|tether| !tether.holds(&at, rules, &pass, variance)) {
            let stride = Stride { length: is_whole.then_some(length), mean: objective / pass.pixels as f64 };
            return Arrival::Far { parameters: at, stride, report };
        }
        let last = earlier.and_then(|(_, last)| last);
        let serves = is_closing && last.is_some_and(|last| serves(last, length, changed));
        let is_over = |last| if is_closing { serves && is_closed(last, length) } else { is_near(last, length) };
        if is_whole && last.is_some_and(is_over) {
            let is_free = rules.has_domain && tether.is_none();
            if is_free && problem.moved(&entry, &at).is_some_and(|moved| moved.changed() > PIXELS_CHANGED) {
                if again == ROUNDS_AGAIN {
                    return Arrival::Lost;
                }
                // Over other pixels F is another.
                earlier = Some((f64::INFINITY, Some(square_apart([&at, &entry], rules, &pass, variance).sqrt())));
                (again, passes, promised, is_clear) = (again + 1, 0, None, false);
                entry.copy_from_slice(&at);
                continue;
            }
            point.copy_from_slice(&at);
            pass.quadratic.objective -= reduction;
            let factors = Some(step.definite);
            return Arrival::There(ShortWay { report, pass, entry, is_told: is_closing, factors });
        }
        is_clear = if is_closing { serves } else { step.is_clear && is_whole };
        // Of a step by a Hessian that does not serve the next one's length tells little.
        earlier = Some((objective, if is_closing && !serves { last } else { is_whole.then_some(length) }));
        promised = Some(reduction);
    }
    Arrival::Lost
}

/// What a way that was left has come to: the end of its last step.
fn left(
    promised: Option<f64>,
    rules: &Rules,
    report: StageReport,
    (mut pass, entry): (Pass, Vec<f64>),
    (at, point): (Vec<f64>, &mut [f64]),
) -> Arrival<ShortWay> {
    let Some(reduction) = promised else { return Arrival::Lost };
    rules.free.iter().for_each(|&i| point[i] = at[i]);
    pass.quadratic.objective -= reduction;
    let report = StageReport { ending: Ending::Budget, ..report };
    Arrival::There(ShortWay { report, pass, entry, is_told: false, factors: None })
}

/// A step from one point, in the memory of those before it.
#[derive(Default)]
struct Step {
    definite: Definite,
    /// The factors of the places alone.
    of_places: Definite,
    /// The step was made of the factors, which have no eigenvalue near zero.
    is_clear: bool,
    delta: Vec<f64>,
    /// Of the places alone.
    moved: Vec<f64>,
}

impl Step {
    /// Becomes `−H⁻¹g`; by how much F falls there, where H bends upwards.
    fn newton(&mut self, quadratic: &Quadratic, resolution: f64) -> Option<f64> {
        let Quadratic { gradient, hessian, .. } = quadratic;
        self.is_clear = false;
        if !self.definite.become_of(hessian, gradient.len(), |row| row) {
            return None;
        }
        self.is_clear = self.definite.is_clear(resolution);
        if self.is_clear {
            return Some(self.definite.newton_step(gradient.iter().copied(), &mut self.delta));
        }
        let spectrum = Spectrum::new(quadratic, &self.definite.scale(), resolution)?;
        let step = spectrum.step(f64::INFINITY);
        self.delta.clear();
        self.delta.extend(step.delta.iter());
        (step.interior && !spectrum.is_indefinite()).then_some(step.reduction)
    }

    /// Becomes `−H⁻¹g` by the factors that it has, of an H that was scaled since; by how much F falls there.
    fn again(&mut self, quadratic: &Quadratic) -> f64 {
        self.definite.scaled_to(&quadratic.hessian);
        self.definite.newton_step(quadratic.gradient.iter().copied(), &mut self.delta)
    }

    /// Becomes the same with all but the places held, where that is the better step of the two: the whole one promises `whole`.
    /// By how much F falls there.
    fn of_places(&mut self, rules: &Rules, pass: &Pass, whole: f64) -> Option<f64> {
        let Quadratic { objective, gradient, hessian, .. } = &pass.quadratic;
        // Of a residual, as far as it will be left.
        let variance = match rules.noise {
            true => 1.0,
            false => (objective - whole) / pass.pixels.max(1) as f64 + rules.rounding_variance,
        };
        let much = REST * REST * variance;
        if whole <= much {
            return None;
        }
        if !self.of_places.become_of(hessian, rules.places.len(), |row| rules.places[row]) {
            return None;
        }
        let slopes = rules.places.iter().map(|&row| gradient[row]);
        let reduction = self.of_places.newton_step(slopes, &mut self.moved);
        if whole - reduction <= much || reduction <= BY_PLACE * whole {
            return None;
        }
        self.delta.fill(0.0);
        rules.places.iter().zip(&self.moved).for_each(|(&row, moved)| self.delta[row] = *moved);
        Some(reduction)
    }
}

/// Whether little is left after a step of that length, the one before it being `last` long.
fn is_near(last: f64, length: f64) -> bool {
    let ratio = length / last;
    let next = ratio * (length + BENT) / (last + BENT);
    length == 0.0 || ratio < 1.0 && length * next / (1.0 - next) <= LEFT
}

/// The same of a step by the last one's Hessian.
fn is_closed(last: f64, length: f64) -> bool {
    let share = 2.0 * length / last;
    length <= 0.5 * LEFT || share < 1.0 && length * share / (1.0 - share) <= LEFT
}

/// Whether a Hessian whose diagonal has changed by that share serves for the next step, and as that of the end.
fn serves(last: f64, length: f64, changed: f64) -> bool {
    changed <= CHANGED && 2.0 * length <= STALE * last + LEFT
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::solve::stage::Renewal;
    use crate::solve::trust::Curvature;
    use isophote_symbolic::Precision;

    /// Residuals `tanh(3 (u − 0.1 i)) − tanh(3 (0.7 − 0.1 i))` of unit variance, times `contrast`, and a curve that is
    /// not what its derivatives say where that is wanted.
    struct Curve {
        contrast: f64,
        passes: u32,
        is_false: bool,
        most: f64,
        entries: Vec<f64>,
        /// Passes without a Hessian; `None` where there are none.
        closings: Option<u32>,
    }

    impl CostFunction for Curve {
        fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
            let (mut objective, mut gradient, mut hessian) = (0.0, 0.0, 0.0);
            for i in 0..15 {
                let value = |u: f64| (3.0 * (u - 0.1 * f64::from(i))).tanh();
                let sign = if self.is_false { -1.0 } else { 1.0 };
                let residual = self.contrast * (value(point[0]) - value(0.7));
                let slope = 3.0 * self.contrast * (1.0 - value(point[0]).powi(2));
                objective += residual * residual;
                gradient += sign * 2.0 * residual * slope;
                hessian += 2.0 * slope * slope;
            }
            let (gradient, hessian) = (DVector::from_element(1, gradient), DMatrix::from_element(1, 1, hessian));
            pass.quadratic = Quadratic { objective, gradient, hessian, curvature: Curvature::GaussNewton };
            pass.pixels = 15;
            self.passes += 1;
            self.entries.push(entry[0]);
            Ok(())
        }

        fn closing(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Option<Result<f64, Ending>> {
            *self.closings.as_mut()? += 1;
            let hessian = pass.quadratic.hessian.clone();
            let ran = self.gradient(point, entry, pass);
            let changed = pass.quadratic.hessian[(0, 0)] / hessian[(0, 0)] - 1.0;
            Some(ran.map(|()| changed.abs()))
        }

        fn allowed(&self, point: &[f64]) -> bool {
            point[0] < self.most
        }
    }

    fn run(start: f64, most: f64, is_false: bool) -> (Option<StageReport>, f64, Curve) {
        let rules = Rules { window_pixels: 15, ..rules_of(1, Vec::new()) };
        let mut curve = Curve { contrast: 100.0, passes: 0, is_false, most, entries: Vec::new(), closings: None };
        let mut point = [start];
        let followed = follow(&mut curve, &rules, &mut point, None, None).there();
        (followed.map(|followed| followed.report), point[0], curve)
    }

    #[test]
    fn a_start_that_is_nearly_right_takes_few_passes_over_its_own_pixels() {
        // σ = 1/√(Σ slope²).
        let slope = |i: i32| 300.0 * (1.0 - (3.0 * (0.7 - 0.1 * f64::from(i))).tanh().powi(2));
        let deviation = (0..15).map(|i| slope(i).powi(2)).sum::<f64>().powf(-0.5);
        for (off, passes) in [(0.0, 2), (0.004, 2), (-0.01, 2), (-0.1, 3)] {
            let (report, end, curve) = run(0.7 + off, 1.0, false);
            let report = report.unwrap_or_else(|| panic!("{off}: not followed, {} passes", curve.passes));
            assert!((end - 0.7).abs() <= LEFT * deviation, "{off}: {} σ left", (end - 0.7).abs() / deviation);
            assert!(report.passes <= passes, "{off}: {report:?}");
            let ratios: Vec<Option<f64>> = report.trace.iter().map(|point| point.ratio).collect();
            assert!(ratios.len() == report.passes as usize && ratios[0].is_none(), "{ratios:?}");
            // From the minimum itself nothing is promised, and nothing falls.
            let is_right = |ratio: &f64| off == 0.0 || (0.5..1.5).contains(ratio);
            assert!(ratios[1..].iter().flatten().all(is_right), "{ratios:?}");
            assert!(curve.entries.iter().all(|entry| *entry == 0.7 + off));
        }
    }

    #[test]
    fn the_hessian_of_the_last_pass_but_one_serves_where_it_is_that_of_the_end() {
        let hessian = |curve: &mut Curve| {
            let mut pass = Pass::of(1);
            curve.gradient(&[0.7], &[0.7], &mut pass).unwrap();
            pass.quadratic.hessian[(0, 0)]
        };
        let mut served = 0;
        for off in [0.0, 0.0005, 0.004, -0.01, 0.03, -0.1, 0.15] {
            let rules = Rules { window_pixels: 15, ..rules_of(1, Vec::new()) };
            let entries = Vec::new();
            let mut curve =
                Curve { contrast: 100.0, passes: 0, is_false: false, most: 1.0, entries, closings: Some(0) };
            let mut point = [0.7 + off];
            let way = follow(&mut curve, &rules, &mut point, None, None).there().unwrap();
            let (found, wanted) = (way.pass.quadratic.hessian[(0, 0)], hessian(&mut curve));
            let deviation = (2.0 / wanted).sqrt();
            assert!((point[0] - 0.7).abs() <= LEFT * deviation, "{off}: {} σ left", (point[0] - 0.7).abs() / deviation);
            assert!((found / wanted - 1.0).abs() <= 0.02, "{off}: the Hessian is {} times that", found / wanted);
            assert!(way.report.passes <= 3, "{off}: {:?}", way.report);
            served += u32::from(way.is_told);
        }
        assert!(served >= 5, "{served} of 7 ended so");
    }

    /// A target whose brightness has changed is where it was, so the second step is short; its Hessian is another.
    #[test]
    fn a_brightness_that_has_changed_asks_for_another_hessian() {
        assert!(serves(40.0, 0.01, 0.05) && is_closed(40.0, 0.01));
        assert!(!serves(40.0, 0.01, 0.3));
        let mut matrix = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 1.0]);
        assert!((crate::scaled::to_diagonal(&mut matrix, &[4.4, 1.0]) - 0.05).abs() < 1e-12);
        assert!((matrix[(0, 0)] - 4.4).abs() < 1e-12 && (matrix[(0, 1)] - 1.1_f64.sqrt()).abs() < 1e-12, "{matrix}");
        for none in [0.0, -1.0, f64::NAN, 100.0] {
            assert_eq!(crate::scaled::to_diagonal(&mut matrix.clone(), &[none, 1.0]), f64::INFINITY);
        }
    }

    /// A bell of height 100 and deviation 1.3 at 0, with residuals of unit variance, by its place, width and height.
    struct Bell;

    impl CostFunction for Bell {
        fn gradient(&mut self, point: &[f64], _: &[f64], pass: &mut Pass) -> Result<(), Ending> {
            let (mut objective, mut gradient, mut hessian) = (0.0, DVector::zeros(3), DMatrix::zeros(3, 3));
            let bell = |x: f64, deviation: f64| (-0.5 * (x / deviation).powi(2)).exp();
            for i in -20..=20 {
                let (x, [place, width, height]) = (0.5 * f64::from(i), [point[0], point[1], point[2]]);
                let (at, value) = (x - place, bell(x - place, width));
                let residual = height * value - 100.0 * bell(x, 1.3);
                let slopes =
                    DVector::from_vec(vec![at / width.powi(2), at * at / width.powi(3), 1.0 / height]) * height * value;
                objective += residual * residual;
                gradient += 2.0 * residual * &slopes;
                hessian += 2.0 * &slopes * slopes.transpose();
            }
            pass.quadratic = Quadratic { objective, gradient, hessian, curvature: Curvature::GaussNewton };
            pass.pixels = 41;
            Ok(())
        }

        fn allowed(&self, point: &[f64]) -> bool {
            point[1] > 0.0
        }
    }

    fn rules_of(free: usize, places: Vec<usize>) -> Rules {
        Rules {
            free: (0..free).collect(),
            bounds: vec![[f64::NEG_INFINITY, f64::INFINITY]; free].into(),
            places: places.into(),
            iterations: 50,
            tolerance: 1e-3,
            noise: true,
            renewal: Renewal::ByRound,
            has_domain: true,
            settles: true,
            precision: Precision::F32,
            rounding: 0.0,
            rounding_variance: 0.0,
            is_traced: true,
            window_pixels: 41,
        }
    }

    #[test]
    fn a_target_that_is_farther_off_than_it_is_wide_is_moved_before_it_is_changed() {
        for (off, places, passes) in
            [(0.1, vec![0], 2), (1.0, vec![0], 3), (1.0, vec![], 4), (2.0, vec![0], 4), (2.0, vec![], 0)]
        {
            let mut point = [off, 1.3, 100.0];
            let followed = follow(&mut Bell, &rules_of(3, places), &mut point, None, None);
            assert_eq!(followed.there().map_or(0, |way| way.report.passes), passes, "{off}: {point:?}");
            assert!(passes == 0 || point[0].abs() < 1e-3 && (point[2] - 100.0).abs() < 0.1, "{off}: {point:?}");
        }
    }

    #[test]
    fn a_way_ends_where_its_tether_does() {
        let from = [0.3, 1.3, 100.0];
        let run = |length: f64| {
            let (mut point, tether) = (from, Tether { from: &from, length });
            let arrival = follow(&mut Bell, &rules_of(3, vec![0]), &mut point, None, Some(&tether));
            (arrival, point)
        };
        let (Arrival::Far { parameters, report, .. }, _) = run(1.0) else { panic!("it is not held") };
        assert!(report.passes == 1 && parameters[0].abs() < 0.05, "one step leads most of the way: {parameters:?}");
        let (Arrival::There(way), point) = run(1000.0) else { panic!("it does not arrive") };
        assert!(way.report.passes > 1 && point[0].abs() < 0.05, "{point:?}");
    }

    #[test]
    fn what_is_not_nearly_right_is_left_as_it_was() {
        // Too far, past a bound, and a gradient that F does not follow.
        for (start, most, is_false) in [(-1.5, 1.0, false), (0.68, 0.69, false), (0.69, 1.0, true)] {
            let (report, end, _) = run(start, most, is_false);
            assert!(report.is_none() && end == start, "{start}: {report:?}");
        }
    }
}
