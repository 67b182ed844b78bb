//! `StageKernels`: a model's programs, and their kernels for the pixel layouts that were met so far.
//!
//! What comes in: a checked model. What goes out: kernels, compiled when first asked for and shared by all trackers of the
//! model. It never knows a frame's pixels.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isophote_jit::{Kernel, KernelCache, KernelOptions, PixelFormat};
use isophote_symbolic::{Method, Model, Parameter, ParameterId, Precision};

use smallvec::smallvec;

use crate::outline::has_domain;
use crate::sight::view::PlaneLayout;
pub(crate) use crate::solve::control::{CompileFailure, Control, lowering};
use crate::solve::derived::{Derived, SummandPrograms, all};
use crate::solve::loops::Loops;
use crate::solve::residuals::Predictions;
use crate::solve::rows::Rows;
use crate::solve::stage::Renewal;
use crate::solve::trust::Curvature;
use crate::solve::workers::{InTurn, Workers};

/// What a kernel sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Job {
    /// F, gradient and Hessian of that stage.
    Stage(usize),
    /// F, gradient and Gauss–Newton Hessian for the parameters of the last stage: the covariance.
    Covariance,
    /// F with the weights of the entry parameters.
    Value,
    /// F with ln σ², and χ²: the report of models with noise.
    Report,
    /// What [`Job::Covariance`] sums, of a pass that is entered where it is; of models with noise.
    Opening,
    /// F and gradient as in [`Job::Covariance`], behind them [`Job::Report`] where there is one.
    Closing,
}

/// Which fits kernels are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Begins {
    /// From anywhere.
    Anywhere,
    /// From where a target is predicted to be as well ([`crate::solve::follow`]): such fits have kernels of their own.
    Nearby,
}

struct Ready {
    /// Index into the parts.
    part: usize,
    control: Control,
    precision: Precision,
    layout: PlaneLayout,
    kernel: Arc<Kernel>,
}

/// What a stage leaves free, as indices into all parameters, with the least and largest value of each; which of these say where
/// the target is, as rows of its sums.
#[derive(Clone)]
pub(crate) struct Free {
    pub parameters: Arc<[usize]>,
    pub bounds: Arc<[[f64; 2]]>,
    pub places: Arc<[usize]>,
}

impl Free {
    fn of(model: &Model, order: &[ParameterId]) -> Free {
        let places = model.roles().iter().flat_map(|roles| roles.centre.iter().chain(&roles.position));
        Free {
            parameters: order.iter().map(|parameter| parameter.index()).collect(),
            bounds: order.iter().map(|parameter| bounds(&model.parameters()[parameter.index()])).collect(),
            places: places.filter_map(|place| order.iter().position(|free| free == place)).collect(),
        }
    }
}

/// Infinite where the document states none.
fn bounds(parameter: &Parameter) -> [f64; 2] {
    [parameter.min.unwrap_or(f64::NEG_INFINITY), parameter.max.unwrap_or(f64::INFINITY)]
}

/// A model's kernels for all stages.
pub struct StageKernels {
    model: Arc<Model>,
    /// Of each stage.
    free: Arc<[Free]>,
    renewal: Renewal,
    has_domain: bool,
    precision: Precision,
    derived: Arc<Derived>,
    /// The same of rows that have offsets, once such frames were met.
    of_rows: Arc<OnceLock<Result<Derived, CompileFailure>>>,
    cache: Arc<KernelCache>,
    predictions: Arc<OnceLock<Option<Predictions>>>,
    ready: Mutex<Vec<Ready>>,
}

/// Kernels held; beyond, the oldest is let go (an unusual mixture of pixel formats, or a hostile one).
const KERNELS_MAX: usize = 512;

impl StageKernels {
    /// Derives all programs of the model's stages by `workers`. Kernels follow when a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub(crate) fn new(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
        workers: &dyn Workers,
        begins: Begins,
    ) -> Result<StageKernels, CompileFailure> {
        let mut derived = Derived::of(&model, workers)?;
        if begins == Begins::Nearby && precision == Precision::F32 {
            derived.add_short(&model, workers);
        }
        let derived = Arc::new(derived);
        let free = |stage: usize| Free::of(&model, derived.order(Job::Stage(stage)));
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

    /// The same programs and cache, holding no kernel yet.
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

    /// Arithmetic of the pixel loops.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// What a pixel of its passes costs, in pixels of a usual document's: budgets count these.
    pub(crate) fn weight(&self) -> usize {
        self.derived.weight
    }

    /// The kernels' cache.
    pub(crate) fn cache(&self) -> &Arc<KernelCache> {
        &self.cache
    }

    /// The same without predictions, of a model that reads corrections.
    pub(crate) fn without_predictions(self) -> StageKernels {
        StageKernels { predictions: Arc::new(OnceLock::from(None)), ..self }
    }

    /// The model's predictions, compiled by the first who asks.
    pub(crate) fn predictions(&self) -> Option<&Predictions> {
        let make = || Predictions::new(&self.model, self.precision, &self.cache).ok().flatten();
        self.predictions.get_or_init(make).as_ref()
    }

    /// The free parameters of a stage, in the order of its sums.
    #[cfg(test)]
    pub(crate) fn order(&self, stage: usize) -> &[ParameterId] {
        self.derived.order(Job::Stage(stage))
    }

    /// When fits take pixels and weights anew.
    pub(crate) fn renewal(&self) -> Renewal {
        self.renewal
    }

    /// The document says which pixels count.
    pub(crate) fn has_domain(&self) -> bool {
        self.has_domain
    }

    /// The same as indices.
    pub(crate) fn free(&self, stage: usize) -> &Free {
        &self.free[stage]
    }

    /// That of the last stage.
    pub(crate) fn free_of_last(&self) -> Option<&Free> {
        self.free.last()
    }

    /// What kernels for such pixels are made of, derived now if need be.
    fn derived(&self, layout: &PlaneLayout, workers: &dyn Workers) -> Result<&Derived, CompileFailure> {
        match layout.has_rows {
            false => Ok(&self.derived),
            true => {
                let derived = self.of_rows.get_or_init(|| Derived::of_rows(&self.model, workers));
                derived.as_ref().map_err(CompileFailure::clone)
            }
        }
    }

    /// Whether offsets of rows can be eliminated, derived now if need be: there may be more formulas then than a document may have.
    pub(crate) fn derives_rows(&self) -> bool {
        self.of_rows.get_or_init(|| Derived::of_rows(&self.model, &InTurn)).is_ok()
    }

    /// The stage that does for fits from nearby: see [`Derived::short_stage`]. None in f64.
    pub(crate) fn short_stage(&self) -> Option<usize> {
        self.derived.short_stage(&self.model).filter(|_| self.precision == Precision::F32)
    }

    /// Free parameters of the last stage.
    pub(crate) fn last_parameters(&self) -> &[ParameterId] {
        self.model.stages().last().map_or(&[], |stage| &stage.parameters)
    }

    /// Compiles every kernel for frames whose planes all have this format: packed when there is one, else interleaved. Of
    /// formats that hold what is no number those that leave such pixels out, too.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn warm(&self, format: PixelFormat, workers: &dyn Workers) -> Result<(), CompileFailure> {
        let layout = PlaneLayout::of_format(format, self.model.channels().len());
        let controls = [Control::Plain, Control::Dropping, Control::Blind];
        let holds_nan = matches!(format, PixelFormat::F32 | PixelFormat::F64);
        self.warm_for(&layout, if holds_nan { &controls } else { &controls[..2] }, workers)
    }

    /// Compiles every kernel for a layout and some controls.
    pub(crate) fn warm_for(
        &self,
        layout: &PlaneLayout,
        controls: &[Control],
        workers: &dyn Workers,
    ) -> Result<(), CompileFailure> {
        if layout.has_rows {
            self.warm_for(&layout.without_rows(), controls, workers)?;
        }
        let derived = self.derived(layout, workers)?;
        let each = |part: usize| {
            let SummandPrograms { is_clipped, is_short, .. } = derived.parts[part];
            // Pixels at their limit are looked at when there are some; fits from nearby always look for them.
            let is_asked_for = move |control: &&Control| match control {
                Control::Plain => !is_clipped && !is_short,
                Control::Dropping => true,
                Control::Blind => !is_short,
            };
            let controls = controls.iter().filter(is_asked_for);
            controls.map(move |control| (part, *control))
        };
        let variants: Vec<(usize, Control)> = (0..derived.parts.len()).flat_map(each).collect();
        let compiled = all(variants.len(), workers, &|i| {
            let (part, control) = variants[i];
            self.kernel(&derived.parts, part, control, (self.precision, layout)).map(drop)
        });
        compiled.map(drop)
    }

    /// The kernels for a job, compiled now if need be.
    pub(crate) fn loops(&self, job: Job, control: Control, layout: &PlaneLayout) -> Result<Loops, CompileFailure> {
        self.loops_in(self.precision, job, control, layout)
    }

    /// The kernels for a job of fits from nearby; `None` where there are none.
    pub(crate) fn short_loops(&self, job: Job, layout: &PlaneLayout) -> Result<Option<Loops>, CompileFailure> {
        let has_them = !layout.has_rows && self.derived.sum_of(job).is_some();
        has_them.then(|| self.loops(job, Control::Dropping, layout)).transpose()
    }

    /// The same in another arithmetic.
    pub(crate) fn loops_in(
        &self,
        precision: Precision,
        job: Job,
        control: Control,
        layout: &PlaneLayout,
    ) -> Result<Loops, CompileFailure> {
        let derived = self.derived(layout, &InTurn)?;
        let made_for = (precision, layout);
        let mut all = Loops::default();
        if derived.offset.is_none() || job == Job::Report {
            let even = layout.without_rows();
            self.each(&self.derived, job, control, (precision, &even), |kernel, part| {
                all.is_joint |= part.is_joint;
                if part.is_clipped { all.clipped.push(kernel) } else { all.seen.push(kernel) }
            })?;
        }
        let Some(offset) = derived.offset else { return Ok(all) };
        // What offsets explain is told by F.
        let of_rows = if job == Job::Report { Job::Value } else { job };
        let mut entries: Vec<Loops> = Vec::new();
        self.each(derived, of_rows, control, made_for, |kernel, part| match entries.last_mut() {
            Some(entry) if part.is_clipped => entry.clipped.push(kernel),
            _ => entries.push(Loops { seen: smallvec![kernel], ..Loops::default() }),
        })?;
        let order = derived.order(of_rows);
        let place = |wanted: &ParameterId| order.iter().position(|id| id == wanted);
        let places = self.derived.order(of_rows).iter().filter_map(place).collect();
        let rows = place(&offset).map(|offset| Rows { entries, places, offset, count: order.len() });
        Ok(Loops { rows: rows.map(Arc::new), ..all })
    }

    /// Calls with each kernel of a job, and what it is of: pixels at their limit of an entry of `observed` follow the entry's other
    /// pixels, or all of these.
    fn each(
        &self,
        derived: &Derived,
        job: Job,
        control: Control,
        made_for: (Precision, &PlaneLayout),
        mut visit: impl FnMut(Arc<Kernel>, &SummandPrograms),
    ) -> Result<(), CompileFailure> {
        let sum = derived.sum_of(job);
        for (index, part) in derived.parts.iter().enumerate().filter(|(_, part)| Some(part.sum) == sum) {
            if !part.is_clipped || control != Control::Plain {
                visit(self.kernel(&derived.parts, index, control, made_for)?, part);
            }
        }
        Ok(())
    }

    /// The kernel of a part, compiled now if need be.
    fn kernel(
        &self,
        parts: &[SummandPrograms],
        index: usize,
        control: Control,
        (precision, layout): (Precision, &PlaneLayout),
    ) -> Result<Arc<Kernel>, CompileFailure> {
        let part = &parts[index];
        // Pixels at their limit are numbers.
        let control = if part.is_clipped { Control::Plain } else { control };
        let find = |ready: &[Ready]| {
            let is_alike = |r: &Ready| r.part == index && r.control == control && r.precision == precision;
            let same = |r: &&Ready| is_alike(r) && r.layout == *layout;
            ready.iter().find(same).map(|r| r.kernel.clone())
        };
        if let Some(kernel) = find(&self.ready.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Ok(kernel);
        }
        // Outside of the lock: it may take milliseconds.
        let skipping;
        let program = match control {
            Control::Plain => &part.plain,
            Control::Dropping => &part.dropping,
            Control::Blind => {
                skipping = part.objective.skipping_nan().program(lowering(control)).map_err(CompileFailure::Model)?;
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
            ready.push(Ready { part: index, control, precision, layout: layout.clone(), kernel: kernel.clone() });
        }
        Ok(kernel)
    }
}

/// How a stage goes about pixels of such a layout: where rows have offsets, variances are held, since what an offset explains
/// follows from them.
pub(crate) fn method(model: &Model, stage: usize, layout: &PlaneLayout) -> Method {
    if layout.has_rows { held(model, stage) } else { model.stages()[stage].method }
}

pub(super) fn held(model: &Model, stage: usize) -> Method {
    if model.has_noise() { Method::LevenbergMarquardt } else { model.stages()[stage].method }
}

/// Which Hessian a method asks for.
pub(crate) fn curvature(method: Method) -> Curvature {
    match method {
        Method::Newton => Curvature::Full,
        Method::GaussNewton | Method::LevenbergMarquardt => Curvature::GaussNewton,
    }
}

#[cfg(test)]
#[path = "stage_kernels_tests.rs"]
mod tests;
