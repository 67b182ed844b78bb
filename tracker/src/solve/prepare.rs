//! `Preparation`: what fits would use is derived and compiled beside them; they go on without it.
//!
//! What comes in: a model's kernels, and how the pixels of its frames lie. What goes out: robust fits, or finer sampling, on
//! the model's shelves, where every tracker of the model finds them. It never knows who runs it, nor when.

use std::sync::Arc;

use isophote_jit::PixelFormat;

use crate::sight::view::{PlaneLayout, View};
use crate::solve::compiled::Compiled;
use crate::solve::stage_kernels::{CompileFailure, Control, StageKernels};
use crate::solve::workers::InTurn;

/// When that is prepared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preparing {
    /// By the fit that asks for it first, which waits: the same frames have the same estimates.
    #[default]
    AtOnce,
    /// By whoever takes the tracker's [`Preparation`]; until it has run, frames are fitted without.
    Beside,
}

/// What a fit went on without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lacking {
    /// Robust fits and other backgrounds.
    Robust,
    Sampling,
    /// Kernels for rows that are off.
    Rows,
}

/// What fits would have used: to be run on another thread.
#[derive(Clone)]
pub struct Preparation {
    compiled: Arc<Compiled>,
    layout: PlaneLayout,
    lacking: Lacking,
}

impl Preparation {
    pub(crate) fn new(compiled: &Arc<Compiled>, view: &View, lacking: Lacking) -> Preparation {
        Preparation { compiled: compiled.clone(), layout: view.layout.clone(), lacking }
    }

    /// Derives and compiles all that fits of such frames may ask for, unless somebody has. `keeps_going` is asked between two
    /// models and between the kernels of two; what was compiled until it says no is kept for the next time.
    ///
    /// # Errors
    /// When a kernel cannot be made. From then on trackers of the model go on without.
    pub fn run(&self, keeps_going: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        match self.lacking {
            Lacking::Robust => self.robust(keeps_going),
            Lacking::Sampling => self.sampling(keeps_going),
            // What makes rows look off may hide the target as well, and be gone by the time that these are there.
            Lacking::Rows => self.rows().and_then(|()| self.robust(keeps_going)),
        }
    }

    fn robust(&self, keeps_going: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let shelf = self.compiled.backgrounds_shelf();
        if shelf.ready(&self.layout).is_some() {
            return Ok(());
        }
        let Some(backgrounds) = self.compiled.backgrounds(keeps_going) else { return Ok(()) };
        // Robust fits are by the model itself, those of a pose over a copy of the picture.
        self.compiled.predictions();
        let own = self.compiled.warm_for(&self.layout, &[Control::Dropping], &InTurn);
        own.inspect_err(|_| shelf.give_up())?;
        let is_pose = self.compiled.model().roles().iter().any(|roles| !roles.position.is_empty());
        let painted = PlaneLayout::of_format(PixelFormat::F32, self.layout.formats.len());
        let painted = PlaneLayout { packed: true, has_rows: self.layout.has_rows, ..painted };
        let of_pose: Option<(&StageKernels, _, _)> = is_pose.then_some((&self.compiled, &painted, Control::Blind));
        let others = backgrounds.iter().map(|one| (&*one.compiled, &self.layout, Control::Dropping));
        for (compiled, layout, control) in others.chain(of_pose) {
            if !keeps_going() {
                return Ok(());
            }
            compiled.warm_for(layout, &[control], &InTurn).inspect_err(|_| shelf.give_up())?;
        }
        shelf.warmed(&self.layout);
        Ok(())
    }

    fn rows(&self) -> Result<(), CompileFailure> {
        let shelf = self.compiled.rows_shelf();
        shelf.get_or_derive(|| Some(Some(())));
        let layout = PlaneLayout { has_rows: true, ..self.layout.clone() };
        let warmed = self.compiled.warm_for(&layout, &[Control::Plain, Control::Dropping], &InTurn);
        warmed.inspect_err(|_| shelf.give_up())?;
        shelf.warmed(&self.layout);
        Ok(())
    }

    fn sampling(&self, keeps_going: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let shelf = self.compiled.sampling_shelf();
        if shelf.ready(&self.layout).is_some() {
            return Ok(());
        }
        let sampling = self.compiled.sampling();
        sampling.warm(keeps_going).inspect_err(|_| shelf.give_up())?;
        for compiled in sampling.compiled() {
            if !keeps_going() {
                return Ok(());
            }
            let layout = self.layout.corrected(compiled.model().entries());
            compiled.warm_for(&layout, &[Control::Dropping], &InTurn).inspect_err(|_| shelf.give_up())?;
        }
        if keeps_going() {
            shelf.warmed(&self.layout);
        }
        Ok(())
    }
}
