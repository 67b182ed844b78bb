//! `StageKernels`: a model's programs and their kernels for the pixel layouts met so far, compiled on first use and shared
//! by all trackers of the model.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isophote_jit::{Kernel, KernelCache, KernelOptions, PixelFormat};
use isophote_symbolic::{Method, Model, Parameter, ParameterId, Precision};

use smallvec::smallvec;

use crate::outline::has_domain;
use crate::sight::view::PlaneLayout;
use crate::solve::derived::{Derived, SummandPrograms, all};
use crate::solve::loops::Loops;
pub(crate) use crate::solve::pixel_handling::{CompileFailure, PixelHandling, lowering};
use crate::solve::residuals::Predictions;
use crate::solve::rows::Rows;
use crate::solve::stage::Renewal;
use crate::solve::trust::Curvature;
use crate::solve::workers::{InTurn, Workers};

/// What a kernel sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Job {
    /// F, gradient and Hessian of a stage.
    Stage(usize),
    /// F, gradient and Gauss–Newton Hessian over the last stage's parameters: the covariance.
    Covariance,
    /// F with the weights of the entry parameters.
    Value,
    /// F with ln σ², and χ²: the report of models with noise.
    Report,
    /// Like [`Job::Covariance`], for a pass at its own entry point; for models with noise.
    Opening,
    /// F, gradient and the diagonal of H as in [`Job::Covariance`], then [`Job::Report`] for models with noise.
    Closing,
}

/// The fits that kernels are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FitStarts {
    /// From anywhere.
    Anywhere,
    /// Also from a target's predicted position ([`crate::solve::refine`]): such fits have additional kernels.
    Nearby,
}

struct CompiledKernel {
    /// Index of the program in `Derived::parts`.
    part: usize,
    handling: PixelHandling,
    precision: Precision,
    layout: PlaneLayout,
    kernel: Arc<Kernel>,
}

/// The free parameters of a stage, as indices into all parameters, their bounds, and the rows of its sums that are the
/// target's position.
#[derive(Clone)]
pub(crate) struct FreeParameters {
    pub parameters: Arc<[usize]>,
    pub bounds: Arc<[[f64; 2]]>,
    pub position_rows: Arc<[usize]>,
}

impl FreeParameters {
    fn of(model: &Model, order: &[ParameterId]) -> FreeParameters {
        let position_rows = model.roles().iter().flat_map(|roles| roles.centre.iter().chain(&roles.position));
        FreeParameters {
            parameters: order.iter().map(|parameter| parameter.index()).collect(),
            bounds: order.iter().map(|parameter| bounds(&model.parameters()[parameter.index()])).collect(),
            position_rows: position_rows.filter_map(|place| order.iter().position(|free| free == place)).collect(),
        }
    }
}

/// Lower and upper bound; infinite where the document states none.
fn bounds(parameter: &Parameter) -> [f64; 2] {
    [parameter.min.unwrap_or(f64::NEG_INFINITY), parameter.max.unwrap_or(f64::INFINITY)]
}

/// A model's kernels for all stages.
pub struct StageKernels {
    model: Arc<Model>,
    /// One per stage.
    free: Arc<[FreeParameters]>,
    renewal: Renewal,
    has_domain: bool,
    precision: Precision,
    derived: Arc<Derived>,
    /// The programs for rows with offsets, once such frames were met.
    of_rows: Arc<OnceLock<Result<Derived, CompileFailure>>>,
    cache: Arc<KernelCache>,
    predictions: Arc<OnceLock<Option<Predictions>>>,
    ready: Mutex<Vec<CompiledKernel>>,
}

/// Most kernels held; beyond that the oldest is dropped (for an unusual or hostile mixture of pixel formats).
const KERNELS_MAX: usize = 512;

impl StageKernels {
    /// Derives all programs of the model's stages by `workers`. Kernels are compiled once a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for something that this build cannot do.
    pub(crate) fn new(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
        workers: &dyn Workers,
        begins: FitStarts,
    ) -> Result<StageKernels, CompileFailure> {
        let mut derived = Derived::of(&model, workers)?;
        if begins == FitStarts::Nearby && precision == Precision::F32 {
            derived.add_refine_sums(&model, workers);
        }
        let derived = Arc::new(derived);
        let free = |stage: usize| FreeParameters::of(&model, derived.order(Job::Stage(stage)));
        let free = (0..model.stages().len()).map(free).collect();
        let (renewal, has_domain) = (Renewal::of(&model), has_domain(&model));
        Ok(StageKernels {
            model,
            free,
            renewal,
            has_domain,
            precision,
            derived,
            of_rows: Arc::default(),
            cache,
            predictions: Arc::default(),
            ready: Mutex::default(),
        })
    }

    /// The same programs and cache, without kernels yet.
    pub fn share(&self) -> StageKernels {
        StageKernels {
            model: self.model.clone(),
            free: self.free.clone(),
            renewal: self.renewal,
            has_domain: self.has_domain,
            precision: self.precision,
            derived: self.derived.clone(),
            of_rows: self.of_rows.clone(),
            cache: self.cache.clone(),
            predictions: self.predictions.clone(),
            ready: Mutex::default(),
        }
    }

    /// The model.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Precision of the pixel loops.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Cost of a pixel of its passes, in pixels of a typical document: the unit of budgets.
    pub(crate) fn weight(&self) -> usize {
        self.derived.weight
    }

    /// The kernels' cache.
    pub(crate) fn cache(&self) -> &Arc<KernelCache> {
        &self.cache
    }

    /// Drops the predictions, for a model that reads corrections.
    pub(crate) fn without_predictions(self) -> StageKernels {
        StageKernels { predictions: Arc::new(OnceLock::from(None)), ..self }
    }

    /// The model's predictions, compiled on first use.
    pub(crate) fn predictions(&self) -> Option<&Predictions> {
        let make = || Predictions::new(&self.model, self.precision, &self.cache).ok().flatten();
        self.predictions.get_or_init(make).as_ref()
    }

    /// The free parameters of a stage, in the order of its sums.
    #[cfg(test)]
    pub(crate) fn order(&self, stage: usize) -> &[ParameterId] {
        self.derived.order(Job::Stage(stage))
    }

    /// When fits renew pixels and weights.
    pub(crate) fn renewal(&self) -> Renewal {
        self.renewal
    }

    /// The document states a domain.
    pub(crate) fn has_domain(&self) -> bool {
        self.has_domain
    }

    /// The free parameters of a stage.
    pub(crate) fn free(&self, stage: usize) -> &FreeParameters {
        &self.free[stage]
    }

    /// The free parameters of the last stage.
    pub(crate) fn free_of_last(&self) -> Option<&FreeParameters> {
        self.free.last()
    }

    /// The programs for such pixels, derived now if need be.
    fn derived(&self, layout: &PlaneLayout, workers: &dyn Workers) -> Result<&Derived, CompileFailure> {
        match layout.has_rows {
            false => Ok(&self.derived),
            true => {
                let derived = self.of_rows.get_or_init(|| Derived::of_rows(&self.model, workers));
                derived.as_ref().map_err(CompileFailure::clone)
            }
        }
    }

    /// Whether row offsets can be eliminated, derived now if need be: that may exceed a document's limit of formulas.
    pub(crate) fn derives_rows(&self) -> bool {
        self.of_rows.get_or_init(|| Derived::of_rows(&self.model, &InTurn)).is_ok()
    }

    /// The stage that suffices for fits from nearby: see [`Derived::refine_stage`]. `None` in f64.
    pub(crate) fn refine_stage(&self) -> Option<usize> {
        self.derived.refine_stage(&self.model).filter(|_| self.precision == Precision::F32)
    }

    /// Free parameters of the last stage.
    pub(crate) fn last_parameters(&self) -> &[ParameterId] {
        self.model.stages().last().map_or(&[], |stage| &stage.parameters)
    }

    /// Compiles every kernel for frames whose planes all have this format: packed when there is one, else interleaved. For
    /// formats with NaN also the kernels that skip it.
    ///
    /// # Errors
    /// When a kernel fails to compile.
    pub fn warm(&self, format: PixelFormat, workers: &dyn Workers) -> Result<(), CompileFailure> {
        let layout = PlaneLayout::of_format(format, self.model.channels().len());
        let controls = [PixelHandling::All, PixelHandling::SkipSaturated, PixelHandling::SkipInvalid];
        let holds_nan = matches!(format, PixelFormat::F32 | PixelFormat::F64);
        self.warm_for(&layout, if holds_nan { &controls } else { &controls[..2] }, workers)
    }

    /// Compiles every kernel for a layout and some controls.
    pub(crate) fn warm_for(
        &self,
        layout: &PlaneLayout,
        controls: &[PixelHandling],
        workers: &dyn Workers,
    ) -> Result<(), CompileFailure> {
        if layout.has_rows {
            self.warm_for(&layout.without_rows(), controls, workers)?;
        }
        let derived = self.derived(layout, workers)?;
        let each = |part: usize| {
            let SummandPrograms { is_clipped, is_refine_only, .. } = derived.parts[part];
            // Saturated pixels are summed only if there are some; fits from nearby always check.
            let is_asked_for = move |handling: &&PixelHandling| match handling {
                PixelHandling::All => !is_clipped && !is_refine_only,
                PixelHandling::SkipSaturated => true,
                PixelHandling::SkipInvalid => !is_refine_only,
            };
            let controls = controls.iter().filter(is_asked_for);
            controls.map(move |handling| (part, *handling))
        };
        let variants: Vec<(usize, PixelHandling)> = (0..derived.parts.len()).flat_map(each).collect();
        let compiled = all(variants.len(), workers, &|i| {
            let (part, handling) = variants[i];
            self.kernel(&derived.parts, part, handling, (self.precision, layout)).map(drop)
        });
        compiled.map(drop)
    }

    /// The kernels of a job, compiled now if need be.
    pub(crate) fn loops(
        &self,
        job: Job,
        handling: PixelHandling,
        layout: &PlaneLayout,
    ) -> Result<Loops, CompileFailure> {
        self.loops_in(self.precision, job, handling, layout)
    }

    /// The kernels of a job of fits from nearby; `None` where there are none.
    pub(crate) fn refine_loops(&self, job: Job, layout: &PlaneLayout) -> Result<Option<Loops>, CompileFailure> {
        let has_them = !layout.has_rows && self.derived.sum_of(job).is_some();
        has_them.then(|| self.loops(job, PixelHandling::SkipSaturated, layout)).transpose()
    }

    /// Like [`StageKernels::loops`], in another precision.
    pub(crate) fn loops_in(
        &self,
        precision: Precision,
        job: Job,
        handling: PixelHandling,
        layout: &PlaneLayout,
    ) -> Result<Loops, CompileFailure> {
        let derived = self.derived(layout, &InTurn)?;
        let made_for = (precision, layout);
        let mut all = Loops::default();
        if derived.offset.is_none() || job == Job::Report {
            let even = layout.without_rows();
            self.each(&self.derived, job, handling, (precision, &even), |kernel, part| {
                all.is_joint |= part.is_joint;
                if part.is_clipped { all.clipped.push(kernel) } else { all.seen.push(kernel) }
            })?;
        }
        let Some(offset) = derived.offset else { return Ok(all) };
        // The offsets' share of the report is computed from F.
        let of_rows = if job == Job::Report { Job::Value } else { job };
        let mut entries: Vec<Loops> = Vec::new();
        self.each(derived, of_rows, handling, made_for, |kernel, part| match entries.last_mut() {
            Some(entry) if part.is_clipped => entry.clipped.push(kernel),
            _ => entries.push(Loops { seen: smallvec![kernel], ..Loops::default() }),
        })?;
        let order = derived.order(of_rows);
        let index_of = |wanted: &ParameterId| order.iter().position(|id| id == wanted);
        let parameter_indices = self.derived.order(of_rows).iter().filter_map(index_of).collect();
        let rows = index_of(&offset).map(|offset| Rows { entries, parameter_indices, offset, count: order.len() });
        Ok(Loops { rows: rows.map(Arc::new), ..all })
    }

    /// Calls `visit` with each kernel of a job and its part: the kernel of an entry's saturated pixels follows that of the
    /// entry's other pixels, or a joint one of all entries.
    fn each(
        &self,
        derived: &Derived,
        job: Job,
        handling: PixelHandling,
        made_for: (Precision, &PlaneLayout),
        mut visit: impl FnMut(Arc<Kernel>, &SummandPrograms),
    ) -> Result<(), CompileFailure> {
        let sum = derived.sum_of(job);
        for (index, part) in derived.parts.iter().enumerate().filter(|(_, part)| Some(part.sum) == sum) {
            if !part.is_clipped || handling != PixelHandling::All {
                visit(self.kernel(&derived.parts, index, handling, made_for)?, part);
            }
        }
        Ok(())
    }

    /// The kernel of a part, compiled now if need be.
    fn kernel(
        &self,
        parts: &[SummandPrograms],
        index: usize,
        handling: PixelHandling,
        (precision, layout): (Precision, &PlaneLayout),
    ) -> Result<Arc<Kernel>, CompileFailure> {
        let part = &parts[index];
        // Saturated pixels are not NaN.
        let handling = if part.is_clipped { PixelHandling::All } else { handling };
        let find = |ready: &[CompiledKernel]| {
            let is_alike = |r: &CompiledKernel| r.part == index && r.handling == handling && r.precision == precision;
            let same = |r: &&CompiledKernel| is_alike(r) && r.layout == *layout;
            ready.iter().find(same).map(|r| r.kernel.clone())
        };
        if let Some(kernel) = find(&self.ready.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Ok(kernel);
        }
        // Outside the lock: compilation may take milliseconds.
        let skipping;
        let program = match handling {
            PixelHandling::All => &part.plain,
            PixelHandling::SkipSaturated => &part.dropping,
            PixelHandling::SkipInvalid => {
                skipping = part.objective.skipping_nan().program(lowering(handling)).map_err(CompileFailure::Model)?;
                &skipping
            }
        };
        let options = KernelOptions {
            width: self.cache.width(),
            precision,
            formats: layout.formats.to_vec(),
            packed: layout.packed,
        };
        let kernel = self.cache.get_or_compile_wide(program, &options);
        let kernel = kernel.map_err(|error| CompileFailure::Kernel(Arc::new(error)))?;
        let mut ready = self.ready.lock().unwrap_or_else(PoisonError::into_inner);
        if find(&ready).is_none() {
            if ready.len() == KERNELS_MAX {
                ready.remove(0);
            }
            ready.push(CompiledKernel {
                part: index,
                handling,
                precision,
                layout: layout.clone(),
                kernel: kernel.clone(),
            });
        }
        Ok(kernel)
    }
}

/// The method of a stage for such a layout: with row offsets variances are held, since the offsets' share depends on them.
pub(crate) fn method(model: &Model, stage: usize, layout: &PlaneLayout) -> Method {
    if layout.has_rows { held(model, stage) } else { model.stages()[stage].method }
}

pub(super) fn held(model: &Model, stage: usize) -> Method {
    if model.has_noise() { Method::LevenbergMarquardt } else { model.stages()[stage].method }
}

/// The Hessian that a method uses.
pub(crate) fn curvature(method: Method) -> Curvature {
    match method {
        Method::Newton => Curvature::Full,
        Method::GaussNewton | Method::LevenbergMarquardt => Curvature::GaussNewton,
    }
}

#[cfg(test)]
#[path = "stage_kernels_tests.rs"]
mod tests;
