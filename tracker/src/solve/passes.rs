//! `Passes`: one pass after the other over a view, what a step needs of them, and what an end point is worth.
//!
//! What comes in: kernels, planes, parameters. What goes out: F, gradients and Hessians as a [`CostFunction`], and [`Worth`]. It never
//! knows which steps are taken.

use isophote_jit::Window;
use isophote_symbolic::Bindings;
use nalgebra::{DMatrix, DVector};

use crate::estimate::Ending;
use crate::outline::{Moved, moved};
use crate::scaled::{self, Definite};
use crate::sight::gaps::overlap;
use crate::sight::view::View;
use crate::solve::covariance::{beforehand, inform, inverse_fisher, is_placed};
use crate::solve::loops::{Loops, Totals};
use crate::solve::stage::{CostFunction, Pass};
use crate::solve::stage_kernels::{CompileFailure, Control, Free, Job, StageKernels, curvature, method};
use crate::solve::trust::{Curvature, Quadratic};

/// A larger squared residual counts as this, four standard deviations: noise has one in 16,000 pixels beyond.
pub(super) const SQUARE_MAX: f64 = 16.0;
/// Pixels of a pass that cost as much as one gap does.
const GAP_WORK: usize = 64;

/// What the end point is worth, by a last pass that leaves saturated pixels out.
#[derive(Clone, Debug)]
pub(crate) struct Worth {
    /// F; with noise that is χ² + Σ ln σ².
    pub objective: f64,
    /// χ²/ν; absent when there are no more pixels than parameters.
    pub reduced: Option<f64>,
    /// One that is nothing unusual: 1 where the model says what noise there is, else that of rounding alone.
    pub reduced_least: f64,
    pub pixels: u64,
    /// Pixels of the domain that say nothing about light, and took no part.
    pub left_out: u64,
    /// Share of the domain's pixels.
    pub saturated: f64,
    /// What rows are likely to be off by, as a variance in pixel values², where they are: of the first entry of `observed`.
    pub row_variance: Option<f64>,
    /// Of the last stage's parameters; absent when singular, unless an added background is the reason.
    pub covariance: Option<DMatrix<f64>>,
    /// The pixels say where the target is, whatever else they leave open.
    pub is_placed: bool,
    /// Its inverse, as it was summed.
    pub information: Option<DMatrix<f64>>,
    /// Variances that they would have if all others were known: a lower bound, and never absent.
    pub variance_alone: DVector<f64>,
}

impl Worth {
    /// Takes in a shift that is as likely as not.
    pub fn widen(&mut self, shift: &DVector<f64>) {
        if let Some(covariance) = &mut self.covariance {
            *covariance += shift * shift.transpose();
            self.information = scaled::inverse(covariance);
        }
        self.variance_alone += shift.component_mul(shift);
    }
}

/// What says F and χ² at the end of a fit by a model with noise.
pub(super) enum EndReport<'a> {
    /// There is none.
    None,
    /// The last pass, where its last step began.
    Told,
    /// A pass of its own.
    Untold(&'a Loops),
}

/// Passes over a view.
pub(super) struct Passes<'a> {
    compiled: &'a StageKernels,
    view: &'a View<'a>,
    /// Windows without a common pixel: the view's, or what of it the target can be in.
    parts: &'a [Window],
    /// What of them takes no part.
    gaps: Vec<Window>,
    /// What a pass costs, in pixels of a usual one.
    work: usize,
    constants: &'a [f64],
    /// They are run though the frame's budget is used up: without them nothing could be said of what was reached.
    pub is_last: bool,
    /// The fit was still moving: the step that it was about to take counts as uncertainty.
    pub is_cut_short: bool,
    /// Of the last pass.
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

    /// The passes that nothing follows, over the pixels of `entry`; `report` is there for models with noise.
    pub fn worth(
        &mut self,
        covariance: &Loops,
        report: Option<&Loops>,
        end: &[f64],
        entry: &[f64],
    ) -> Result<Worth, Ending> {
        let mut pass = Pass::of(self.compiled.last_parameters().len());
        pass.read(self.run(covariance, end, entry)?, Curvature::GaussNewton)?;
        self.worth_of((pass, None), report.map_or(EndReport::None, EndReport::Untold), end, entry)
    }

    /// The same of the pass that was run last, on the pixels of `entry`, whose F may have been carried on to `end`; with the factors
    /// of its Hessian, where they are known.
    pub fn worth_of(
        &mut self,
        (pass, factors): (Pass, Option<Definite>),
        report: EndReport,
        end: &[f64],
        entry: &[f64],
    ) -> Result<Worth, Ending> {
        let count = self.compiled.last_parameters().len();
        let sums = &self.totals;
        let carried = pass.quadratic.objective - sums.outputs.first().ok_or(Ending::NonFinite)?;
        let met = pass.pixels + sums.saturated;
        let mut chi_square = sums.seen.first().ok_or(Ending::NonFinite)? + carried;
        let saturated = if met > 0 { sums.saturated as f64 / met as f64 } else { 0.0 };
        let row_variance = sums.rows.variance();
        let mut quadratic = pass.quadratic;
        if let Some(Free { parameters, bounds, .. }) = self.compiled.free_of_last() {
            quadratic.hold_back(bounds, |row| end[parameters[row]]);
        }
        let mut objective = quadratic.objective;
        let is_weighed = !matches!(report, EndReport::None);
        if is_weighed {
            // What a last step takes from χ² it takes from F, to which weights that it changes are a detail.
            let (sums, carried) = match report {
                EndReport::Untold(report) => (self.run(report, end, entry)?, 0.0),
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
        let reduced = pass.pixels.checked_sub(count as u64).filter(|&n| n > 0).map(|n| chi_square / n as f64);
        let variance = if is_weighed { Some(1.0) } else { reduced };
        let known = beforehand(self.compiled.model(), self.compiled.last_parameters(), end);
        let variance_alone = quadratic.hessian.diagonal().map(|entry| variance.unwrap_or(0.0) * 2.0 / entry);
        let factors = factors.filter(|_| known.is_none());
        if let Some((known, variance)) = known.zip(variance) {
            inform(&mut quadratic, &known, variance);
        }
        let (model, precision) = (self.compiled.model(), self.compiled.precision());
        let mut covariance =
            variance.and_then(|variance| inverse_fisher(model, &quadratic, factors, precision, variance));
        let is_placed = covariance.is_some()
            || self.compiled.free_of_last().is_none_or(|free| is_placed(&quadratic, &free.places, precision));
        let positive = variance.filter(|variance| *variance > 0.0);
        let mut step = None;
        let information = match covariance.as_mut().zip(positive) {
            // What was cut short is not known better than the step that it was about to take, or took last.
            Some((covariance, variance)) if self.is_cut_short => {
                step = Some(&*covariance * &quadratic.gradient * (0.5 / variance));
                None
            }
            Some((_, variance)) => Some(quadratic.hessian * (0.5 / variance)),
            None => None,
        };
        let (pixels, left_out) = (pass.pixels, self.totals.left_out);
        let reduced_least = if self.compiled.model().has_noise() { 1.0 } else { self.view.rounding_variance() };
        let mut worth = Worth {
            objective,
            reduced,
            reduced_least,
            pixels,
            left_out,
            saturated,
            row_variance,
            covariance,
            is_placed,
            information,
            variance_alone,
        };
        step.into_iter().for_each(|step| worth.widen(&step));
        Ok(worth)
    }
}

impl Pass {
    /// From the outputs of a last pass: F, the gradient, the diagonal of H, and what may stand behind them.
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

    /// From a kernel's outputs: F, the gradient, the upper triangle of H by rows.
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
        let (whole, mut row) = (hessian.as_mut_slice(), upper);
        for i in 0..n {
            let (own, rest) = row.split_at(n - i);
            for (j, &entry) in (i..).zip(own) {
                whole[i * n + j] = entry;
                whole[j * n + i] = entry;
            }
            row = rest;
        }
        self.quadratic.curvature = curvature;
        self.pixels = sums.pixels;
        Ok(())
    }
}

/// Sums over a view, as something to minimise.
pub(super) struct Summed<'a> {
    pub passes: Passes<'a>,
    gradient: Loops,
    /// In its place where a pass is entered, and where a way is likely to end; of fits from nearby.
    opening: Option<Loops>,
    closing: Option<Loops>,
    curvature: Curvature,
}

impl<'a> Summed<'a> {
    /// Those of a stage.
    pub fn of(passes: Passes<'a>, index: usize, control: Control) -> Result<Summed<'a>, CompileFailure> {
        let (compiled, layout) = (passes.compiled, &passes.view.layout);
        let method = method(compiled.model(), index, layout);
        let gradient = compiled.loops(Job::Stage(index), control, layout)?;
        Ok(Summed { passes, gradient, opening: None, closing: None, curvature: curvature(method) })
    }

    /// The same for a fit that begins nearby.
    pub fn nearby(self) -> Result<Summed<'a>, CompileFailure> {
        let Passes { compiled, view, .. } = self.passes;
        let [opening, closing] = [Job::Opening, Job::Closing].map(|job| compiled.short_loops(job, &view.layout));
        Ok(Summed { opening: opening?, closing: closing?, ..self })
    }
}

impl CostFunction for Summed<'_> {
    fn gradient(&mut self, point: &[f64], entry: &[f64], pass: &mut Pass) -> Result<(), Ending> {
        let loops = self.opening.as_ref().filter(|_| point == entry).unwrap_or(&self.gradient);
        pass.read(self.passes.run(loops, point, entry)?, self.curvature)
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
        // Copies of a part of the picture are read by kernels alone.
        let is_whole = view.planes.iter().all(|plane| plane.origin() == [0; 4]);
        let predictions = compiled.predictions().filter(|_| is_whole)?;
        predictions.capped_change(view, constants, points, entries, [SQUARE_MAX, variance])
    }

    fn moved(&self, from: &[f64], to: &[f64]) -> Option<Moved> {
        moved(self.passes.compiled.model(), from, to)
    }
}
