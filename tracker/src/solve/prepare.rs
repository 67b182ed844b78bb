//! `Preparation`: alternatives are derived and compiled beside a fit, which goes on without them.
//!
//! What comes in: a model's kernels, and how the pixels of its frames lie. What goes out: the alternatives on the model's
//! shelf, where every tracker of the model finds them. It never knows who runs it, nor when.

use std::sync::Arc;

use isophote_jit::PixelFormat;

use crate::sight::view::{PlaneLayout, View};
use crate::solve::compiled::Compiled;
use crate::solve::stage_kernels::{CompileFailure, Control};
use crate::solve::workers::InTurn;

/// When the alternatives to a model are prepared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preparing {
    /// By the fit that asks for them first, which waits: the same frames have the same estimates.
    #[default]
    AtOnce,
    /// By whoever takes the tracker's [`Preparation`]; until it has run, frames are fitted without them.
    Beside,
}

/// Alternatives that a fit would have tried: to be run on another thread.
#[derive(Clone)]
pub struct Preparation {
    compiled: Arc<Compiled>,
    layout: PlaneLayout,
}

impl Preparation {
    pub(crate) fn new(compiled: &Arc<Compiled>, view: &View) -> Preparation {
        Preparation { compiled: compiled.clone(), layout: view.layout.clone() }
    }

    /// Derives and compiles all that fits of such frames may ask for, unless somebody has. `keeps_going` is asked between two
    /// models and between the kernels of two; what was compiled until it says no is kept for the next time.
    ///
    /// # Errors
    /// When a kernel cannot be made. From then on trackers of the model go on without alternatives.
    pub fn run(&self, keeps_going: &dyn Fn() -> bool) -> Result<(), CompileFailure> {
        let shelf = self.compiled.shelf();
        if shelf.ready(&self.layout).is_some() {
            return Ok(());
        }
        let Some(alternatives) = shelf.get_while(&self.compiled, keeps_going) else { return Ok(()) };
        let painted = PlaneLayout::of_format(PixelFormat::F32, self.layout.formats.len());
        let painted = PlaneLayout { packed: true, ..painted };
        for compiled in alternatives.compiled() {
            for (layout, control) in [(&self.layout, Control::Dropping), (&painted, Control::Blind)] {
                if !keeps_going() {
                    return Ok(());
                }
                compiled.warm_for(layout, &[control], &InTurn).inspect_err(|_| shelf.give_up())?;
            }
        }
        shelf.warmed(&self.layout);
        Ok(())
    }
}
