//! `Passes`: evaluates F, gradients and Hessians over a view as a [`CostFunction`], and [`FitSummary`] at the end
//! point.

use isophote_jit::Window;
use isophote_symbolic::Bindings;
use nalgebra::{DMatrix, DVector};

use crate::estimate::Ending;
use crate::outline::{Moved, moved};
use crate::scaled::{self, Definite};
use crate::sight::gaps::overlap;
use crate::sight::view::View;
use crate::solve::covariance::{add_prior_information, determines_position, inverse_fisher, prior_deviations};
use crate::solve::loops::{Loops, Totals};
use crate::solve::prior::Prior;
use crate::solve::stage::{CostFunction, Pass};
use crate::solve::stage_kernels::{
    CompileFailure, FreeParameters, Job, PixelHandling, StageKernels, curvature, method,
};
use crate::solve::trust::{Curvature, Quadratic};

/// Squared residuals are capped at this, four standard deviations: noise exceeds that in one of 16,000 pixels.
pub(super) const SQUARE_MAX: f64 = 16.0;
/// Cost of one gap in pixels of a pass.
const GAP_WORK: usize = 64;

/// Statistics of the end point, by a last pass without saturated pixels.
#[derive(Clone, Debug)]
pub(crate) struct FitSummary {
    /// F; with noise, χ² + Σ ln σ².
    pub objective: f64,
    /// χ²/ν; absent when ν ≤ 0.
    pub reduced_chi_square: Option<f64>,
    /// The expected χ²/ν: 1 where the model states its noise, else that of rounding alone.
    pub expected_reduced_chi_square: f64,
    pub pixels: u64,
    /// Pixels of the domain inside gaps.
    pub left_out: u64,
    /// Saturated share of the domain's pixels.
    pub saturated: f64,
    /// Estimated variance of the rows' offsets, in pixel values², where rows have them: of the first entry of `observed`.
    pub row_variance: Option<f64>,
    /// The covariance of the last stage's parameters; absent when singular, unless an added background is the reason.
    pub covariance: Option<DMatrix<f64>>,
    /// The pixels determine the target's position, whatever else they leave undetermined.
    pub determines_position: bool,
    /// The inverse of the covariance, from the sums.
    pub information: Option<DMatrix<f64>>,
    /// Variances of the parameters if all others were known: a lower bound, always present.
    pub variance_alone: DVector<f64>,
}

impl FitSummary {
    /// Adds a shift, as one standard deviation, to the covariance.
    pub fn widen(&mut self, shift: &DVector<f64>) {
        if let Some(covariance) = &mut self.covariance {
            *covariance += shift * shift.transpose();
            self.information = scaled::inverse(covariance);
        }
        self.variance_alone += shift.component_mul(shift);
    }
}

/// The source of F and χ² at the end of a fit by a model with noise.
pub(super) enum EndReport<'a> {
    /// None is needed.
    None,
    /// The last pass, at the start of its last step.
    LastPass,
    /// A separate pass.
    Separate(&'a Loops),
}

/// Passes over a view.
pub(super) struct Passes<'a> {
    compiled: &'a StageKernels,
    view: &'a View<'a>,
    /// Disjoint windows: the view's, or the parts of it that may contain the target.
    parts: &'a [Window],
    /// The gaps inside them.
    gaps: Vec<Window>,
    /// Cost of a pass, in pixels of a typical model's.
    work: usize,
    constants: &'a [f64],
    /// Passes run although the frame's budget is used up, to evaluate the point reached.
    pub is_last: bool,
    /// The fit was still moving: its pending step counts as uncertainty.
    pub is_cut_short: bool,
    /// Added to F by [`Summed`], and to the information at the end.
    pub prior: Option<&'a Prior>,
    /// Sums of the last pass.
    totals: Totals,
}

impl<'a> Passes<'a> {
    pub fn of(compiled: &'a StageKernels, view: &'a View<'a>, parts: &'a [Window], constants: &'a [f64]) -> Passes<'a> {
        let inside = |gap: &Window| parts.iter().filter_map(|part| overlap(*gap, *part)).collect::<Vec<Window>>();
        let gaps: Vec<Window> = view.gaps.iter().flat_map(inside).collect();
        let pixels = parts.iter().map(|part| part.pixels()).sum::<usize>() + GAP_WORK * gaps.len();
        let work = compiled.weight() * pixels;
        Passes {
            compiled,
            view,
            parts,
            gaps,
            work,
            constants,
            is_last: false,
            is_cut_short: false,
            prior: None,
            totals: Totals::default(),
        }
    }

    /// One pass over all parts.
    pub fn run(&mut self, loops: &Loops, parameters: &[f64], entry: &[f64]) -> Result<&Totals, Ending> {
        if !self.is_last {
            self.view.spend(self.work)?;
        }
        let bindings =
            Bindings { parameters, entry, constants: self.constants, saturation: &self.view.limits, shift: &[] };
        let View { planes, row_variances, .. } = self.view;
        let ran = loops.sums(&bindings, planes, self.parts, &self.gaps, row_variances, &mut self.totals);
        ran.map(|()| &self.totals).ok_or(Ending::NonFinite)
    }

    /// Runs the final passes, over the pixels of `entry`; `report` is given for models with noise.
    pub fn summary(
        &mut self,
        covariance: &Loops,
        report: Option<&Loops>,
        end: &[f64],
        entry: &[f64],
    ) -> Result<FitSummary, Ending> {
        let mut pass = Pass::of(self.compiled.last_parameters().len());
        pass.read(self.run(covariance, end, entry)?, Curvature::GaussNewton)?;
        self.summary_of((pass, None), report.map_or(EndReport::None, EndReport::Separate), end, entry)
    }

    /// Evaluates the pass that ran last, on the pixels of `entry`, whose F may be extrapolated to `end`; with the factors
    /// of its Hessian, where known.
    pub fn summary_of(
        &mut self,
        (pass, factors): (Pass, Option<Definite>),
        report: EndReport,
        end: &[f64],
        entry: &[f64],
    ) -> Result<FitSummary, Ending> {
        let count = self.compiled.last_parameters().len();
        let sums = &self.totals;
        let carried = pass.quadratic.objective - sums.outputs.first().ok_or(Ending::NonFinite)?;
        let met = pass.pixels + sums.saturated;
        let mut chi_square = sums.seen.first().ok_or(Ending::NonFinite)? + carried;
        let saturated = if met > 0 { sums.saturated as f64 / met as f64 } else { 0.0 };
        let row_variance = sums.rows.variance();
        let mut quadratic = pass.quadratic;
        if let Some(FreeParameters { parameters, bounds, .. }) = self.compiled.free_of_last() {
            quadratic.fix_at_bounds(bounds, |row| end[parameters[row]]);
        }
        let mut objective = quadratic.objective;
        let is_weighed = !matches!(report, EndReport::None);
        if is_weighed {
            // The last step reduces χ² as much as F; its change of the weights is negligible.
            let (sums, carried) = match report {
                EndReport::Separate(report) => (self.run(report, end, entry)?, 0.0),
                _ => (&self.totals, carried),
            };
            match (sums.outputs.as_slice(), sums.seen.as_slice()) {
                (&[.., full, _], &[.., chi]) => (objective, chi_square) = (full + carried, chi + carried),
                _ => return Err(Ending::NonFinite),
            }
        }
        if !quadratic.is_finite() || !objective.is_finite() {
            return Err(Ending::NonFinite);
        }
        let reduced_chi_square =
            pass.pixels.checked_sub(count as u64).filter(|&n| n > 0).map(|n| chi_square / n as f64);
        let variance = if is_weighed { Some(1.0) } else { reduced_chi_square };
        let known = prior_deviations(self.compiled.model(), self.compiled.last_parameters(), end);
        let variance_alone = quadratic.hessian.diagonal().map(|entry| variance.unwrap_or(0.0) * 2.0 / entry);
        let factors = factors.filter(|_| known.is_none());
        if let Some((known, variance)) = known.zip(variance) {
            add_prior_information(&mut quadratic, &known, variance);
        }
        self.prior.into_iter().for_each(|prior| prior.add_to(&mut quadratic, end));
        let (model, precision) = (self.compiled.model(), self.compiled.precision());
        let mut covariance =
            variance.and_then(|variance| inverse_fisher(model, &quadratic, factors, precision, variance));
        let determines_position = covariance.is_some()
            || self
                .compiled
                .free_of_last()
                .is_none_or(|free| determines_position(&quadratic, &free.position_rows, precision));
        let positive = variance.filter(|variance| *variance > 0.0);
        let mut step = None;
        let information = match covariance.as_mut().zip(positive) {
            // A fit that was cut short is no better known than its pending or last step.
            Some((covariance, variance)) if self.is_cut_short => {
                step = Some(&*covariance * &quadratic.gradient * (0.5 / variance));
                None
            }
            Some((_, variance)) => Some(quadratic.hessian * (0.5 / variance)),
            None => None,
        };
        let (pixels, left_out) = (pass.pixels, self.totals.left_out);
        let expected_reduced_chi_square =
            if self.compiled.model().has_noise() { 1.0 } else { self.view.rounding_variance() };
        let mut summary = FitSummary {
            objective,
            reduced_chi_square,
            expected_reduced_chi_square,
            pixels,
            left_out,
            saturated,
            row_variance,
            covariance,
            determines_position,
            information,
            variance_alone,
        };
        step.into_iter().for_each(|step| summary.widen(&step));
        Ok(summary)
    }
}

impl Pass {
    /// Reads the outputs of a closing pass: F, the gradient, the diagonal of H, and the optional report behind them.
    fn read_closing(&mut self, sums: &Totals) -> Result<f64, Ending> {
        let Quadratic { objective, gradient, hessian, .. } = &mut self.quadratic;
        let n = gradient.len();
        let (&first, rest) = sums.outputs.split_first().ok_or(Ending::NonFinite)?;
        let (slopes, rest) = rest.split_at_checked(n).ok_or(Ending::NonFinite)?;
        let diagonal = rest.get(..n).ok_or(Ending::NonFinite)?;
        *objective = first;
        gradient.copy_from_slice(slopes);
        self.pixels = sums.pixels;
        Ok(scaled::to_diagonal(hessian, diagonal))
    }

    /// Reads a kernel's outputs: F, the gradient, the upper triangle of H by rows.
    pub fn read(&mut self, sums: &Totals, curvature: Curvature) -> Result<(), Ending> {
        let Quadratic { objective, gradient, hessian, .. } = &mut self.quadratic;
        let n = gradient.len();
        let (&first, rest) = sums.outputs.split_first().ok_or(Ending::NonFinite)?;
        if rest.len() != n + n * (n + 1) / 2 {
            return Err(Ending::NonFinite);
        }
        let (slopes, upper) = rest.split_at(n);
        *objective = first;
        gradient.copy_from_slice(slopes);
        let (full, mut row) = (hessian.as_mut_slice(), upper);
        for i in 0..n {
            let (own, rest) = row.split_at(n - i);
            for (j, &entry) in (i..).zip(own) {
                full[i * n + j] = entry;
                full[j * n + i] = entry;
            }
            row = rest;
        }
        self.quadratic.curvature = curvature;
        self.pixels = sums.pixels;
        Ok(())
    }
}

/// The sums over a view as a cost function.
pub(super) struct Summed<'a> {
    pub passes: Passes<'a>,
    gradient: Loops,
    /// Replace it in the entering pass and near the end; for fits from nearby.
    opening: Option<Loops>,
    closing: Option<Loops>,
    curvature: Curvature,
}

impl<'a> Summed<'a> {
    /// The sums of a stage.
    pub fn of(passes: Passes<'a>, index: usize, handling: PixelHandling) -> Result<Summed<'a>, CompileFailure> {
        let (compiled, layout) = (passes.compiled, &passes.view.layout);
        let method = method(compiled.model(), index, layout);
        let gradient = compiled.loops(Job::Stage(index), handling, layout)?;
        Ok(Summed { passes, gradient, opening: None, closing: None, curvature: curvature(method) })
    }

    /// With the kernels of fits from nearby.
    pub fn nearby(self) -> Result<Summed<'a>, CompileFailure> {
        let Passes { compiled, view, .. } = self.passes;
        let [opening, closing] = [Job::Opening, Job::Closing].map(|job| compiled.refine_loops(job, &view.layout));
        Ok(Summed { opening: opening?, closing: closing?, ..self })
    }
}

impl CostFunction for Summed<'_> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        let loops = self.opening.as_ref().filter(|_| point == entry).unwrap_or(&self.gradient);
        pass.read(self.passes.run(loops, point, entry)?, self.curvature)?;
        self.passes.prior.into_iter().for_each(|prior| prior.add_to(&mut pass.quadratic, point));
        Ok(())
    }

    fn closing(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Option<Result<f64, Ending>> {
        let sums = self.passes.run(self.closing.as_ref()?, point, entry);
        Some(sums.and_then(|sums| pass.read_closing(sums)))
    }

    fn allowed(&self, point: &[f64]) -> bool {
        let Passes { compiled, constants, .. } = &self.passes;
        point.iter().all(|value| value.is_finite()) && compiled.model().constraints_hold(point, constants)
    }

    fn change(&mut self, points: [&[f64]; 2], entries: [&[f64]; 2], variance: f64) -> Option<f64> {
        let Passes { compiled, view, constants, .. } = self.passes;
        // Only kernels can read copies of a part of the picture.
        let is_whole = view.planes.iter().all(|plane| plane.origin() == [0; 4]);
        let predictions = compiled.predictions().filter(|_| is_whole)?;
        predictions.capped_change(view, constants, points, entries, [SQUARE_MAX, variance])
    }

    fn moved(&self, from: &[f64], to: &[f64]) -> Option<Moved> {
        moved(self.passes.compiled.model(), from, to)
    }
}
