//! Refinement: a few Newton steps from a start that is nearly right, as where a target is predicted to be. Where it
//! fails, the stage is run as from anywhere ([`stage::run`](crate::solve::stage::run)).
//!
//! The start fixes the pixel set and the weights of every pass, so that F is comparable between passes; where the way has
//! led to other pixels, they are renewed at its end and the way continues. The pass at the end of a step both judges that
//! step and makes the next one. Lengths are in standard deviations, `√(δᵀC⁻¹δ)`. After two successive steps of lengths a
//! and b, with q = b/a, the remaining distance is at most `b (q + q² + …) = b q/(1 − q)` if steps keep shrinking by q.
//! Newton's steps shrink faster, by a ratio that falls with their length down to the floor set by noise: the next q is
//! estimated as `(b + c)/(a + c)` times the last, with a c longer than any noise. The fit ends when the remainder is a
//! small fraction of a standard deviation: two passes from a tenth of a pixel, three from a whole one. Where the frame's
//! budget ends it earlier, the last step is taken without being judged: from a nearly right start it leads nearer.
//!
//! The pass after a full step is probably the last; it needs a new gradient, but H has hardly changed. So it sums only F
//! and g, with the end report, and reuses the last step's H. The step lengths tell how much H changes: of three successive
//! ones, with T the third derivatives of F, `a`, then `b ≈ ½ T a²`, then `c ≈ T a b` where H is kept, so that c/b is 2 b/a,
//! and H itself changes by that ratio. A changed brightness does not show in that, so the diagonal of H is summed as well,
//! and H is scaled to it. Where either change is too large the next pass sums all; otherwise such passes repeat until
//! little remains.
//!
//! A prediction is mostly wrong about position: the other parameters are as in the last frame. To second order a shifted
//! target also looks wider and fainter, and Newton's step takes it for that. So a step that changes the other parameters by
//! more than noise does, although position explains much of its predicted reduction, moves the position alone; the next
//! step moves all.

use crate::estimate::{Ending, StageReport, TracePoint};
use crate::scaled::Definite;
use crate::solve::stage::{CostFunction, Pass, PreviousStep, ROUNDS_AGAIN, RefineOutcome, Rules, eigen_resolution};
use crate::solve::trust::{Quadratic, Spectrum};

/// Largest remaining distance to the minimum, in standard deviations.
const REMAINING_MAX: f64 = 0.05;
/// The constant c of the module's estimate, in standard deviations: longer steps shrink the next one less.
const BENT: f64 = 30.0;
/// The Hessian of one pass serves the next where step lengths show that it changes by no more than this ratio.
const STALE: f64 = 0.15;
/// The same for the mean change of the diagonal's entries, to which H is scaled; an insignificant parameter's entry may
/// change more.
const CHANGED: f64 = 0.1;
/// Largest ratio of F per pixel at the start to that where the step to the start began.
const WORSE: f64 = 1.5;
/// Most passes from a start that is nearly right.
const PASSES: u32 = 6;
/// A step moves the position alone where the other parameters account for more than this many standard deviations of it.
const OTHER_CHANGE_MAX: f64 = 10.0;
/// A step moves the position alone where that achieves this fraction of the full step's reduction.
const POSITION_SHARE: f64 = 0.25;

/// A budget: pixels are renewed where more than this fraction of them has changed. Rim pixels say little about the rest.
const PIXELS_CHANGED: f64 = 0.01;

/// The result of a refinement.
pub(crate) struct Refinement {
    pub report: StageReport,
    /// The pass where the last step began, with F predicted for the step's end.
    pub pass: Pass,
    /// The parameters that fixed the pixels and weights of that pass.
    pub entry: Vec<f64>,
    /// That pass also summed the end report.
    pub has_end_report: bool,
    /// The factors of its Hessian, if the last step used them.
    pub factors: Option<Definite>,
}

/// A limit on the distance from a point.
pub(crate) struct DistanceLimit<'a> {
    /// All parameters.
    pub from: &'a [f64],
    /// In standard deviations.
    pub length: f64,
}

impl DistanceLimit<'_> {
    pub fn contains(&self, at: &[f64], rules: &Rules, pass: &Pass, variance: f64) -> bool {
        squared_distance([at, self.from], rules, pass, variance) <= self.length * self.length
    }
}

/// Squared distance of two points: `½ dᵀHd` over the variance of a residual.
fn squared_distance([a, b]: [&[f64]; 2], rules: &Rules, pass: &Pass, variance: f64) -> f64 {
    let apart = |row: usize| a[rules.free[row]] - b[rules.free[row]];
    let columns = pass.quadratic.hessian.column_iter().enumerate();
    let term = |column: &[f64]| column.iter().enumerate().map(|(row, entry)| entry * apart(row)).sum::<f64>();
    let square: f64 = columns.map(|(number, column)| apart(number) * term(column.as_slice())).sum();
    0.5 * square / variance
}

/// Moves `point` to the minimum. `Failed`, with `point` unchanged, where a step does not reduce F as predicted, where
/// bounds or rounding interfere, or after too many steps. `before`: the step that led to the point. Causes that end
/// every pass are for the caller to detect again.
pub(crate) fn refine<P: CostFunction>(
    problem: &mut P,
    rules: &Rules,
    point: &mut [f64],
    before: Option<PreviousStep>,
    distance_limit: Option<&DistanceLimit>,
) -> RefineOutcome<Refinement> {
    let free = rules.free.len();
    let (mut at, mut entry, mut pass) = (point.to_vec(), point.to_vec(), Pass::of(free));
    let (of_position, moved) =
        (Definite::with_capacity(rules.position_rows.len()), Vec::with_capacity(rules.position_rows.len()));
    let mut step = Step { of_position, moved, ..Step::default() };
    let mut report = StageReport { ending: Ending::SmallStep, ..StageReport::default() };
    // F, and the length of the step from there; no length if it moved the position alone.
    let mut earlier: Option<(f64, Option<f64>)> = None;
    // Predicted reduction of F by the current step.
    let mut predicted_reduction = None;
    let mut is_clear = false;
    // Renewals of the pixels, and passes since the last.
    let (mut again, mut passes) = (0, 0);
    while passes < PASSES.min(rules.iterations) {
        let closing = if is_clear { problem.closing(&at, &entry, &mut pass) } else { None };
        let is_closing = closing.is_some();
        // Relative change of the diagonal of H against the H in use.
        let changed = match closing.unwrap_or_else(|| problem.gradient(&at, &entry, &mut pass).map(|()| 0.0)) {
            Ok(changed) => changed,
            Err(Ending::Budget) => return interrupted(predicted_reduction, rules, report, (pass, entry), (at, point)),
            Err(_) => return RefineOutcome::Failed,
        };
        if report.passes == 0 {
            (report.pixels_first, report.pixels_least) = (pass.pixels, pass.pixels);
        }
        (report.pixels_least, report.pixels_last) = (report.pixels_least.min(pass.pixels), pass.pixels);
        report.passes += 1;
        passes += 1;
        if pass.pixels < rules.pixels_needed(report.pixels_first) || !pass.quadratic.is_finite() {
            return RefineOutcome::Failed;
        }
        pass.quadratic.fix_at_bounds(&rules.bounds, |row| at[rules.free[row]]);
        let objective = pass.quadratic.objective;
        let slack = rules.slack(objective, pass.pixels);
        if rules.is_traced {
            let fell =
                |predicted_reduction: f64| Some((earlier?.0 - objective + slack) / (predicted_reduction + slack));
            report.note(TracePoint { objective, radius: None, ratio: predicted_reduction.and_then(fell) });
        }
        if report.passes == 1 {
            // The pixels differ, so only F per pixel is comparable.
            earlier =
                before.map(|previous_step| (WORSE * previous_step.mean * pass.pixels as f64, previous_step.length));
        }
        if earlier.is_some_and(|(last, _)| objective > last + slack) {
            return RefineOutcome::Failed;
        }
        let full_reduction = match is_closing {
            true => Some(step.again(&pass.quadratic)),
            false => step.newton(&pass.quadratic, eigen_resolution(rules.precision)),
        };
        let Some(full_reduction) = full_reduction else { return RefineOutcome::Failed };
        let of_position = if is_closing { None } else { step.of_position(rules, &pass, full_reduction) };
        let (is_full, reduction) = (of_position.is_none(), of_position.unwrap_or(full_reduction));
        let variance = if rules.noise { 1.0 } else { rules.reduced_chi_square(&pass).unwrap_or(0.0) };
        if !reduction.is_finite() || variance <= 0.0 {
            return RefineOutcome::Failed;
        }
        report.iterations += 1;
        rules.free.iter().zip(&step.delta).for_each(|(&i, delta)| at[i] += delta);
        if !problem.allowed(&at) {
            return RefineOutcome::Failed;
        }
        let length = (reduction.max(0.0) / variance).sqrt();
        if distance_limit.is_some_and(|distance_limit| !distance_limit.contains(&at, rules, &pass, variance)) {
            let previous_step =
                PreviousStep { length: is_full.then_some(length), mean: objective / pass.pixels as f64 };
            return RefineOutcome::BeyondLimit { parameters: at, previous_step, report };
        }
        let last = earlier.and_then(|(_, last)| last);
        let is_hessian_current = is_closing && last.is_some_and(|last| is_hessian_current(last, length, changed));
        let is_over =
            |last| if is_closing { is_hessian_current && is_closed(last, length) } else { is_near(last, length) };
        if is_full && last.is_some_and(is_over) {
            let is_free = rules.has_domain && distance_limit.is_none();
            if is_free && problem.moved(&entry, &at).is_some_and(|moved| moved.changed() > PIXELS_CHANGED) {
                if again == ROUNDS_AGAIN {
                    return RefineOutcome::Failed;
                }
                // F over other pixels is not comparable.
                earlier = Some((f64::INFINITY, Some(squared_distance([&at, &entry], rules, &pass, variance).sqrt())));
                (again, passes, predicted_reduction, is_clear) = (again + 1, 0, None, false);
                entry.copy_from_slice(&at);
                continue;
            }
            point.copy_from_slice(&at);
            pass.quadratic.objective -= reduction;
            let factors = Some(step.definite);
            return RefineOutcome::Done(Refinement { report, pass, entry, has_end_report: is_closing, factors });
        }
        is_clear = if is_closing { is_hessian_current } else { step.is_clear && is_full };
        // The length of a step with an unsuitable Hessian says little about the next.
        earlier = Some((objective, if is_closing && !is_hessian_current { last } else { is_full.then_some(length) }));
        predicted_reduction = Some(reduction);
    }
    RefineOutcome::Failed
}

/// The result of an interrupted way: the end of its last step.
fn interrupted(
    predicted_reduction: Option<f64>,
    rules: &Rules,
    report: StageReport,
    (mut pass, entry): (Pass, Vec<f64>),
    (at, point): (Vec<f64>, &mut [f64]),
) -> RefineOutcome<Refinement> {
    let Some(reduction) = predicted_reduction else { return RefineOutcome::Failed };
    rules.free.iter().for_each(|&i| point[i] = at[i]);
    pass.quadratic.objective -= reduction;
    let report = StageReport { ending: Ending::Budget, ..report };
    RefineOutcome::Done(Refinement { report, pass, entry, has_end_report: false, factors: None })
}

/// A step with buffers reused between points.
#[derive(Default)]
struct Step {
    definite: Definite,
    /// The factors for the position's parameters alone.
    of_position: Definite,
    /// The step used the factors, which have no eigenvalue near zero.
    is_clear: bool,
    delta: Vec<f64>,
    /// The position's part of the step.
    moved: Vec<f64>,
}

impl Step {
    /// Computes `−H⁻¹g`; returns the predicted reduction of F, or `None` where H is indefinite.
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

    /// Computes `−H⁻¹g` with the existing factors, rescaled to the new diagonal; returns the predicted reduction of F.
    fn again(&mut self, quadratic: &Quadratic) -> f64 {
        self.definite.scaled_to(&quadratic.hessian);
        self.definite.newton_step(quadratic.gradient.iter().copied(), &mut self.delta)
    }

    /// Computes the step of the position alone, where that is preferable to the full step, whose reduction is
    /// `full_reduction`; returns the predicted reduction of F.
    fn of_position(&mut self, rules: &Rules, pass: &Pass, full_reduction: f64) -> Option<f64> {
        let Quadratic { objective, gradient, hessian, .. } = &pass.quadratic;
        // The residual variance expected after the step.
        let variance = match rules.noise {
            true => 1.0,
            false => (objective - full_reduction) / pass.pixels.max(1) as f64 + rules.rounding_variance,
        };
        let much = OTHER_CHANGE_MAX * OTHER_CHANGE_MAX * variance;
        if full_reduction <= much {
            return None;
        }
        if !self.of_position.become_of(hessian, rules.position_rows.len(), |row| rules.position_rows[row]) {
            return None;
        }
        let slopes = rules.position_rows.iter().map(|&row| gradient[row]);
        let reduction = self.of_position.newton_step(slopes, &mut self.moved);
        if full_reduction - reduction <= much || reduction <= POSITION_SHARE * full_reduction {
            return None;
        }
        self.delta.fill(0.0);
        rules.position_rows.iter().zip(&self.moved).for_each(|(&row, moved)| self.delta[row] = *moved);
        Some(reduction)
    }
}

/// Whether little remains after a step of this length that followed one of length `last`.
fn is_near(last: f64, length: f64) -> bool {
    let ratio = length / last;
    let next = ratio * (length + BENT) / (last + BENT);
    length == 0.0 || ratio < 1.0 && length * next / (1.0 - next) <= REMAINING_MAX
}

/// Like [`is_near`], for a step with the previous Hessian.
fn is_closed(last: f64, length: f64) -> bool {
    let share = 2.0 * length / last;
    length <= 0.5 * REMAINING_MAX || share < 1.0 && length * share / (1.0 - share) <= REMAINING_MAX
}

/// Whether a Hessian whose diagonal has changed by `changed` serves for the next step and as the final one.
fn is_hessian_current(last: f64, length: f64, changed: f64) -> bool {
    changed <= CHANGED && 2.0 * length <= STALE * last + REMAINING_MAX
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::solve::stage::Renewal;
    use crate::solve::trust::Curvature;
    use isophote_symbolic::Precision;

    /// Residuals `tanh(3 (u − 0.1 i)) − tanh(3 (0.7 − 0.1 i))` of unit variance, times `contrast`; optionally with
    /// derivatives of the wrong sign.
    struct Curve {
        contrast: f64,
        passes: u32,
        is_false: bool,
        most: f64,
        entries: Vec<f64>,
        /// Passes without a Hessian; `None` where they are unsupported.
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
        let refined = refine(&mut curve, &rules, &mut point, None, None).done();
        (refined.map(|refined| refined.report), point[0], curve)
    }

    #[test]
    fn a_good_start_takes_few_passes_over_its_own_pixels() {
        // σ = 1/√(Σ slope²).
        let slope = |i: i32| 300.0 * (1.0 - (3.0 * (0.7 - 0.1 * f64::from(i))).tanh().powi(2));
        let deviation = (0..15).map(|i| slope(i).powi(2)).sum::<f64>().powf(-0.5);
        for (off, passes) in [(0.0, 2), (0.004, 2), (-0.01, 2), (-0.1, 3)] {
            let (report, end, curve) = run(0.7 + off, 1.0, false);
            let report = report.unwrap_or_else(|| panic!("{off}: not followed, {} passes", curve.passes));
            assert!((end - 0.7).abs() <= REMAINING_MAX * deviation, "{off}: {} σ left", (end - 0.7).abs() / deviation);
            assert!(report.passes <= passes, "{off}: {report:?}");
            let ratios: Vec<Option<f64>> = report.trace.iter().map(|point| point.ratio).collect();
            assert!(ratios.len() == report.passes as usize && ratios[0].is_none(), "{ratios:?}");
            // From the minimum itself no reduction is predicted, and none happens.
            let is_right = |ratio: &f64| off == 0.0 || (0.5..1.5).contains(ratio);
            assert!(ratios[1..].iter().flatten().all(is_right), "{ratios:?}");
            assert!(curve.entries.iter().all(|entry| *entry == 0.7 + off));
        }
    }

    #[test]
    fn the_previous_hessian_is_reused_where_it_approximates_the_final_one() {
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
            let refinement = refine(&mut curve, &rules, &mut point, None, None).done().unwrap();
            let (found, wanted) = (refinement.pass.quadratic.hessian[(0, 0)], hessian(&mut curve));
            let deviation = (2.0 / wanted).sqrt();
            assert!(
                (point[0] - 0.7).abs() <= REMAINING_MAX * deviation,
                "{off}: {} σ left",
                (point[0] - 0.7).abs() / deviation
            );
            assert!((found / wanted - 1.0).abs() <= 0.02, "{off}: the Hessian is {} times that", found / wanted);
            assert!(refinement.report.passes <= 3, "{off}: {:?}", refinement.report);
            served += u32::from(refinement.has_end_report);
        }
        assert!(served >= 5, "{served} of 7 ended so");
    }

    /// A target that only changed its brightness has not moved, so the second step is short; but its Hessian is different.
    #[test]
    fn a_changed_brightness_requires_a_new_hessian() {
        assert!(is_hessian_current(40.0, 0.01, 0.05) && is_closed(40.0, 0.01));
        assert!(!is_hessian_current(40.0, 0.01, 0.3));
        let mut matrix = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 1.0]);
        assert!((crate::scaled::to_diagonal(&mut matrix, &[4.4, 1.0]) - 0.05).abs() < 1e-12);
        assert!((matrix[(0, 0)] - 4.4).abs() < 1e-12 && (matrix[(0, 1)] - 1.1_f64.sqrt()).abs() < 1e-12, "{matrix}");
        for none in [0.0, -1.0, f64::NAN, 100.0] {
            assert_eq!(crate::scaled::to_diagonal(&mut matrix.clone(), &[none, 1.0]), f64::INFINITY);
        }
    }

    /// A Gaussian of height 100 and deviation 1.3 at 0, with residuals of unit variance, by position, width and height.
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

    fn rules_of(free: usize, position_rows: Vec<usize>) -> Rules {
        Rules {
            free: (0..free).collect(),
            bounds: vec![[f64::NEG_INFINITY, f64::INFINITY]; free].into(),
            position_rows: position_rows.into(),
            iterations: 50,
            tolerance: 1e-3,
            noise: true,
            renewal: Renewal::ByRound,
            has_domain: true,
            converges_fully: true,
            precision: Precision::F32,
            rounding: 0.0,
            rounding_variance: 0.0,
            is_traced: true,
            window_pixels: 41,
        }
    }

    #[test]
    fn large_offsets_move_the_position_first() {
        for (off, position_rows, passes) in
            [(0.1, vec![0], 2), (1.0, vec![0], 3), (1.0, vec![], 4), (2.0, vec![0], 4), (2.0, vec![], 0)]
        {
            let mut point = [off, 1.3, 100.0];
            let refined = refine(&mut Bell, &rules_of(3, position_rows), &mut point, None, None);
            assert_eq!(refined.done().map_or(0, |refinement| refinement.report.passes), passes, "{off}: {point:?}");
            assert!(passes == 0 || point[0].abs() < 1e-3 && (point[2] - 100.0).abs() < 0.1, "{off}: {point:?}");
        }
    }

    #[test]
    fn a_tether_limits_the_way() {
        let from = [0.3, 1.3, 100.0];
        let run = |length: f64| {
            let (mut point, distance_limit) = (from, DistanceLimit { from: &from, length });
            let outcome = refine(&mut Bell, &rules_of(3, vec![0]), &mut point, None, Some(&distance_limit));
            (outcome, point)
        };
        let (RefineOutcome::BeyondLimit { parameters, report, .. }, _) = run(1.0) else { panic!("it is not held") };
        assert!(report.passes == 1 && parameters[0].abs() < 0.05, "one step leads most of the way: {parameters:?}");
        let (RefineOutcome::Done(refinement), point) = run(1000.0) else { panic!("it does not arrive") };
        assert!(refinement.report.passes > 1 && point[0].abs() < 0.05, "{point:?}");
    }

    #[test]
    fn failed_short_ways_leave_the_start_unchanged() {
        // Too far off, beyond a bound, and with a gradient that F does not follow.
        for (start, most, is_false) in [(-1.5, 1.0, false), (0.68, 0.69, false), (0.69, 1.0, true)] {
            let (report, end, _) = run(start, most, is_false);
            assert!(report.is_none() && end == start, "{start}: {report:?}");
        }
    }
}
