//! `Compiled`: a model's programs, and their kernels for the pixel layouts that were met so far.
//!
//! What comes in: a checked model. What goes out: kernels, compiled when first asked for and shared by all trackers of the
//! model. It never knows a frame's pixels.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isophote_jit::{CompileError, Kernel, KernelCache, KernelOptions, PixelFormat, PlaneView, has_fma};
use isophote_symbolic::{
    Diagnostics, Lowering, Method, Model, Objective, ParameterId, Precision, Program, Stage, Summand, ValueKind,
};

use crate::solve::alternatives::Alternatives;
use crate::solve::loops::Loops;
use crate::solve::trust::Curvature;
use crate::solve::workers::{InTurn, Workers};

/// Why a model cannot run here.
#[derive(Clone, Debug, thiserror::Error)]
pub enum CompileFailure {
    /// The document asks for something that this build cannot do, or for too much.
    #[error("{}", messages(.0))]
    Model(Diagnostics),
    /// A kernel could not be made; not the document's fault.
    #[error("a kernel could not be compiled: {0}")]
    Kernel(Arc<CompileError>),
}

fn messages(diagnostics: &Diagnostics) -> String {
    diagnostics.iter().map(|diagnostic| diagnostic.message.as_str()).collect::<Vec<_>>().join("; ")
}

/// Whether a kernel looks for saturated pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Control {
    /// It does not; for frames without them.
    Plain,
    /// It leaves them out and counts them; where they are censored, kernels of their own sum them.
    Dropping,
    /// It leaves pixels out that are no numbers as well; for pictures that are blind in places.
    Blind,
}

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
}

/// How the pixels of a frame lie in memory, as far as a kernel is made for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    formats: Vec<PixelFormat>,
    packed: bool,
}

impl Layout {
    /// The layout of some planes.
    pub fn of(planes: &[PlaneView]) -> Layout {
        Layout {
            formats: planes.iter().map(|plane| plane.format()).collect(),
            packed: planes.iter().all(|plane| plane.pixel_stride() == plane.format().bytes_per_pixel()),
        }
    }
}

/// A job for one of the model's summands.
struct Part {
    job: Job,
    is_clipped: bool,
    plain: Program,
    dropping: Program,
    objective: Objective,
}

struct Ready {
    /// Index into the parts.
    part: usize,
    control: Control,
    precision: Precision,
    layout: Layout,
    kernel: Arc<Kernel>,
}

/// A model's kernels for all stages. Cheap to share; threads may use it at the same time. The kernels that it handed out
/// stay for as long as it lives; the cache behind it may keep them for longer.
pub struct Compiled {
    model: Arc<Model>,
    precision: Precision,
    parts: Arc<Vec<Part>>,
    cache: Arc<KernelCache>,
    ready: Mutex<Vec<Ready>>,
    alternatives: Arc<OnceLock<Result<Arc<Alternatives>, CompileFailure>>>,
}

/// Kernels held; beyond, the oldest is let go (an unusual mixture of pixel formats, or a hostile one).
const KERNELS_MAX: usize = 512;

impl Compiled {
    /// Derives all programs of the model's stages, with a cache of its own. Kernels follow when a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn new(model: Arc<Model>, precision: Precision) -> Result<Compiled, CompileFailure> {
        Compiled::with_cache(model, precision, Arc::default(), &InTurn)
    }

    /// The same with a cache that other models share, so that a kernel that one of them has is not compiled again, and with
    /// the stages derived by `workers`.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn with_cache(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
        workers: &dyn Workers,
    ) -> Result<Compiled, CompileFailure> {
        let parts = Arc::new(parts(&model, workers)?);
        Ok(Compiled { model, precision, parts, cache, ready: Mutex::default(), alternatives: Arc::default() })
    }

    /// The same programs and cache, holding no kernel yet: for one who gives his kernels back when he is done.
    pub fn share(&self) -> Compiled {
        let (model, parts, cache) = (self.model.clone(), self.parts.clone(), self.cache.clone());
        let alternatives = self.alternatives.clone();
        Compiled { model, precision: self.precision, parts, cache, ready: Mutex::default(), alternatives }
    }

    /// The model.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Arithmetic of the pixel loops.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// What is tried when the model does not describe a picture; derived when first asked for.
    pub(crate) fn alternatives(&self) -> Result<Arc<Alternatives>, CompileFailure> {
        let new = || Alternatives::new(self, &self.cache).map(Arc::new);
        self.alternatives.get_or_init(new).clone()
    }

    /// Free parameters of the last stage.
    pub(crate) fn last_parameters(&self) -> &[ParameterId] {
        self.model.stages().last().map_or(&[], |stage| &stage.parameters)
    }

    /// Compiles every kernel for frames whose planes all have this format: packed when there is one, else interleaved.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn warm(&self, format: PixelFormat, workers: &dyn Workers) -> Result<(), CompileFailure> {
        let channels = self.model.channels().len();
        let layout = Layout { formats: vec![format; channels], packed: channels == 1 };
        let both = |part: usize| {
            // Pixels at their limit are looked at when there are some.
            let plain = (!self.parts[part].is_clipped).then_some((part, Control::Plain));
            plain.into_iter().chain([(part, Control::Dropping)])
        };
        let variants: Vec<(usize, Control)> = (0..self.parts.len()).flat_map(both).collect();
        let compiled = all(variants.len(), workers, &|i| {
            let (part, control) = variants[i];
            self.kernel(part, control, self.precision, &layout).map(drop)
        });
        compiled.map(drop)
    }

    /// The kernels for a job, compiled now if need be.
    pub(crate) fn loops(&self, job: Job, control: Control, layout: &Layout) -> Result<Loops, CompileFailure> {
        self.loops_in(self.precision, job, control, layout)
    }

    /// The same in another arithmetic.
    pub(crate) fn loops_in(
        &self,
        precision: Precision,
        job: Job,
        control: Control,
        layout: &Layout,
    ) -> Result<Loops, CompileFailure> {
        // A last stage with a Gauss–Newton Hessian serves the covariance as well.
        let last = self.model.stages().len().saturating_sub(1);
        let job = match job {
            Job::Stage(stage) => Job::Stage(self.model.first_alike(stage)),
            job if self.parts.iter().any(|part| part.job == job) => job,
            _ => Job::Stage(self.model.first_alike(last)),
        };
        let mut loops = Loops { seen: Vec::new(), clipped: Vec::new() };
        for (index, part) in self.parts.iter().enumerate().filter(|(_, part)| part.job == job) {
            match part.is_clipped {
                false => loops.seen.push(self.kernel(index, control, precision, layout)?),
                true if control == Control::Plain => {}
                true => loops.clipped.push(self.kernel(index, control, precision, layout)?),
            }
        }
        Ok(loops)
    }

    /// The kernel of a part, compiled now if need be.
    fn kernel(
        &self,
        index: usize,
        control: Control,
        precision: Precision,
        layout: &Layout,
    ) -> Result<Arc<Kernel>, CompileFailure> {
        let part = &self.parts[index];
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
        let options = KernelOptions { precision, formats: layout.formats.clone(), packed: layout.packed };
        let kernel = self.cache.get_or_compile(program, &options);
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

/// What each number gives, or the first fault.
fn all<T: Send + Sync>(
    count: usize,
    workers: &dyn Workers,
    make: &(dyn Fn(usize) -> Result<T, CompileFailure> + Sync),
) -> Result<Vec<T>, CompileFailure> {
    let made: Vec<Mutex<Option<Result<T, CompileFailure>>>> = (0..count).map(|_| Mutex::default()).collect();
    // The last stage has the most parameters: it is begun first, so that nobody waits for it alone.
    workers.each(count, &|i| {
        let i = count - 1 - i;
        *made[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(make(i));
    });
    // Whom the workers left out is done here.
    let each = made.into_iter().enumerate();
    each.map(|(i, one)| one.into_inner().unwrap_or_else(PoisonError::into_inner).unwrap_or_else(|| make(i))).collect()
}

/// Every job of a model, for each of its summands.
fn parts(model: &Model, workers: &dyn Workers) -> Result<Vec<Part>, CompileFailure> {
    let stages = (0..model.stages().len()).filter(|stage| model.first_alike(*stage) == *stage);
    let mut jobs: Vec<Job> = stages.map(Job::Stage).collect();
    if model.stages().last().is_some_and(|last| curvature(last.method) == Curvature::Full) {
        jobs.push(Job::Covariance);
    }
    jobs.push(Job::Value);
    if model.has_noise() {
        jobs.push(Job::Report);
    }
    let summands = model.summands();
    let count = summands.len();
    all(jobs.len() * count, workers, &|i| part(&summands[i % count], jobs[i / count]))
}

/// The programs of a job.
fn part(Summand { model, is_clipped }: &Summand, job: Job) -> Result<Part, CompileFailure> {
    let objective = match job {
        Job::Stage(index) => {
            let Stage { parameters, method, .. } = &model.stages()[index];
            model.objective(parameters, *method)
        }
        Job::Covariance => {
            let last = model.stages().last().map_or(&[][..], |stage| &stage.parameters);
            model.objective(last, Method::GaussNewton)
        }
        Job::Value => model.value_objective(ValueKind::Entry),
        Job::Report => model.value_objective(ValueKind::Full),
    };
    let objective = objective.map_err(CompileFailure::Model)?;
    let lowered = |control| objective.program(lowering(control)).map_err(CompileFailure::Model);
    let (plain, dropping) = (lowered(Control::Plain)?, lowered(Control::Dropping)?);
    Ok(Part { job, is_clipped: *is_clipped, plain, dropping, objective })
}

/// How programs are lowered on this machine.
pub(crate) fn lowering(control: Control) -> Lowering {
    Lowering { fma: has_fma(), drop_saturated: control != Control::Plain }
}

/// Which F a stage's steps are compared by. Newton differentiates the variance as well, so its F has ln σ² and variances of
/// its own; the others hold them at the entry parameters.
pub(crate) fn value_kind(model: &Model, method: Method) -> ValueKind {
    match curvature(method) {
        Curvature::Full if model.has_noise() => ValueKind::Full,
        _ => ValueKind::Entry,
    }
}

/// Which Hessian a method asks for.
pub(crate) fn curvature(method: Method) -> Curvature {
    match method {
        Method::Newton => Curvature::Full,
        Method::GaussNewton | Method::LevenbergMarquardt => Curvature::GaussNewton,
    }
}
