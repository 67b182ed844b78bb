//! `Preparation`: derives and compiles robust fits, finer sampling and row kernels in the background, as parts of the
//! model that all its trackers share; fits go on without them meanwhile.

use std::sync::Arc;

use isophote_jit::PixelFormat;

use crate::sight::view::{PlaneLayout, View};
use crate::solve::compiled::Compiled;
use crate::solve::stage_kernels::{CompileFailure, PixelHandling, StageKernels};
use crate::solve::workers::InTurn;

/// When [`Preparation`]s run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preparing {
    /// In the first fit that needs it, which waits: equal frames have equal estimates.
    #[default]
    AtOnce,
    /// By the taker of the tracker's [`Preparation`]; until it has run, frames are fitted without.
    Beside,
}

/// The part that a fit went on without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MissingKernels {
    /// Robust fits and other backgrounds.
    Robust,
    Sampling,
    /// Kernels for rows with offsets.
    Rows,
}

/// Derivations and kernels that fits lacked: to be run on another thread.
#[derive(Clone)]
pub struct Preparation {
    compiled: Arc<Compiled>,
    layout: PlaneLayout,
    lacking: MissingKernels,
}

impl Preparation {
    pub(crate) fn new(compiled: &Arc<Compiled>, view: &View, lacking: MissingKernels) -> Preparation {
        Preparation { compiled: compiled.clone(), layout: view.layout.clone(), lacking }
    }

    /// Derives and compiles what fits of such frames may need, unless that is done. Asks `should_continue` between
    /// models and between the kernels of two; keeps what is compiled when it returns false.
    ///
    /// # Errors
    /// When a kernel fails to compile. Trackers of the model then do without.
    pub fn run(&self, should_continue: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        match self.lacking {
            MissingKernels::Robust => self.robust(should_continue),
            MissingKernels::Sampling => self.sampling(should_continue),
            // Whatever makes rows look offset may also hide the target, and be gone once these kernels exist.
            MissingKernels::Rows => self.rows().and_then(|()| self.robust(should_continue)),
        }
    }

    fn robust(&self, should_continue: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let prepared = self.compiled.prepared_backgrounds();
        if prepared.ready(&self.layout).is_some() {
            return Ok(());
        }
        let Some(backgrounds) = self.compiled.backgrounds(should_continue) else { return Ok(()) };
        // Robust fits use the model itself, those of a pose a copy of the picture.
        self.compiled.predictions();
        let own = self.compiled.warm_for(&self.layout, &[PixelHandling::SkipSaturated], &InTurn);
        own.inspect_err(|_| prepared.mark_failed())?;
        let is_pose = self.compiled.model().roles().iter().any(|roles| !roles.position.is_empty());
        let nan_masked = PlaneLayout::of_format(PixelFormat::F32, self.layout.formats.len());
        let nan_masked = PlaneLayout { packed: true, has_rows: self.layout.has_rows, ..nan_masked };
        let of_pose: Option<(&StageKernels, _, _)> =
            is_pose.then_some((&self.compiled, &nan_masked, PixelHandling::SkipInvalid));
        let others = backgrounds.iter().map(|one| (&*one.compiled, &self.layout, PixelHandling::SkipSaturated));
        for (compiled, layout, handling) in others.chain(of_pose) {
            if !should_continue() {
                return Ok(());
            }
            compiled.warm_for(layout, &[handling], &InTurn).inspect_err(|_| prepared.mark_failed())?;
        }
        prepared.mark_compiled(&self.layout);
        Ok(())
    }

    fn rows(&self) -> Result<(), CompileFailure> {
        let prepared = self.compiled.prepared_rows();
        prepared.get_or_derive(|| Some(Some(())));
        let layout = PlaneLayout { has_rows: true, ..self.layout.clone() };
        let compiled = self.compiled.warm_for(&layout, &[PixelHandling::All, PixelHandling::SkipSaturated], &InTurn);
        compiled.inspect_err(|_| prepared.mark_failed())?;
        prepared.mark_compiled(&self.layout);
        Ok(())
    }

    fn sampling(&self, should_continue: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let prepared = self.compiled.prepared_sampling();
        if prepared.ready(&self.layout).is_some() {
            return Ok(());
        }
        let sampling = self.compiled.sampling();
        sampling.warm(should_continue).inspect_err(|_| prepared.mark_failed())?;
        for compiled in sampling.compiled() {
            if !should_continue() {
                return Ok(());
            }
            let layout = self.layout.corrected(compiled.model().entries());
            compiled
                .warm_for(&layout, &[PixelHandling::SkipSaturated], &InTurn)
                .inspect_err(|_| prepared.mark_failed())?;
        }
        if should_continue() {
            prepared.mark_compiled(&self.layout);
        }
        Ok(())
    }
}
