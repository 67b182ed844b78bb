//! The short way through a stage from a start that is nearly right: where a target is predicted to be.
//!
//! What comes in: a [`CostFunction`] and a start. What goes out: moved parameters, the last pass and a report; or nothing, and
//! then the stage is run as from anywhere ([`stage::run`](crate::solve::stage::run)). It never knows kernels, pixels or time.
//!
//! The start fixes the pixel set and the weights of every pass, so that F of one pass is comparable with F of the next: the
//! pass at the point where a step leads both judges that step and makes the next one. Lengths are in standard deviations,
//! `√(δᵀC⁻¹δ)`. Of two steps in a row of lengths a and b, with q = b/a, what is left after the second is at most
//! `b (q + q² + …) = b q/(1 − q)` where steps go on to shrink as they do; Newton's shrink faster. When that is a small share
//! of a standard deviation the fit is over: two passes from a tenth of a pixel, three from a whole one. Where the frame's budget
//! ends it before, the last step is taken, though nothing has judged it: from a start that is nearly right it leads nearer.

use nalgebra::DVector;

use crate::estimate::{Ending, StageReport, TracePoint};
use crate::scaled::Definite;
use crate::solve::stage::{CostFunction, Pass, Rules, eigen_resolution};
use crate::solve::trust::{Quadratic, Spectrum};

/// What may be left of the way to the minimum, in standard deviations.
const LEFT: f64 = 0.05;
/// Passes after which a start was not nearly right.
const PASSES: u32 = 4;

/// What a start that was nearly right came to.
pub(crate) struct ShortWay {
    pub report: StageReport,
    /// At the point where the last step began; F is what it will be at its end.
    pub pass: Pass,
    /// Of a residual, where the model does not say it: χ²/ν.
    pub variance: f64,
}

/// Moves `point` to the minimum; `None`, with `point` as it was, where a step does not do what it promises, where bounds or
/// rounding have a say, or where too many steps would be needed. What ends every pass is for the caller to find out anew.
/// `before`: the way that led to the point, where F was another but nearly the same.
pub(crate) fn follow<P: CostFunction>(
    problem: &mut P,
    rules: &Rules,
    point: &mut [f64],
    before: Option<f64>,
) -> Option<ShortWay> {
    let free = rules.free.len();
    let (mut at, mut pass) = (point.to_vec(), Pass::of(free));
    let mut report = StageReport { ending: Ending::SmallStep, ..StageReport::default() };
    let mut before: Option<(f64, f64)> = before.map(|way| (f64::INFINITY, way));
    // Of the step at hand: by how much F should fall, and the variance of a residual.
    let mut last = None;
    while report.passes < PASSES.min(rules.iterations) {
        match problem.gradient(&at, point, &mut pass) {
            Ok(()) => {}
            Err(Ending::Budget) => return left(last, rules, report, pass, (at, point)),
            Err(_) => return None,
        }
        if report.passes == 0 {
            (report.pixels_first, report.pixels_least, report.pixels_last) = (pass.pixels, pass.pixels, pass.pixels);
        }
        report.passes += 1;
        if pass.pixels < rules.pixels_needed(report.pixels_first) || !pass.quadratic.is_finite() {
            return None;
        }
        let objective = pass.quadratic.objective;
        let slack = rules.slack(objective, pass.pixels);
        if rules.is_traced {
            let fell = |(promised, _): (f64, f64)| Some((before?.0 - objective + slack) / (promised + slack));
            report.note(TracePoint { objective, radius: None, ratio: last.and_then(fell) });
        }
        if before.is_some_and(|(last, _)| objective > last + slack) {
            return None;
        }
        let (delta, reduction) = newton_step(&pass.quadratic, eigen_resolution(rules.precision))?;
        let variance = if rules.noise { 1.0 } else { rules.reduced(&pass).filter(|reduced| *reduced > 0.0)? };
        if !reduction.is_finite() {
            return None;
        }
        report.iterations += 1;
        moved(&mut at, &rules.free, &delta);
        if !problem.allowed(&at) {
            return None;
        }
        let length = (reduction.max(0.0) / variance).sqrt();
        if before.is_some_and(|(_, last)| is_near(last, length)) {
            point.copy_from_slice(&at);
            pass.quadratic.objective -= reduction;
            return Some(ShortWay { report, pass, variance });
        }
        before = Some((objective, length));
        last = Some((reduction, variance));
    }
    None
}

/// What a way that was left has come to: the end of its last step.
fn left(
    last: Option<(f64, f64)>,
    rules: &Rules,
    report: StageReport,
    mut pass: Pass,
    (at, point): (Vec<f64>, &mut [f64]),
) -> Option<ShortWay> {
    let (reduction, variance) = last?;
    rules.free.iter().for_each(|&i| point[i] = at[i]);
    pass.quadratic.objective -= reduction;
    Some(ShortWay { report: StageReport { ending: Ending::Budget, ..report }, pass, variance })
}

/// `−H⁻¹g`, and by how much F falls there, where H bends upwards.
fn newton_step(quadratic: &Quadratic, resolution: f64) -> Option<(DVector<f64>, f64)> {
    let definite = Definite::of(&quadratic.hessian)?;
    if definite.is_clear(resolution) {
        return Some(definite.newton_step(&quadratic.gradient));
    }
    let spectrum = Spectrum::new(quadratic, definite.scale(), resolution)?;
    let step = spectrum.step(f64::INFINITY);
    (step.interior && !spectrum.is_indefinite()).then_some((step.delta, step.reduction))
}

fn moved(at: &mut [f64], free: &[usize], delta: &DVector<f64>) {
    free.iter().zip(delta.iter()).for_each(|(&i, delta)| at[i] += delta);
}

/// Whether little is left after a step of that length, the one before it being `last` long.
fn is_near(last: f64, length: f64) -> bool {
    let ratio = length / last;
    length == 0.0 || ratio < 1.0 && length * ratio / (1.0 - ratio) <= LEFT
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
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

        fn value(&mut self, _: &[f64], _: &[f64]) -> Result<f64, Ending> {
            unreachable!("the short way asks for no F alone")
        }

        fn allowed(&self, point: &[f64]) -> bool {
            point[0] < self.most
        }
    }

    fn run(start: f64, most: f64, is_false: bool) -> (Option<StageReport>, f64, Curve) {
        let rules = Rules {
            free: vec![0],
            iterations: 50,
            tolerance: 1e-3,
            noise: true,
            precision: Precision::F32,
            rounding: 0.0,
            is_traced: true,
            window_pixels: 15,
        };
        let mut curve = Curve { contrast: 100.0, passes: 0, is_false, most, entries: Vec::new() };
        let mut point = [start];
        let followed = follow(&mut curve, &rules, &mut point, None);
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
    fn what_is_not_nearly_right_is_left_as_it_was() {
        // Too far, past a bound, and a gradient that F does not follow.
        for (start, most, is_false) in [(-1.5, 1.0, false), (0.68, 0.69, false), (0.69, 1.0, true)] {
            let (report, end, _) = run(start, most, is_false);
            assert!(report.is_none() && end == start, "{start}: {report:?}");
        }
    }
}
