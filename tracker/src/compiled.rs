//! `Compiled`: a model's programs, and their kernels for the pixel layouts that were met so far.
//!
//! What comes in: a checked model. What goes out: kernels, compiled when first asked for and shared by all trackers of the
//! model. It never knows a frame's pixels.

use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::{CompileError, Kernel, KernelOptions, PixelFormat, PlaneView, has_fma};
use isophote_symbolic::{Diagnostics, Lowering, Method, Model, ParameterId, Precision, Program, ValueKind};

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

/// A model's kernels for all stages. Cheap to share; threads may use it at the same time.
pub struct Compiled {
    model: Arc<Model>,
    precision: Precision,
    pairs: Vec<Pair>,
    ready: Mutex<Vec<Ready>>,
}

/// Kernels kept; beyond, the oldest is dropped (an unusual mixture of pixel formats, or a hostile one).
const KERNELS_MAX: usize = 64;

impl Compiled {
    /// Derives all programs of the model's stages. Kernels follow when a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn new(model: Arc<Model>, precision: Precision) -> Result<Compiled, CompileFailure> {
        let mut compiled = Compiled { model, precision, pairs: Vec::new(), ready: Mutex::new(Vec::new()) };
        for (index, stage) in compiled.model.clone().stages().iter().enumerate() {
            compiled.derive(Job::Stage(index), &stage.parameters, stage.method)?;
        }
        if compiled.last_curvature() == Curvature::Full {
            let last = compiled.last_parameters().to_vec();
            compiled.derive(Job::Covariance, &last, Method::GaussNewton)?;
        }
        compiled.derive_value(Job::Value, ValueKind::Entry)?;
        if compiled.model.has_noise() {
            compiled.derive_value(Job::Report, ValueKind::Full)?;
        }
        Ok(compiled)
    }

    fn derive(&mut self, job: Job, parameters: &[ParameterId], method: Method) -> Result<(), CompileFailure> {
        let objective = self.model.objective(parameters, method).map_err(CompileFailure::Model)?;
        self.push(job, |lowering| objective.program(lowering))
    }

    fn derive_value(&mut self, job: Job, kind: ValueKind) -> Result<(), CompileFailure> {
        let objective = self.model.value_objective(kind).map_err(CompileFailure::Model)?;
        self.push(job, |lowering| objective.program(lowering))
    }

    fn push(
        &mut self,
        job: Job,
        program: impl Fn(Lowering) -> Result<Program, Diagnostics>,
    ) -> Result<(), CompileFailure> {
        let lowered = |control| program(lowering(control)).map_err(CompileFailure::Model);
        self.pairs.push(Pair { job, plain: lowered(Control::Plain)?, dropping: lowered(Control::Dropping)? });
        Ok(())
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

    fn last_curvature(&self) -> Curvature {
        self.model.stages().last().map_or(Curvature::GaussNewton, |stage| curvature(stage.method))
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
        for pair in &self.pairs {
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
        // Compiled outside the lock: two threads may do the same work once, none waits.
        let program = match control {
            Control::Plain => &self.pairs[index].plain,
            Control::Dropping => &self.pairs[index].dropping,
        };
        let options =
            KernelOptions { precision: self.precision, formats: layout.formats.clone(), packed: layout.packed };
        let kernel = Kernel::compile(program, &options).map_err(|error| CompileFailure::Kernel(Arc::new(error)))?;
        let kernel = Arc::new(kernel);
        let mut ready = self.ready.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(other) = find(&ready) {
            return Ok(other);
        }
        if ready.len() == KERNELS_MAX {
            ready.remove(0);
        }
        ready.push(Ready { pair: index, control, layout: layout.clone(), kernel: kernel.clone() });
        Ok(kernel)
    }
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
