//! `Compiled`: a model's programs, and their kernels for the pixel layouts that were met so far.
//!
//! What comes in: a checked model. What goes out: kernels, compiled when first asked for and shared by all trackers of the
//! model. It never knows a frame's pixels.

use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::{CompileError, Kernel, KernelCache, KernelOptions, PixelFormat, PlaneView, has_fma};
use isophote_symbolic::{Diagnostics, Lowering, Method, Model, ParameterId, Precision, Program, Stage, ValueKind};

use crate::frame::Frame;
use crate::trust::Curvature;

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
    /// It leaves them out and counts them.
    Dropping,
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

struct Pair {
    job: Job,
    plain: Program,
    dropping: Program,
}

struct Ready {
    /// Index into the programs.
    pair: usize,
    control: Control,
    layout: Layout,
    kernel: Arc<Kernel>,
}

/// A model's kernels for all stages. Cheap to share; threads may use it at the same time. The kernels that it handed out
/// stay for as long as it lives; the cache behind it may keep them for longer.
pub struct Compiled {
    model: Arc<Model>,
    precision: Precision,
    pairs: Arc<Vec<Pair>>,
    cache: Arc<KernelCache>,
    ready: Mutex<Vec<Ready>>,
}

/// Kernels held; beyond, the oldest is let go (an unusual mixture of pixel formats, or a hostile one).
const KERNELS_MAX: usize = 64;

impl Compiled {
    /// Derives all programs of the model's stages, with a cache of its own. Kernels follow when a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn new(model: Arc<Model>, precision: Precision) -> Result<Compiled, CompileFailure> {
        Compiled::with_cache(model, precision, Arc::default())
    }

    /// The same with a cache that other models share, so that a kernel that one of them has is not compiled again.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn with_cache(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
    ) -> Result<Compiled, CompileFailure> {
        let pairs = Arc::new(pairs(&model)?);
        Ok(Compiled { model, precision, pairs, cache, ready: Mutex::default() })
    }

    /// The same programs and cache, holding no kernel yet: for one who gives his kernels back when he is done.
    pub fn share(&self) -> Compiled {
        let (model, pairs, cache) = (self.model.clone(), self.pairs.clone(), self.cache.clone());
        Compiled { model, precision: self.precision, pairs, cache, ready: Mutex::default() }
    }

    /// The model.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Arithmetic of the pixel loops.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Free parameters of the last stage.
    pub(crate) fn last_parameters(&self) -> &[ParameterId] {
        self.model.stages().last().map_or(&[], |stage| &stage.parameters)
    }

    /// Compiles every kernel for frames whose planes all have this format: packed when there is one, else interleaved.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn warm(&self, format: PixelFormat) -> Result<(), CompileFailure> {
        let channels = self.model.channels().len();
        self.warm_layout(&Layout { formats: vec![format; channels], packed: channels == 1 })
    }

    /// Compiles every kernel for frames like this one.
    ///
    /// # Errors
    /// When a kernel cannot be made.
    pub fn warm_for(&self, frame: &Frame) -> Result<(), CompileFailure> {
        let planes: Vec<PlaneView> = (0..frame.planes().len()).map(|channel| frame.plane_view(channel)).collect();
        self.warm_layout(&Layout::of(&planes))
    }

    fn warm_layout(&self, layout: &Layout) -> Result<(), CompileFailure> {
        for pair in self.pairs.iter() {
            for control in [Control::Plain, Control::Dropping] {
                self.kernel(pair.job, control, layout)?;
            }
        }
        Ok(())
    }

    /// The kernel for a job, compiled now if need be.
    pub(crate) fn kernel(&self, job: Job, control: Control, layout: &Layout) -> Result<Arc<Kernel>, CompileFailure> {
        // A last stage with a Gauss–Newton Hessian serves the covariance as well.
        let last = self.model.stages().len().saturating_sub(1);
        let served = |pair: &Pair| pair.job == job;
        let index = match self.pairs.iter().position(served) {
            Some(index) => index,
            None => last,
        };
        let find = |ready: &[Ready]| {
            let same = |r: &&Ready| r.pair == index && r.control == control && r.layout == *layout;
            ready.iter().find(same).map(|r| r.kernel.clone())
        };
        if let Some(kernel) = find(&self.ready.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Ok(kernel);
        }
        // Outside of the lock: it may take milliseconds.
        let program = match control {
            Control::Plain => &self.pairs[index].plain,
            Control::Dropping => &self.pairs[index].dropping,
        };
        let options =
            KernelOptions { precision: self.precision, formats: layout.formats.clone(), packed: layout.packed };
        let kernel = self.cache.get_or_compile(program, &options);
        let kernel = kernel.map_err(|error| CompileFailure::Kernel(Arc::new(error)))?;
        let mut ready = self.ready.lock().unwrap_or_else(PoisonError::into_inner);
        if find(&ready).is_none() {
            if ready.len() == KERNELS_MAX {
                ready.remove(0);
            }
            ready.push(Ready { pair: index, control, layout: layout.clone(), kernel: kernel.clone() });
        }
        Ok(kernel)
    }
}

/// Every job of a model and its programs.
fn pairs(model: &Model) -> Result<Vec<Pair>, CompileFailure> {
    let stage = |job, parameters: &[ParameterId], method| {
        let objective = model.objective(parameters, method).map_err(CompileFailure::Model)?;
        pair(job, |lowering| objective.program(lowering))
    };
    let value = |job, kind| {
        let objective = model.value_objective(kind).map_err(CompileFailure::Model)?;
        pair(job, |lowering| objective.program(lowering))
    };
    let mut pairs = Vec::new();
    for (index, Stage { parameters, method, .. }) in model.stages().iter().enumerate() {
        pairs.push(stage(Job::Stage(index), parameters, *method)?);
    }
    if let Some(last) = model.stages().last().filter(|last| curvature(last.method) == Curvature::Full) {
        pairs.push(stage(Job::Covariance, &last.parameters, Method::GaussNewton)?);
    }
    pairs.push(value(Job::Value, ValueKind::Entry)?);
    if model.has_noise() {
        pairs.push(value(Job::Report, ValueKind::Full)?);
    }
    Ok(pairs)
}

fn pair(job: Job, program: impl Fn(Lowering) -> Result<Program, Diagnostics>) -> Result<Pair, CompileFailure> {
    let lowered = |control| program(lowering(control)).map_err(CompileFailure::Model);
    Ok(Pair { job, plain: lowered(Control::Plain)?, dropping: lowered(Control::Dropping)? })
}

/// How programs are lowered on this machine.
pub(crate) fn lowering(control: Control) -> Lowering {
    Lowering { fma: has_fma(), drop_saturated: control == Control::Dropping }
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
